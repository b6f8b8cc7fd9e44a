"""Rotations: vectors, matrices, quaternions (wxyz), nearest rotation; thin over SciPy."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from facewright.errors import DegenerateError, ShapeError
from facewright.numeric.check import check_finite


def _check_last(name: str, array: NDArray[Any], *tail: int) -> None:
    if np.shape(array)[-len(tail) :] != tail:
        expected = ", ".join(("...", *map(str, tail)))
        raise ShapeError(f"{name} must have shape ({expected}), got {np.shape(array)}.")
    check_finite(name, array)


def matrix_from_rotation_vector(vector: NDArray[np.floating[Any]]) -> NDArray[np.float64]:
    """Return rotation matrices (..., 3, 3) for column vectors from axis times angle (..., 3), radians.

    Raises
    ------
    ShapeError, ValueRangeError
        If the last axis is not 3 or values are not finite.
    """
    _check_last("vector", vector, 3)
    flat = np.asarray(vector, dtype=np.float64).reshape(-1, 3)
    return Rotation.from_rotvec(flat).as_matrix().reshape(*np.shape(vector), 3)


def rotation_vector_from_matrix(matrix: NDArray[np.floating[Any]]) -> NDArray[np.float64]:
    """Return axis times angle (..., 3), radians, angle in [0, pi], of rotation matrices (..., 3, 3).

    Raises
    ------
    ShapeError, ValueRangeError
        If the last axes are not (3, 3) or values are not finite.
    """
    _check_last("matrix", matrix, 3, 3)
    flat = np.asarray(matrix, dtype=np.float64).reshape(-1, 3, 3)
    return Rotation.from_matrix(flat).as_rotvec().reshape(np.shape(matrix)[:-1])


def matrix_from_quaternion(wxyz: NDArray[np.floating[Any]]) -> NDArray[np.float64]:
    """Return rotation matrices (..., 3, 3) of quaternions (..., 4), scalar first; they need not have unit length.

    Raises
    ------
    ShapeError, ValueRangeError
        If the last axis is not 4 or values are not finite.
    DegenerateError
        If a quaternion is zero.
    """
    _check_last("wxyz", wxyz, 4)
    flat = np.asarray(wxyz, dtype=np.float64).reshape(-1, 4)
    if not np.linalg.norm(flat, axis=1).all():
        raise DegenerateError("wxyz must not be zero.")
    return Rotation.from_quat(flat[:, [1, 2, 3, 0]]).as_matrix().reshape(*np.shape(wxyz)[:-1], 3, 3)


def quaternion_from_matrix(matrix: NDArray[np.floating[Any]]) -> NDArray[np.float64]:
    """Return unit quaternions (..., 4), scalar first and not negative, of rotation matrices (..., 3, 3).

    Raises
    ------
    ShapeError, ValueRangeError
        If the last axes are not (3, 3) or values are not finite.
    """
    _check_last("matrix", matrix, 3, 3)
    flat = np.asarray(matrix, dtype=np.float64).reshape(-1, 3, 3)
    xyzw = Rotation.from_matrix(flat).as_quat(canonical=True)
    return xyzw[:, [3, 0, 1, 2]].reshape(*np.shape(matrix)[:-2], 4)


def nearest_rotation(matrix: NDArray[np.floating[Any]]) -> NDArray[np.float64]:
    """Return the rotations (..., 3, 3) nearest to matrices in the Frobenius norm; never reflections.

    Raises
    ------
    ShapeError, ValueRangeError
        If the last axes are not (3, 3) or values are not finite.
    DegenerateError
        If a matrix has rank below 2, or is a reflection without a unique nearest rotation.
    """
    _check_last("matrix", matrix, 3, 3)
    U, d, Vt = np.linalg.svd(np.asarray(matrix, dtype=np.float64))
    sign = np.sign(np.linalg.det(U @ Vt))
    if (d[..., 1] + sign * d[..., 2] <= 1e-12 * d[..., 0]).any():
        raise DegenerateError("matrix must have a unique nearest rotation.")
    scale = np.stack([np.ones_like(sign), np.ones_like(sign), sign], axis=-1)
    return (U * scale[..., None, :]) @ Vt
