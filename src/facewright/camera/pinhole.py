"""The pinhole camera: intrinsics, rigid motion, and pose from point pairs."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from facewright.camera.rotation import rotation_from_vector
from facewright.camera.weak_perspective import WeakPerspective, estimate_weak_perspective
from facewright.errors import DegenerateError, ValueRangeError
from facewright.numeric.check import check_finite, check_shape


@dataclass(frozen=True)
class Intrinsics:
    """Focal lengths and principal point of a pinhole camera without distortion, pixels.

    Parameters
    ----------
    focal_x, focal_y : float
        Focal lengths.
    centre_x, centre_y : float
        Principal point; the centre of the first pixel is (0, 0).
    """

    focal_x: float
    focal_y: float
    centre_x: float
    centre_y: float

    def __post_init__(self) -> None:
        values = (self.focal_x, self.focal_y, self.centre_x, self.centre_y)
        if not np.isfinite(values).all() or self.focal_x <= 0 or self.focal_y <= 0:
            raise ValueRangeError(f"intrinsics must be finite with positive focal lengths, got {values}.")

    @classmethod
    def for_image(cls, size: tuple[int, int], focal_length: float | None = None) -> Intrinsics:
        """Return the camera of a picture of `size` (height, width) that was not cropped.

        Without `focal_length` (pixels), 1.5 times the longer side is taken: a portrait lens of 50 to 60 mm in the
        terms of 35 mm film.
        """
        height, width = size
        focal = 1.5 * max(height, width) if focal_length is None else float(focal_length)
        return cls(focal, focal, (width - 1) / 2, (height - 1) / 2)

    @property
    def matrix(self) -> NDArray[np.float64]:
        """K, shape (3, 3)."""
        return np.array([[self.focal_x, 0.0, self.centre_x], [0.0, self.focal_y, self.centre_y], [0.0, 0.0, 1.0]])

    def project(self, camera_points: NDArray[np.floating]) -> NDArray[np.float64]:
        """Project points (..., 3) of the camera's frame, z > 0, to pixels (..., 2)."""
        z = camera_points[..., 2:]
        focal = np.array([self.focal_x, self.focal_y])
        return camera_points[..., :2] / z * focal + [self.centre_x, self.centre_y]


@dataclass(frozen=True, eq=False)
class RigidMotion:
    """x -> R x + t, such as camera_from_model.

    Parameters
    ----------
    rotation : ndarray of shape (3, 3), float64
        R, for column vectors.
    translation : ndarray of shape (3,), float64, millimetres
        t.
    """

    rotation: NDArray[np.float64]
    translation: NDArray[np.float64]

    def __post_init__(self) -> None:
        check_shape("rotation", self.rotation, 3, 3)
        check_shape("translation", self.translation, 3)

    def apply(self, points: NDArray[np.floating]) -> NDArray[np.float64]:
        """Move points (..., 3)."""
        return points @ self.rotation.T + self.translation

    def inverse(self) -> RigidMotion:
        """Return the motion that undoes this one."""
        return RigidMotion(self.rotation.T, -self.rotation.T @ self.translation)

    def after(self, first: RigidMotion) -> RigidMotion:
        """Return the motion that applies `first` and then this one."""
        return RigidMotion(self.rotation @ first.rotation, self.rotation @ first.translation + self.translation)


def rigid_from_weak(camera: WeakPerspective, intrinsics: Intrinsics, centre: NDArray[np.floating]) -> RigidMotion:
    """Return the pinhole pose that agrees with a weak-perspective camera at the model point `centre` (3,).

    The depth is focal length over scale: the distance at which a millimetre has the size that it has in the picture.
    """
    depth = 0.5 * (intrinsics.focal_x + intrinsics.focal_y) / camera.scale
    x, y = camera.project(np.asarray(centre, dtype=np.float64))
    seen = np.array(
        [
            (x - intrinsics.centre_x) / intrinsics.focal_x * depth,
            (y - intrinsics.centre_y) / intrinsics.focal_y * depth,
            depth,
        ]
    )
    return RigidMotion(camera.rotation, seen - camera.rotation @ centre)


def estimate_rigid_motion(
    points: NDArray[np.floating],
    pixels: NDArray[np.floating],
    intrinsics: Intrinsics,
    weights: NDArray[np.floating] | None = None,
    start: RigidMotion | None = None,
    iterations: int = 30,
) -> RigidMotion:
    r"""Find the pose in which points project onto pixels best, under full perspective.

    Minimises :math:`\sum_k w_k \|\pi(R v_k + t) - p_k\|^2` by Levenberg-Marquardt, from the weak-perspective pose.

    Parameters
    ----------
    points : ndarray of shape (N, 3), millimetres
        Model points v, N >= 4, not in one plane.
    pixels : ndarray of shape (N, 2)
        Their pictures p.
    intrinsics : Intrinsics
        The camera.
    weights : ndarray of shape (N,), optional
        Weights w >= 0; all 1 where absent.
    start : RigidMotion, optional
        Where to start.
    iterations : int
        At most so many steps.

    Returns
    -------
    RigidMotion
        camera_from_model.

    Raises
    ------
    ShapeError, ValueRangeError
        If shapes do not match or values are not finite.
    DegenerateError
        If the points do not determine a pose, or none before the camera is found.
    """
    sizes = check_shape("points", points, "N", 3)
    check_shape("pixels", pixels, "N", 2, **sizes)
    w = np.ones(sizes["N"]) if weights is None else np.asarray(weights, dtype=np.float64)
    check_shape("weights", w, "N", **sizes)
    check_finite("pixels", pixels)
    if start is None:
        weak = estimate_weak_perspective(points, pixels, w)
        start = rigid_from_weak(weak, intrinsics, np.average(points, axis=0, weights=w))
    root = np.sqrt(w)[:, None]
    motion, damping = start, 1e-4
    residual, seen = _residual(points, pixels, root, intrinsics, motion)
    cost = float((residual**2).sum())
    for _ in range(iterations):
        J = (root[:, :, None] * pinhole_jacobian(seen, seen - motion.translation, intrinsics)).reshape(-1, 6)
        H, g = J.T @ J, J.T @ residual.ravel()
        step = -np.linalg.solve(H + damping * np.diag(np.diag(H) + 1e-12), g)
        trial = RigidMotion(rotation_from_vector(step[:3]) @ motion.rotation, motion.translation + step[3:])
        trial_residual, trial_seen = _residual(points, pixels, root, intrinsics, trial)
        trial_cost = float((trial_residual**2).sum())
        if (trial_seen[:, 2] > 0).all() and trial_cost < cost:
            done = cost - trial_cost <= 1e-12 * cost
            motion, residual, seen, cost = trial, trial_residual, trial_seen, trial_cost
            damping *= 0.2
            if done:
                break
        else:
            damping *= 10.0
            if damping > 1e8:
                break
    if not (seen[:, 2] > 0).all():
        raise DegenerateError("points must lie before the camera: no such pose was found.")
    return motion


def pinhole_jacobian(
    camera_points: NDArray[np.float64], arms: NDArray[np.float64], intrinsics: Intrinsics
) -> NDArray[np.float64]:
    """Return the derivative (N, 2, 6) of pixels by a small rotation vector (about the points' `arms`) and translation.

    Parameters
    ----------
    camera_points : ndarray of shape (N, 3), millimetres
        Points in the camera's frame.
    arms : ndarray of shape (N, 3), millimetres
        What is rotated: R v, the points without the translation.
    intrinsics : Intrinsics
        The camera.
    """
    by_point = pixel_by_point(camera_points, intrinsics)
    J = np.empty((len(camera_points), 2, 6))
    # d (R v) = w x (R v): columns by w are e_i x arm
    J[:, :, 0] = by_point[:, :, 2] * arms[:, 1, None] - by_point[:, :, 1] * arms[:, 2, None]
    J[:, :, 1] = by_point[:, :, 0] * arms[:, 2, None] - by_point[:, :, 2] * arms[:, 0, None]
    J[:, :, 2] = by_point[:, :, 1] * arms[:, 0, None] - by_point[:, :, 0] * arms[:, 1, None]
    J[:, :, 3:] = by_point
    return J


def pixel_by_point(camera_points: NDArray[np.float64], intrinsics: Intrinsics) -> NDArray[np.float64]:
    """Return the derivative (N, 2, 3) of pixels by the point in the camera's frame."""
    inverse = 1.0 / camera_points[:, 2]
    J = np.zeros((len(camera_points), 2, 3))
    J[:, 0, 0] = intrinsics.focal_x * inverse
    J[:, 1, 1] = intrinsics.focal_y * inverse
    J[:, 0, 2] = -intrinsics.focal_x * camera_points[:, 0] * inverse**2
    J[:, 1, 2] = -intrinsics.focal_y * camera_points[:, 1] * inverse**2
    return J


def _residual(
    points: NDArray[np.floating],
    pixels: NDArray[np.floating],
    root: NDArray[np.float64],
    intrinsics: Intrinsics,
    motion: RigidMotion,
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    seen = motion.apply(points)
    with np.errstate(divide="ignore", invalid="ignore"):
        return root * (intrinsics.project(seen) - pixels), seen
