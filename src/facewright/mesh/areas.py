"""Areas of triangles, of vertices and of whole meshes."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from facewright.mesh.normals import face_area_vectors


def face_areas(vertices: NDArray[np.floating[Any]], faces: NDArray[np.integer[Any]]) -> NDArray[np.floating[Any]]:
    """Return the area of each triangle, shape (F,), mm^2.

    Raises
    ------
    ShapeError, ValueRangeError
        If shapes are wrong or an index is outside [0, V).
    """
    return 0.5 * np.linalg.norm(face_area_vectors(vertices, faces), axis=1)


def vertex_areas(vertices: NDArray[np.floating[Any]], faces: NDArray[np.integer[Any]]) -> NDArray[np.float64]:
    """Return the barycentric area of each vertex, a third of its triangles' areas, shape (V,), mm^2.

    Raises
    ------
    ShapeError, ValueRangeError
        If shapes are wrong or an index is outside [0, V).
    """
    third = face_areas(vertices, faces).astype(np.float64) / 3.0
    areas = np.zeros(len(vertices))
    np.add.at(areas, np.asarray(faces).ravel(), np.repeat(third, 3))
    return areas


def mean_edge_length(vertices: NDArray[np.floating[Any]], faces: NDArray[np.integer[Any]]) -> float:
    """Return the mean length of all edges, mm; 0 for a mesh without triangles."""
    from facewright.mesh.connectivity import unique_edges

    edges = unique_edges(faces)
    if not len(edges):
        return 0.0
    points = np.asarray(vertices, dtype=np.float64)
    return float(np.linalg.norm(points[edges[:, 0]] - points[edges[:, 1]], axis=1).mean())
