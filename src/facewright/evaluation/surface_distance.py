"""Distances between face meshes: to the surface, and between corresponding vertices, after alignment."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from facewright.numeric.check import check_indices, check_shape


class MeshDistance(NamedTuple):
    """Mean distances of a mesh from the truth, millimetres.

    Parameters
    ----------
    surface_mm : float
        From the mesh's vertices to the nearest point of the true surface, after the best similarity.
    correspondence_mm : float
        Between corresponding vertices, after the same similarity.
    rigid_correspondence_mm : float
        Between corresponding vertices after the best rigid motion, without change of size.
    """

    surface_mm: float
    correspondence_mm: float
    rigid_correspondence_mm: float


def mesh_distance(
    vertices: NDArray[np.floating],
    truth: NDArray[np.floating],
    faces: NDArray[np.integer],
    region: NDArray[np.integer],
) -> MeshDistance:
    """Measure how far a mesh is from the truth over a region.

    Parameters
    ----------
    vertices, truth : ndarray of shape (V, 3), millimetres
        Meshes of one topology.
    faces : ndarray of shape (F, 3)
        Its triangles.
    region : ndarray of int
        Vertices that are aligned and measured.

    Returns
    -------
    MeshDistance
        Means over the region.
    """
    sizes = check_shape("vertices", vertices, "V", 3)
    check_shape("truth", truth, "V", 3, **sizes)
    check_indices("region", region, sizes["V"])
    ours, true = vertices[region].astype(np.float64), truth[region].astype(np.float64)
    similar, rigid = _aligned(ours, true, True), _aligned(ours, true, False)
    return MeshDistance(
        float(surface_distances(similar, truth, faces).mean()),
        float(np.linalg.norm(similar - true, axis=1).mean()),
        float(np.linalg.norm(rigid - true, axis=1).mean()),
    )


def surface_distances(
    points: NDArray[np.floating], vertices: NDArray[np.floating], faces: NDArray[np.integer], n_nearest: int = 4
) -> NDArray[np.float64]:
    """Return the distance of points (N, 3) from a surface, (N,).

    The nearest point is sought in all triangles that touch the `n_nearest` nearest vertices.
    """
    check_shape("points", points, "N", 3)
    triangles = np.ascontiguousarray(faces, dtype=np.int64)
    corner_of = np.argsort(triangles.ravel(), kind="stable")
    first = np.searchsorted(triangles.ravel()[corner_of], np.arange(len(vertices) + 1))
    near = cKDTree(vertices).query(points, k=n_nearest)[1].reshape(len(points), -1)
    return _distances(
        np.ascontiguousarray(points, dtype=np.float64),
        np.ascontiguousarray(vertices, dtype=np.float64),
        triangles,
        near.astype(np.int64),
        first.astype(np.int64),
        (corner_of // 3).astype(np.int64),
    )


def _aligned(source: NDArray[np.float64], target: NDArray[np.float64], with_scale: bool) -> NDArray[np.float64]:
    """Move source onto target by the best similarity or rigid motion (Umeyama 1991)."""
    mean_x, mean_y = source.mean(axis=0), target.mean(axis=0)
    x, y = source - mean_x, target - mean_y
    U, d, Vt = np.linalg.svd(y.T @ x)
    sign = np.array([1.0, 1.0, np.linalg.det(U @ Vt)])
    scale = float(d @ sign / (x**2).sum()) if with_scale else 1.0
    return scale * x @ ((U * sign) @ Vt).T + mean_y


@njit(cache=True)
def _distances(points, vertices, triangles, near, first, touching):  # type: ignore[no-untyped-def]
    out = np.empty(len(points))
    for i in range(len(points)):
        best = np.inf
        for k in range(near.shape[1]):
            v = near[i, k]
            for j in range(first[v], first[v + 1]):
                t = triangles[touching[j]]
                best = min(best, _to_triangle(points[i], vertices[t[0]], vertices[t[1]], vertices[t[2]]))
        out[i] = np.sqrt(best)
    return out


@njit(cache=True)
def _to_triangle(p, a, b, c):  # type: ignore[no-untyped-def]
    """Return the squared distance of a point from a triangle, by the region of the plane it projects to."""
    ab, ac, ap = b - a, c - a, p - a
    normal = np.cross(ab, ac)
    area2 = normal @ normal
    if area2 > 0.0:
        v = np.cross(ap, ac) @ normal / area2
        w = np.cross(ab, ap) @ normal / area2
        if v >= 0.0 and w >= 0.0 and v + w <= 1.0:
            height = ap @ normal
            return height * height / area2
    return min(_to_segment(p, a, b), _to_segment(p, b, c), _to_segment(p, c, a))


@njit(cache=True)
def _to_segment(p, a, b):  # type: ignore[no-untyped-def]
    along = b - a
    length2 = along @ along
    share = 0.0
    if length2 > 0.0:
        share = min(max((p - a) @ along / length2, 0.0), 1.0)
    offset = p - a - share * along
    return offset @ offset
