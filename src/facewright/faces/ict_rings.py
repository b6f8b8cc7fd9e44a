"""Edge rings round the mouth and the eyes of a quad face mesh: upper and lower sides, and which vertices touch."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import sparse
from scipy.sparse.csgraph import dijkstra
from scipy.spatial import cKDTree


def polygon_edges(polygons: NDArray[np.int32]) -> NDArray[np.int64]:
    """Return the directed edges of quads and -1 padded triangles, shape (N, 2); diagonals are no edges."""
    polygons = np.asarray(polygons, dtype=np.int64)
    following = np.roll(polygons, -1, axis=1)
    triangle = polygons[:, 3] < 0
    following[triangle, 2] = polygons[triangle, 0]
    edges = np.stack([polygons, following], axis=2).reshape(-1, 2)
    return edges[edges[:, 0] >= 0].astype(np.int64)


def polygon_adjacency(
    polygons: NDArray[np.int32], n_vertices: int, lengths_of: NDArray | None = None
) -> sparse.csr_matrix:
    """Return the symmetric (V, V) matrix of polygon edges: 1, or the edge's length in vertices `lengths_of` (V, 3)."""
    edges = np.unique(np.sort(polygon_edges(polygons), axis=1), axis=0)
    values = np.ones(len(edges))
    if lengths_of is not None:
        values = np.linalg.norm(lengths_of[edges[:, 0]] - lengths_of[edges[:, 1]], axis=1)
    half = sparse.coo_matrix((values, (edges[:, 0], edges[:, 1])), shape=(n_vertices, n_vertices))
    return (half + half.T).tocsr()


@dataclass(frozen=True, eq=False)
class OpeningRings:
    """How far each vertex is from an opening (mouth or eye), in rings of edges, and on which side of it.

    Parameters
    ----------
    loop : ndarray of shape (N,), int
        The opening's boundary, in order.
    corners : ndarray of shape (2,), int
        Loop vertices of smallest and largest x.
    ring : ndarray of shape (V,), float64
        Edges to the loop (0 on it); infinite beyond `reach` or where not connected.
    upper, lower : ndarray of shape (V,), bool
        Vertices within reach that are nearer to the loop's upper or lower half.
    """

    loop: NDArray[np.int64]
    corners: NDArray[np.int64]
    ring: NDArray[np.float64]
    upper: NDArray[np.bool_]
    lower: NDArray[np.bool_]


def opening_rings(
    vertices: NDArray, adjacency: sparse.csr_matrix, loop: NDArray[np.int64], reach: int = 30
) -> OpeningRings:
    """Measure the edge rings round the opening bounded by `loop`."""
    first, second = sorted((int(vertices[loop, 0].argmin()), int(vertices[loop, 0].argmax())))
    halves = [loop[first + 1 : second], np.concatenate([loop[second + 1 :], loop[:first]])]
    halves.sort(key=lambda ids: vertices[ids, 1].mean())
    to_lower, to_upper, ring = (
        dijkstra(adjacency, unweighted=True, indices=ids, min_only=True, limit=reach) for ids in (*halves, loop)
    )
    return OpeningRings(loop, loop[[first, second]], ring, to_upper < to_lower, to_lower < to_upper)


def contact_pairs(
    vertices: NDArray, upper: NDArray[np.integer], lower: NDArray[np.integer], limit_mm: float
) -> tuple[NDArray[np.int32], NDArray[np.int32]]:
    """Return pairs (upper[i], lower[i]) of vertices that are each other's nearest within `limit_mm`, by x."""
    to_lower, nearest = cKDTree(vertices[lower]).query(vertices[upper])
    back = cKDTree(vertices[upper]).query(vertices[lower])[1]
    mutual = (back[nearest] == np.arange(len(upper))) & (to_lower <= limit_mm)
    a, b = upper[mutual], lower[nearest[mutual]]
    order = np.argsort(vertices[b, 0], kind="stable")
    return a[order].astype(np.int32), b[order].astype(np.int32)


def shortest_path(adjacency: sparse.csr_matrix, stops: NDArray[np.integer]) -> NDArray[np.int64]:
    """Return the vertices of the shortest path along edges through `stops` in turn, both ends included."""
    before = dijkstra(adjacency, indices=stops[:-1], return_predecessors=True)[1]
    path = [int(stops[0])]
    for row, target in enumerate(stops[1:]):
        leg = [int(target)]
        while leg[-1] != stops[row]:
            leg.append(int(before[row, leg[-1]]))
        path += leg[-2::-1]
    return np.array(path, dtype=np.int64)


def enclosed(adjacency: sparse.csr_matrix, border: NDArray[np.integer], seed: int) -> NDArray[np.int64]:
    """Return the vertices that `seed` reaches along edges without crossing `border`, and the border; sorted."""
    blocked = np.isin(np.arange(adjacency.shape[0]), border)
    open_edges = sparse.diags((~blocked).astype(float)) @ adjacency @ sparse.diags((~blocked).astype(float))
    inside = np.isfinite(dijkstra(open_edges, indices=seed, unweighted=True))
    return np.union1d(np.flatnonzero(inside), border)
