"""Normals of triangles and vertices."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from facewright.numeric.check import check_indices, check_shape


def face_area_vectors(vertices: NDArray[np.floating], faces: NDArray[np.integer]) -> NDArray[np.floating]:
    """Return each triangle's normal times twice its area, shape (F, 3), in the vertices' unit squared.

    Raises
    ------
    ShapeError, ValueRangeError
        If `vertices` is not (V, 3), `faces` not (F, 3) or an index is out of range.
    """
    check_shape("vertices", vertices, "V", 3)
    check_shape("faces", faces, "F", 3)
    check_indices("faces", faces, len(vertices))
    a, b, c = vertices[faces[:, 0]], vertices[faces[:, 1]], vertices[faces[:, 2]]
    return np.cross(b - a, c - a)


def vertex_normals(vertices: NDArray[np.floating], faces: NDArray[np.integer]) -> NDArray[np.floating]:
    """Return unit vertex normals, area-weighted, shape (V, 3); zero where a vertex has no triangle.

    Parameters
    ----------
    vertices : ndarray of shape (V, 3)
        Positions; not modified.
    faces : ndarray of shape (F, 3)
        Triangles, counter-clockwise seen from outside.

    Raises
    ------
    ShapeError, ValueRangeError
        If `vertices` is not (V, 3), `faces` not (F, 3) or an index is out of range.
    """
    area = face_area_vectors(vertices, faces)
    corners = faces.ravel()
    summed = np.stack(
        [np.bincount(corners, np.repeat(area[:, k], 3), minlength=len(vertices)) for k in range(3)], axis=1
    ).astype(area.dtype)
    length = np.linalg.norm(summed, axis=1, keepdims=True)
    return np.divide(summed, length, out=np.zeros_like(summed), where=length > 0)
