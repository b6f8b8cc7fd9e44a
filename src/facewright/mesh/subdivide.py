"""Catmull-Clark subdivision as a sparse matrix, with boundary and crease rules."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy import sparse

from facewright.errors import TopologyError, ValueRangeError
from facewright.numeric.check import check_indices, check_shape


class Subdivision(NamedTuple):
    """One or more levels of subdivision: ``fine = matrix @ coarse``.

    Parameters
    ----------
    matrix : scipy.sparse.csr_matrix of shape (V_fine, V_coarse), float64
        Rows sum to one. Fine vertices are the coarse ones (same order), then edge points, then face points.
    faces : ndarray of shape (Q_fine, 4), int32
        Quads, oriented as the coarse faces.
    edges : ndarray of shape (E, 2), int32
        Edges of the mesh before the last level, sorted within a row; edge i has the point ``n_coarse + i``.
    parents : ndarray of shape (Q_fine,), int32
        Face of the coarsest mesh that each quad lies in.
    """

    matrix: sparse.csr_matrix
    faces: NDArray[np.int32]
    edges: NDArray[np.int32]
    parents: NDArray[np.int32]


def subdivide_catmull_clark(
    faces: ArrayLike, n_vertices: int, *, levels: int = 1, creases: ArrayLike | None = None
) -> Subdivision:
    """Build the Catmull-Clark matrix of a mesh of quads and triangles.

    Boundary edges follow the cubic B-spline curve of the boundary vertices alone. Crease edges do the same inside the
    surface; a vertex with one crease edge stays smooth, one with more than two is kept fixed.

    Parameters
    ----------
    faces : array_like of shape (F, 4), int
        Quads; -1 in the last column marks a triangle.
    n_vertices : int
        Number of coarse vertices V.
    levels : int
        Number of subdivision steps, at least 1.
    creases : array_like of shape (C, 2), int, or None
        Vertex pairs of edges kept sharp at every level.

    Returns
    -------
    Subdivision
        Matrix and connectivity of the finest level.

    Raises
    ------
    TopologyError
        If an edge has more than two faces, or a crease is not an edge.
    ValueRangeError
        If `levels` is below 1 or an index is out of range.

    Notes
    -----
    Face point: mean of the face. Edge point: mean of its ends and the two face points. Vertex of valence n:
    (Q + 2 R + (n - 3) S) / n with Q the mean of face points, R the mean of edge midpoints [1]_.

    References
    ----------
    .. [1] Catmull and Clark, Computer-Aided Design 10(6), 1978, doi:10.1016/0010-4485(78)90110-0.

    Examples
    --------
    >>> step = subdivide_catmull_clark([[0, 1, 2, 3]], 4)
    >>> step.matrix.shape, len(step.faces)
    ((9, 4), 4)
    """
    if levels < 1:
        raise ValueRangeError(f"levels must be at least 1, got {levels}.")
    polygons = np.asarray(faces)
    check_shape("faces", polygons, "F", 4)
    check_indices("faces", np.where(polygons < 0, 0, polygons), n_vertices)
    sharp = np.zeros((0, 2), np.int64) if creases is None else np.sort(np.asarray(creases, np.int64), axis=1)
    check_shape("creases", sharp, "C", 2)

    step, sharp = _subdivide_once(polygons.astype(np.int64), n_vertices, sharp)
    matrix, parents = step.matrix, step.parents
    for _ in range(levels - 1):
        step, sharp = _subdivide_once(step.faces.astype(np.int64), matrix.shape[0], sharp)
        matrix, parents = step.matrix @ matrix, parents[step.parents]
    return Subdivision(matrix.tocsr(), step.faces, step.edges, parents)


def _subdivide_once(
    polygons: NDArray[np.int64], V: int, sharp: NDArray[np.int64]
) -> tuple[Subdivision, NDArray[np.int64]]:
    """Return one Catmull-Clark step and the crease edges of the finer mesh."""
    F = len(polygons)
    sides = np.where(polygons[:, 3] >= 0, 4, 3)
    corner_face = np.repeat(np.arange(F), sides)
    slot = np.concatenate([np.arange(4)] * F).reshape(F, 4)[polygons >= 0] if F else np.zeros(0, np.int64)
    corner = polygons[corner_face, slot]
    following = polygons[corner_face, (slot + 1) % sides[corner_face]]

    # half-edges -> undirected edges
    ends = np.sort(np.stack([corner, following], axis=1), axis=1)
    edges, edge_of_corner, faces_of_edge = np.unique(ends, axis=0, return_inverse=True, return_counts=True)
    edge_of_corner = edge_of_corner.reshape(-1)  # NumPy 2.0 keeps an extra axis
    if len(edges) and faces_of_edge.max() > 2:
        raise TopologyError(f"faces must be manifold, got an edge with {faces_of_edge.max()} faces.")
    E = len(edges)
    hard = (faces_of_edge == 1) | _is_crease(edges, sharp)

    face_points = sparse.csr_matrix((1.0 / sides[corner_face], (corner_face, corner)), shape=(F, V))
    midpoints = sparse.csr_matrix((np.full(2 * E, 0.5), (np.repeat(np.arange(E), 2), edges.reshape(-1))), shape=(E, V))
    faces_at_edge = sparse.csr_matrix((np.ones(len(corner)), (edge_of_corner, corner_face)), shape=(E, F))
    smooth_edge = 0.5 * midpoints + 0.25 * (faces_at_edge @ face_points)
    edge_points = _pick_rows(hard, midpoints, smooth_edge)
    vertex_points = _vertex_rule(edges, hard, midpoints, face_points, corner, corner_face, V)

    matrix = sparse.vstack([vertex_points, edge_points, face_points], format="csr")
    # quad of each corner: corner, edge after it, face, edge before it
    first = np.concatenate([[0], np.cumsum(sides)[:-1]]) if F else np.zeros(0, np.int64)
    previous = first[corner_face] + (slot - 1) % sides[corner_face]
    quads = np.stack([corner, V + edge_of_corner, V + E + corner_face, V + edge_of_corner[previous]], axis=1)
    sharp_ids = np.flatnonzero(_is_crease(edges, sharp))
    finer_sharp = np.concatenate([np.stack([edges[sharp_ids, side], V + sharp_ids], axis=1) for side in (0, 1)])
    return (
        Subdivision(matrix, quads.astype(np.int32), edges.astype(np.int32), corner_face.astype(np.int32)),
        finer_sharp,
    )


def _is_crease(edges: NDArray[np.int64], sharp: NDArray[np.int64]) -> NDArray[np.bool_]:
    """Mark the edges named in `sharp`; refuse pairs that are no edge."""
    if not len(sharp):
        return np.zeros(len(edges), bool)
    size = int(max(edges.max(initial=0), sharp.max())) + 1
    codes, wanted = edges @ [size, 1], np.unique(sharp @ [size, 1])
    found = np.isin(codes, wanted)
    if int(found.sum()) != len(wanted):
        raise TopologyError(f"creases must be edges, got {len(wanted) - int(found.sum())} other pairs.")
    return found


def _pick_rows(choose: NDArray[np.bool_], yes: sparse.csr_matrix, no: sparse.csr_matrix) -> sparse.csr_matrix:
    """Take rows of `yes` where `choose` holds, of `no` elsewhere."""
    picked = choose.astype(float)
    return (sparse.diags(picked) @ yes + sparse.diags(1.0 - picked) @ no).tocsr()


def _vertex_rule(
    edges: NDArray[np.int64],
    hard: NDArray[np.bool_],
    midpoints: sparse.csr_matrix,
    face_points: sparse.csr_matrix,
    corner: NDArray[np.int64],
    corner_face: NDArray[np.int64],
    V: int,
) -> sparse.csr_matrix:
    """Move old vertices: smooth rule inside, curve rule on boundary and creases, fixed at corners."""
    E = len(edges)
    identity = sparse.identity(V, format="csr")
    edge_at_vertex = sparse.csr_matrix((np.ones(2 * E), (edges.reshape(-1), np.repeat(np.arange(E), 2))), (V, E))
    face_at_vertex = sparse.csr_matrix((np.ones(len(corner)), (corner, corner_face)), (V, face_points.shape[0]))
    valence = np.maximum(np.asarray(edge_at_vertex.sum(axis=1)).ravel(), 1)
    n_faces = np.maximum(np.asarray(face_at_vertex.sum(axis=1)).ravel(), 1)
    per_valence = sparse.diags(1.0 / valence)
    mean_face = sparse.diags(1.0 / n_faces) @ face_at_vertex @ face_points
    mean_edge = per_valence @ edge_at_vertex @ midpoints
    smooth = per_valence @ (mean_face + 2.0 * mean_edge) + sparse.diags((valence - 3.0) / valence) @ identity

    hard_at_vertex = edge_at_vertex @ sparse.diags(hard.astype(float))
    n_hard = np.asarray(hard_at_vertex.sum(axis=1)).ravel()
    curve = 0.5 * identity + 0.25 * (hard_at_vertex @ midpoints)  # 1/8, 6/8, 1/8
    isolated = np.asarray(edge_at_vertex.sum(axis=1)).ravel() == 0
    rule = _pick_rows(n_hard == 2, curve, smooth)
    return _pick_rows((n_hard > 2) | isolated, identity, rule)
