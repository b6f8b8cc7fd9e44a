"""Local frames of triangles and the deformation gradients between two poses of a mesh."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from facewright.errors import DegenerateError
from facewright.numeric.check import check_indices, check_shape


def triangle_frames(vertices: NDArray[np.floating[Any]], faces: NDArray[np.integer[Any]]) -> NDArray[np.float64]:
    """Return the frame V = [v2 - v1, v3 - v1, v4 - v1] of every triangle.

    The fourth vertex stands on the first one, v4 = v1 + n / sqrt(|n|) with n = (v2 - v1) x (v3 - v1), so that the
    third column scales like an edge [1]_.

    Parameters
    ----------
    vertices : ndarray of shape (V, 3) or (T, V, 3), millimetres
        One pose or several.
    faces : ndarray of shape (F, 3), int
        Triangles.

    Returns
    -------
    ndarray of shape (F, 3, 3) or (T, F, 3, 3), float64, millimetres
        Frames, vectors in columns; the third column of a triangle without area is zero.

    Raises
    ------
    ShapeError, ValueRangeError
        If the shapes are wrong or an index is outside [0, V).

    References
    ----------
    .. [1] Sumner and Popovic, Deformation transfer for triangle meshes, SIGGRAPH 2004, section 3.
    """
    points = np.asarray(vertices, dtype=np.float64)
    check_shape("vertices", points, *(("V", 3) if points.ndim == 2 else ("T", "V", 3)))
    check_shape("faces", faces, "F", 3)
    check_indices("faces", faces, points.shape[-2])
    corner = points[..., faces[:, 0], :]
    first, second = points[..., faces[:, 1], :] - corner, points[..., faces[:, 2], :] - corner
    normal = np.cross(first, second)
    length = np.linalg.norm(normal, axis=-1, keepdims=True)
    third = normal / np.sqrt(np.where(length > 0, length, 1.0))
    return np.stack([first, second, third], axis=-1)


def inverse_frames(frames: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return V^-1 of frames (..., 3, 3) in closed form; rows are dual to the columns of V. Not for flat triangles."""
    a, b, c = frames[..., 0], frames[..., 1], frames[..., 2]
    rows = np.stack([np.cross(b, c), np.cross(c, a), np.cross(a, b)], axis=-2)
    return rows / (rows[..., 0, :] * a).sum(axis=-1)[..., None, None]


def degenerate_triangles(frames: NDArray[np.float64], tolerance: float = 1e-9) -> NDArray[np.bool_]:
    """Tell which frames (F, 3, 3) have no area: twice the area at most `tolerance` of the squared longest side."""
    first, second = frames[..., 0], frames[..., 1]
    sides = np.stack([first, second, second - first])
    longest = (sides**2).sum(axis=-1).max(axis=0)
    twice_area = np.linalg.norm(np.cross(first, second), axis=-1)
    return ~(twice_area > tolerance * longest)


def deformation_gradients(
    neutral: NDArray[np.floating[Any]],
    deformed: NDArray[np.floating[Any]],
    faces: NDArray[np.integer[Any]],
) -> NDArray[np.float64]:
    """Return Q = V~ V^-1 of every triangle: the affine change of its frame from neutral to deformed.

    Parameters
    ----------
    neutral : ndarray of shape (V, 3), millimetres
        Rest pose.
    deformed : ndarray of shape (V, 3) or (T, V, 3), millimetres
        One pose or several.
    faces : ndarray of shape (F, 3), int
        Triangles.

    Returns
    -------
    ndarray of shape (F, 3, 3) or (T, F, 3, 3), float64
        Deformation gradients for column vectors; the identity for a pose equal to the neutral.

    Raises
    ------
    ShapeError, ValueRangeError
        If shapes differ or an index is outside [0, V).
    DegenerateError
        If a triangle of the neutral has no area.
    """
    frames = triangle_frames(neutral, faces)
    check_shape("deformed", deformed, *np.shape(deformed)[:-2], len(neutral), 3)
    flat = degenerate_triangles(frames)
    if flat.any():
        raise DegenerateError(f"neutral must have triangles with an area, got {int(flat.sum())} without.")
    return triangle_frames(deformed, faces) @ inverse_frames(frames)
