"""Rotations of cameras and heads: rotation vectors, and the yaw, pitch and roll of a head before a camera."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from facewright.numeric.check import check_shape

#: camera_from_model of a head that looks straight into the camera: model y up and z forward, camera y down and z away.
FRONTAL = np.diag([1.0, -1.0, -1.0])


def cross_matrix(vector: ArrayLike) -> NDArray[np.float64]:
    """Return the matrix of the cross product with `vector` (3,): ``cross_matrix(a) @ b == np.cross(a, b)``."""
    x, y, z = np.asarray(vector, dtype=np.float64)
    return np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])


def rotation_from_vector(vector: ArrayLike) -> NDArray[np.float64]:
    """Turn a rotation vector (axis times angle in radians) into a matrix, by Rodrigues' formula.

    Parameters
    ----------
    vector : array_like of shape (3,), radians
        Axis times angle.

    Returns
    -------
    ndarray of shape (3, 3), float64
        Rotation matrix for column vectors.

    Examples
    --------
    >>> rotation_from_vector([0.0, 0.0, np.pi / 2]).round(6) @ [1.0, 0.0, 0.0]
    array([0., 1., 0.])
    """
    w = np.asarray(vector, dtype=np.float64)
    check_shape("vector", w, 3)
    angle = float(np.sqrt(w @ w))
    K = cross_matrix(w)
    if angle < 1e-8:
        return np.eye(3) + K + 0.5 * K @ K
    return np.eye(3) + (np.sin(angle) / angle) * K + ((1.0 - np.cos(angle)) / angle**2) * (K @ K)


def rotation_angle(a: ArrayLike, b: ArrayLike) -> float:
    """Return the angle, in radians, of the rotation that takes matrix `a` to matrix `b`."""
    difference = np.asarray(a, dtype=np.float64).T @ np.asarray(b, dtype=np.float64)
    # the skew part is exact for small angles, where the trace is not
    sine = 0.5 * np.linalg.norm(
        [
            difference[2, 1] - difference[1, 2],
            difference[0, 2] - difference[2, 0],
            difference[1, 0] - difference[0, 1],
        ]
    )
    return float(np.arctan2(sine, 0.5 * (np.trace(difference) - 1.0)))


def rotation_from_head_angles(yaw_degrees: float, pitch_degrees: float, roll_degrees: float) -> NDArray[np.float64]:
    """Return camera_from_model of a head turned by yaw, then pitch, then roll before the camera.

    Parameters
    ----------
    yaw_degrees : float
        Positive turns the face towards its own left (the picture's right).
    pitch_degrees : float
        Positive looks up.
    roll_degrees : float
        Positive leans the head towards the picture's right.

    Returns
    -------
    ndarray of shape (3, 3), float64
        Rotation from model space (y up, face along +z) to the camera (x right, y down, z away).
    """
    yaw, pitch, roll = np.deg2rad([yaw_degrees, pitch_degrees, roll_degrees])
    turn = rotation_from_vector([0.0, yaw, 0.0])
    nod = rotation_from_vector([-pitch, 0.0, 0.0])
    lean = rotation_from_vector([0.0, 0.0, -roll])
    return FRONTAL @ lean @ nod @ turn


def head_angles_from_rotation(camera_from_model: ArrayLike) -> tuple[float, float, float]:
    """Return yaw, pitch and roll, in degrees, of a head; the inverse of `rotation_from_head_angles`."""
    M = FRONTAL @ np.asarray(camera_from_model, dtype=np.float64)
    yaw = np.arctan2(-M[2, 0], M[2, 2])
    pitch = np.arcsin(np.clip(-M[2, 1], -1.0, 1.0))
    roll = np.arctan2(M[0, 1], M[1, 1])
    return float(np.rad2deg(yaw)), float(np.rad2deg(pitch)), float(np.rad2deg(roll))
