"""Distances along the surface: shortest paths over edges and diagonals, and the heat method."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy import sparse
from scipy.sparse.csgraph import dijkstra

from facewright.errors import ValueRangeError
from facewright.mesh.areas import face_areas, mean_edge_length
from facewright.mesh.connectivity import half_edges, unique_edges, vertex_components
from facewright.mesh.gradient import gradient_operator
from facewright.mesh.laplacian import cotangent_laplacian, mass_matrix
from facewright.numeric.check import check_indices, check_shape
from facewright.numeric.sparse_solve import SymmetricSolver


def path_graph(
    vertices: NDArray[np.floating[Any]], faces: NDArray[np.integer[Any]], *, diagonals: bool = True
) -> sparse.csr_matrix:
    """Return the symmetric (V, V) graph of path lengths along the surface, CSR, float64, mm.

    With `diagonals` the two far corners of every two triangles that share an edge are joined too, by the straight line
    in the flattened pair where it crosses the shared edge, and else over the nearer end of that edge. For a
    triangulated quad these are both diagonals, which halves the error of paths over edges.

    Raises
    ------
    ShapeError, ValueRangeError
        If shapes are wrong or an index is outside [0, V).
    """
    V = check_shape("vertices", vertices, "V", 3)["V"]
    check_shape("faces", faces, "F", 3)
    check_indices("faces", faces, V)
    points = np.asarray(vertices, dtype=np.float64)
    edges = unique_edges(faces)
    lengths = np.linalg.norm(points[edges[:, 0]] - points[edges[:, 1]], axis=1)
    if diagonals:
        ends, far = _triangle_pairs(np.asarray(faces))
        edges = np.concatenate([edges, far])
        lengths = np.concatenate([lengths, _flattened_distance(points, ends, far)])
    # Two ways between the same vertices: keep the shorter one.
    i, k = edges.min(axis=1), edges.max(axis=1)
    order = np.lexsort((lengths, k, i))
    i, k, lengths = i[order], k[order], lengths[order]
    first = np.r_[True, (np.diff(i) != 0) | (np.diff(k) != 0)][: len(i)] & (i != k)
    i, k, lengths = i[first], k[first], lengths[first]
    rows, columns = np.concatenate([i, k]), np.concatenate([k, i])
    return sparse.csr_matrix((np.concatenate([lengths, lengths]), (rows, columns)), shape=(V, V))


def _triangle_pairs(faces: NDArray[np.integer[Any]]) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Return the ends (N, 2) of edges with two triangles, and those triangles' far corners (N, 2)."""
    directed = half_edges(faces)
    opposite = np.concatenate([faces[:, 2], faces[:, 0], faces[:, 1]]).astype(np.int64)
    pairs = np.sort(directed, axis=1)
    keys = pairs[:, 0] * (int(pairs.max(initial=0)) + 1) + pairs[:, 1]
    order = np.argsort(keys, kind="stable")
    _, first, counts = np.unique(keys[order], return_index=True, return_counts=True)
    one, other = order[first[counts == 2]], order[first[counts == 2] + 1]
    return pairs[one], np.stack([opposite[one], opposite[other]], axis=1)


def _flattened_distance(
    points: NDArray[np.float64], ends: NDArray[np.int64], far: NDArray[np.int64]
) -> NDArray[np.float64]:
    """Return the distance of the far corners when both triangles are turned into one plane."""
    start = points[ends[:, 0]]
    axis = points[ends[:, 1]] - start
    length = np.maximum(np.linalg.norm(axis, axis=1), 1e-300)
    along, across = [], []
    for corner in far.T:
        arm = points[corner] - start
        s = (arm * axis).sum(axis=1) / length
        along.append(s)
        across.append(np.sqrt(np.maximum((arm**2).sum(axis=1) - s**2, 0.0)))
    total = np.maximum(across[0] + across[1], 1e-300)
    crossing = along[0] + (along[1] - along[0]) * across[0] / total
    straight = np.hypot(along[1] - along[0], across[0] + across[1])
    over_start = np.hypot(along[0], across[0]) + np.hypot(along[1], across[1])
    over_end = np.hypot(along[0] - length, across[0]) + np.hypot(along[1] - length, across[1])
    inside = (crossing >= 0) & (crossing <= length)
    return np.where(inside, straight, np.minimum(over_start, over_end))


def path_distances(
    vertices: NDArray[np.floating[Any]],
    faces: NDArray[np.integer[Any]],
    sources: NDArray[np.integer[Any]],
    *,
    diagonals: bool = True,
    limit_mm: float = np.inf,
) -> NDArray[np.float64]:
    """Return shortest path lengths from each source to all vertices (Dijkstra on `path_graph`).

    Parameters
    ----------
    vertices : ndarray of shape (V, 3), millimetres
        Positions.
    faces : ndarray of shape (F, 3), int
        Triangles.
    sources : ndarray of shape (S,), int
        Vertices to start from.
    diagonals : bool
        See `path_graph`. Distances are never too short by more than the bend of triangle pairs.
    limit_mm : float
        Search no further, mm.

    Returns
    -------
    ndarray of shape (S, V), float64, millimetres
        Distances; infinite in other components and beyond the limit.

    Raises
    ------
    ShapeError, ValueRangeError
        If shapes are wrong or an index is outside [0, V).
    """
    graph = path_graph(vertices, faces, diagonals=diagonals)
    check_shape("sources", sources, "S")
    check_indices("sources", sources, graph.shape[0])
    return dijkstra(graph, directed=False, indices=np.asarray(sources), limit=limit_mm)


class HeatGeodesics:
    """Geodesic distance by the heat method, factored once for a mesh [1]_.

    Parameters
    ----------
    vertices : ndarray of shape (V, 3), millimetres
        Positions.
    faces : ndarray of shape (F, 3), int
        Triangles, all with an area.
    time_factor : float
        Diffusion time in squared mean edge lengths: larger is smoother.

    Raises
    ------
    ShapeError, ValueRangeError
        If shapes are wrong, an index is outside [0, V), or the factor is not positive.
    DegenerateError
        If a triangle has no area.

    References
    ----------
    .. [1] Crane, Weischedel, Wardetzky, Geodesics in heat, ACM TOG 2013.
    """

    def __init__(
        self,
        vertices: NDArray[np.floating[Any]],
        faces: NDArray[np.integer[Any]],
        *,
        time_factor: float = 1.0,
    ) -> None:
        if not (time_factor > 0 and np.isfinite(time_factor)):
            raise ValueRangeError(f"time_factor must be positive, got {time_factor}.")
        laplacian = cotangent_laplacian(vertices, faces)
        mass = mass_matrix(vertices, faces)
        self.labels = vertex_components(faces, len(vertices))
        self._gradient = gradient_operator(vertices, faces)
        self._areas = face_areas(vertices, faces).astype(np.float64)
        time = time_factor * mean_edge_length(vertices, faces) ** 2
        pins = np.zeros(len(vertices))
        pins[np.unique(self.labels, return_index=True)[1]] = 1.0
        unused = sparse.diags((mass.diagonal() == 0).astype(np.float64))
        self._heat = SymmetricSolver(mass + time * laplacian + unused)
        self._poisson = SymmetricSolver(
            self._gradient.T @ sparse.diags(np.repeat(self._areas, 3)) @ self._gradient + sparse.diags(pins)
        )

    def distances(self, sources: NDArray[np.integer[Any]]) -> NDArray[np.float64]:
        """Return the distance of every vertex to the nearest source, shape (V,), mm; infinite in other components.

        Raises
        ------
        ShapeError, ValueRangeError
            If `sources` is not (S,) with S > 0 or an index is outside [0, V).
        """
        V = len(self.labels)
        check_shape("sources", sources, "S")
        check_indices("sources", sources, V)
        if not len(sources):
            raise ValueRangeError("sources must not be empty.")
        impulse = np.zeros(V)
        impulse[sources] = 1.0
        heat = self._heat.solve(impulse)  # (I) integrate the heat flow for a short time
        flow = (self._gradient @ heat).reshape(-1, 3)
        size = np.linalg.norm(flow, axis=1, keepdims=True)
        field = -np.divide(flow, size, out=np.zeros_like(flow), where=size > 0)  # (II) unit field X
        divergence = self._gradient.T @ (field * self._areas[:, None]).ravel()
        distance = self._poisson.solve(divergence)  # (III) Laplace(phi) = div X
        lowest = np.full(int(self.labels.max()) + 1, np.inf)
        np.minimum.at(lowest, self.labels[sources], distance[sources])
        distance = np.maximum(distance - np.where(np.isfinite(lowest), lowest, 0.0)[self.labels], 0.0)
        return np.where(np.isfinite(lowest)[self.labels], distance, np.inf)


def heat_distances(
    vertices: NDArray[np.floating[Any]],
    faces: NDArray[np.integer[Any]],
    sources: NDArray[np.integer[Any]],
) -> NDArray[np.float64]:
    """Return geodesic distances (V,) to the nearest source once; see `HeatGeodesics`."""
    return HeatGeodesics(vertices, faces).distances(sources)
