"""Weak perspective, p = s R v + t: projection and pose from point pairs (FaceWarehouse eq. 13)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from facewright.camera.rotation import rotation_from_vector
from facewright.errors import DegenerateError, ValueRangeError
from facewright.numeric.check import check_finite, check_shape


@dataclass(frozen=True, eq=False)
class WeakPerspective:
    """A scaled orthographic camera: p = s R v + t, of which the first two rows are pixels.

    Parameters
    ----------
    scale : float
        s, pixels per millimetre.
    rotation : ndarray of shape (3, 3), float64
        R = camera_from_model (x right, y down, z away), for column vectors.
    translation : ndarray of shape (2,), float64, pixels
        t.
    """

    scale: float
    rotation: NDArray[np.float64]
    translation: NDArray[np.float64]

    def __post_init__(self) -> None:
        check_shape("rotation", self.rotation, 3, 3)
        check_shape("translation", self.translation, 2)
        if not (np.isfinite(self.scale) and self.scale > 0):
            raise ValueRangeError(f"scale must be positive, got {self.scale}.")

    @property
    def matrix(self) -> NDArray[np.float64]:
        """The first two rows of s R, shape (2, 3)."""
        return self.scale * self.rotation[:2]

    def project(self, points: NDArray[np.floating]) -> NDArray[np.float64]:
        """Project model points (..., 3), millimetres, to pixels (..., 2)."""
        return points @ self.matrix.T + self.translation  # Eq. (13)

    def camera_points(self, points: NDArray[np.floating]) -> NDArray[np.float64]:
        """Rotate model points (..., 3) into the camera's axes, millimetres; depth has no origin in this camera."""
        return points @ self.rotation.T


def estimate_weak_perspective(
    points: NDArray[np.floating],
    pixels: NDArray[np.floating],
    weights: NDArray[np.floating] | None = None,
    start: WeakPerspective | None = None,
    iterations: int = 10,
) -> WeakPerspective:
    r"""Find the weak-perspective camera that best projects points onto pixels.

    Minimises :math:`\sum_k w_k \|s R v_k + t - p_k\|^2`: the best affine camera gives the start, Gauss-Newton on
    rotation and scale the optimum; the translation is eliminated.

    Parameters
    ----------
    points : ndarray of shape (N, 3), millimetres
        Model points v, N >= 4, not in one plane (of the points in one plane two poses fit equally well).
    pixels : ndarray of shape (N, 2)
        Their pictures p.
    weights : ndarray of shape (N,), optional
        Weights w >= 0; all 1 where absent.
    start : WeakPerspective, optional
        Where to start, instead of the affine camera; then any three points that are not on a line are enough.
    iterations : int
        At most so many Gauss-Newton steps; a handful is used.

    Returns
    -------
    WeakPerspective
        The camera.

    Raises
    ------
    ShapeError, ValueRangeError
        If shapes do not match, values are not finite or a weight is negative.
    DegenerateError
        If the points do not determine a pose.

    Notes
    -----
    FaceWarehouse 4.1.2, the pose step of the coordinate descent on (14).
    """
    sizes = check_shape("points", points, "N", 3)
    check_shape("pixels", pixels, "N", 2, **sizes)
    check_finite("points", points)
    check_finite("pixels", pixels)
    w = np.ones(sizes["N"]) if weights is None else np.asarray(weights, dtype=np.float64)
    check_shape("weights", w, "N", **sizes)
    if not (w >= 0).all() or not np.isfinite(w).all():
        raise ValueRangeError("weights must be finite and not negative.")
    total = float(w.sum())
    if total <= 0:
        raise DegenerateError("at least 4 points must have positive weight, got none.")
    root = np.sqrt(w / total)[:, None]
    mean_v, mean_p = root[:, 0] ** 2 @ points, root[:, 0] ** 2 @ pixels
    v, p = root * (points - mean_v), root * (pixels - mean_p)
    if np.linalg.norm(p) <= 1e-9 * (1.0 + np.linalg.norm(mean_p)):
        raise DegenerateError("pixels must not lie in one spot, which gives no scale.")
    if start is None:
        scale, rotation = _affine_start(v, p)
    else:
        scale, rotation = start.scale, start.rotation
    for _ in range(iterations):
        scale, rotation, change = _pose_step(v, p, scale, rotation)
        if change < 1e-10:
            break
    if not (np.isfinite(scale) and scale > 0):
        raise DegenerateError("points and pixels must determine a scale: the pixels lie in one spot.")
    return WeakPerspective(scale, rotation, mean_p - scale * rotation[:2] @ mean_v)


def _affine_start(v: NDArray[np.float64], p: NDArray[np.float64]) -> tuple[float, NDArray[np.float64]]:
    """Return scale and rotation nearest to the best affine camera of centred points."""
    U, d, Vt = np.linalg.svd(v, full_matrices=False)
    if len(v) < 4 or d[2] <= 1e-6 * d[0]:
        raise DegenerateError("points must be at least 4 and not lie in one plane to determine a pose.")
    A = (Vt.T @ ((U.T @ p) / d[:, None])).T  # (2, 3)
    U2, d2, Vt2 = np.linalg.svd(A, full_matrices=False)
    scale = float(d2.mean())
    rows = U2 @ Vt2
    return scale, np.vstack([rows, np.cross(rows[0], rows[1])])


def _pose_step(
    v: NDArray[np.float64], p: NDArray[np.float64], scale: float, rotation: NDArray[np.float64]
) -> tuple[float, NDArray[np.float64], float]:
    """Take one Gauss-Newton step in the rotation vector (on the camera's side) and the logarithm of the scale."""
    q = scale * v @ rotation.T  # (N, 3) turned points, of which x and y are seen
    residual = (p - q[:, :2]).ravel()
    J = np.zeros((len(v), 2, 4))
    J[:, 0, 1], J[:, 0, 2], J[:, 0, 3] = q[:, 2], -q[:, 1], q[:, 0]  # d x / d (wx, wy, wz, log s)
    J[:, 1, 0], J[:, 1, 2], J[:, 1, 3] = -q[:, 2], q[:, 0], q[:, 1]
    J2 = J.reshape(-1, 4)
    H = J2.T @ J2
    damping = 1e-9 * np.trace(H) + 1e-30
    step = np.linalg.solve(H + damping * np.eye(4), J2.T @ residual)
    length = float(np.linalg.norm(step))
    step *= min(1.0, 0.5 / max(length, 1e-300))  # at most half a radian at once
    return scale * float(np.exp(step[3])), rotation_from_vector(step[:3]) @ rotation, length
