"""Texture corners of polygons, from those of the triangles that they were cut into."""

from __future__ import annotations

from itertools import combinations

import numpy as np
from numpy.typing import NDArray

from facewright.numeric.check import check_shape


def polygon_uv(
    polygons: NDArray[np.integer], faces: NDArray[np.integer], uv_faces: NDArray[np.integer]
) -> NDArray[np.int32] | None:
    """Find the texture point of each corner of each polygon.

    Parameters
    ----------
    polygons : ndarray of shape (P, 4), int
        Quads; -1 in the last column marks a triangle.
    faces : ndarray of shape (F, 3), int
        Triangles that `polygons` were cut into, along either diagonal.
    uv_faces : ndarray of shape (F, 3), int
        Texture points of the corners of `faces`.

    Returns
    -------
    ndarray of shape (P, 4), int32, or None
        Texture points, -1 where `polygons` has -1; None if some corner belongs to no triangle of `faces`.

    Raises
    ------
    ShapeError
        If an array has another shape.
    """
    check_shape("polygons", polygons, "P", 4)
    F = check_shape("faces", faces, "F", 3)["F"]
    check_shape("uv_faces", uv_faces, F, 3)
    if not F:
        return None if (polygons >= 0).any() else polygons.astype(np.int32)
    base = int(max(polygons.max(initial=0), faces.max(initial=0))) + 2
    keys = _triangle_keys(faces.astype(np.int64), base)
    order = np.argsort(keys)
    found = np.full(polygons.shape, -1, dtype=np.int32)
    for corners in combinations(range(4), 3):  # the four triangles that a quad may be cut into
        wanted = polygons[:, corners].astype(np.int64)
        at = np.searchsorted(keys, _triangle_keys(wanted, base), sorter=order)
        row = order[np.minimum(at, F - 1)]
        hit = keys[row] == _triangle_keys(wanted, base)
        for column in corners:
            same = faces[row] == polygons[:, column, None]
            points = np.take_along_axis(uv_faces[row], same.argmax(axis=1)[:, None], axis=1)[:, 0]
            found[:, column] = np.where(hit, points, found[:, column])
    found[polygons < 0] = -1
    return None if (found[polygons >= 0] < 0).any() else found


def _triangle_keys(triangles: NDArray[np.int64], base: int) -> NDArray[np.int64]:
    """Give one number per unordered triple of vertices."""
    a, b, c = np.sort(triangles, axis=1).T
    return ((a + 1) * base + b) * base + c
