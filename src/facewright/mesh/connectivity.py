"""Who touches whom: edges, neighbours, connected components and boundary loops of a triangle mesh."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy import sparse
from scipy.sparse.csgraph import connected_components

from facewright.errors import TopologyError
from facewright.numeric.check import check_indices, check_shape


def _check_faces(faces: NDArray[np.integer[Any]], n_vertices: int) -> None:
    check_shape("faces", faces, "F", 3)
    check_indices("faces", faces, n_vertices)


def half_edges(faces: NDArray[np.integer[Any]]) -> NDArray[np.int64]:
    """Return the three directed edges of every triangle, shape (3F, 2), int64: all first ones, then the others."""
    triangles = np.asarray(faces, dtype=np.int64).reshape(-1, 3)
    return np.concatenate([triangles[:, [0, 1]], triangles[:, [1, 2]], triangles[:, [2, 0]]])


def unique_edges(faces: NDArray[np.integer[Any]]) -> NDArray[np.int64]:
    """Return the undirected edges, shape (N, 2), int64, smaller vertex first, sorted.

    Raises
    ------
    ShapeError
        If `faces` is not (F, 3).
    """
    check_shape("faces", faces, "F", 3)
    pairs = np.sort(half_edges(faces), axis=1)
    size = int(pairs.max(initial=0)) + 1
    keys = np.unique(pairs[:, 0] * size + pairs[:, 1])  # one number per edge: far faster than unique rows
    return np.stack([keys // size, keys % size], axis=1)


def vertex_adjacency(faces: NDArray[np.integer[Any]], n_vertices: int) -> sparse.csr_matrix:
    """Return the symmetric (V, V) matrix with 1 where an edge joins two vertices, CSR, float64.

    Raises
    ------
    ShapeError, ValueRangeError
        If `faces` is not (F, 3) or holds indices outside [0, V).
    """
    _check_faces(faces, n_vertices)
    edges = unique_edges(faces)
    edges = edges[edges[:, 0] != edges[:, 1]]
    rows, columns = np.concatenate([edges, edges[:, ::-1]]).T
    return sparse.csr_matrix((np.ones(len(rows)), (rows, columns)), shape=(n_vertices, n_vertices))


def vertex_components(faces: NDArray[np.integer[Any]], n_vertices: int) -> NDArray[np.int32]:
    """Return the connected component of every vertex, shape (V,), int32, from 0; an unused vertex is its own.

    Raises
    ------
    ShapeError, ValueRangeError
        If `faces` is not (F, 3) or holds indices outside [0, V).
    """
    _, labels = connected_components(vertex_adjacency(faces, n_vertices), directed=False)
    return labels.astype(np.int32)


def boundary_edges(faces: NDArray[np.integer[Any]]) -> NDArray[np.int64]:
    """Return the directed edges that only one triangle has, shape (N, 2), int64, in that triangle's direction.

    Raises
    ------
    ShapeError
        If `faces` is not (F, 3).
    """
    check_shape("faces", faces, "F", 3)
    directed = half_edges(faces)
    pairs = np.sort(directed, axis=1)
    keys = pairs[:, 0] * (int(pairs.max(initial=0)) + 1) + pairs[:, 1]
    _, first, counts = np.unique(keys, return_index=True, return_counts=True)
    return directed[np.sort(first[counts == 1])]


def boundary_loops(faces: NDArray[np.integer[Any]]) -> list[NDArray[np.int64]]:
    """Return the boundary as closed vertex loops, longest first.

    Parameters
    ----------
    faces : ndarray of shape (F, 3), int
        Triangles, oriented alike.

    Returns
    -------
    list of ndarray of shape (N,), int64
        Vertices of each loop in the direction of the triangles' edges, without repeating the first.

    Raises
    ------
    ShapeError
        If `faces` is not (F, 3).
    TopologyError
        If two boundaries meet in one vertex, so that loops are not unique.
    """
    edges = boundary_edges(faces)
    if len(np.unique(edges[:, 0])) != len(edges) or len(np.unique(edges[:, 1])) != len(edges):
        raise TopologyError("faces must have boundaries that do not touch, got a vertex with two of them.")
    follower = dict(edges.tolist())
    loops = []
    while follower:  # a loop over boundary vertices only
        start, vertex = follower.popitem()
        loop = [start]
        while vertex != start:
            loop.append(vertex)
            vertex = follower.pop(vertex)
        loops.append(np.array(loop, dtype=np.int64))
    return sorted(loops, key=len, reverse=True)
