"""Frame-to-model tracking: the rigid motion that lays a depth frame on the surface a camera would see (KinectFusion)."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from facewright.camera.pinhole import Intrinsics, RigidMotion
from facewright.camera.rotation import rotation_from_vector
from facewright.capture._tracking_kernels import axial_residuals, normal_equations
from facewright.capture.volume import SurfaceView, camera_row

#: Coarse to fine: pixel step, gate on distance (mm), Tukey scale of residuals (mm), most steps.
LEVELS = ((4, 40.0, 25.0, 10), (2, 20.0, 10.0, 6), (1, 12.0, 6.0, 8))
#: A level ends when a step turns by less than this (rad) and shifts by less than this (mm).
_SMALL_TURN, _SMALL_SHIFT = 2e-5, 2e-3


class Tracked(NamedTuple):
    """Where tracking put a frame, and how well it fits there.

    Parameters
    ----------
    volume_from_frame : RigidMotion
        The pose.
    share : float
        Share of the frame's depth pixels whose partner on the model lies within the finest gate, weighted.
    rms_mm : float
        Weighted root mean square distance from the model's tangent planes.
    """

    volume_from_frame: RigidMotion
    share: float
    rms_mm: float


def track_frame(
    depth: NDArray[np.float32],
    intrinsics: Intrinsics,
    model: SurfaceView,
    start: RigidMotion,
    centre: NDArray[np.float64],
    levels: tuple[tuple[int, float, float, int], ...] = LEVELS,
) -> Tracked:
    r"""Lay a depth frame on a model by point-to-plane ICP with projective association.

    Minimises :math:`\sum_p w_p (n_p \cdot (T v_p - m_p))^2` over rigid T, where m, n are the model's point and normal
    behind the pixel that T v falls on, and w are Tukey weights, so that what does not move with the head (shoulders,
    a collar) has no say. Sums run in one order: equal frames give bit-equal poses.

    Parameters
    ----------
    depth : ndarray of shape (H, W), float32, millimetres
        The frame; 0 where it has no depth or is not to be used.
    intrinsics : Intrinsics
        Its camera.
    model : SurfaceView
        The model as seen from a pose near the frame's.
    start : RigidMotion
        First guess of volume_from_frame.
    centre : ndarray of shape (3,), millimetres
        Point that turns are about, in the frame of the volume; for the conditioning only.
    levels : tuple of tuple
        See `LEVELS`.

    Returns
    -------
    Tracked
        The pose; its `share` and `rms_mm` tell whether to believe it.
    """
    camera, model_camera = camera_row(intrinsics), camera_row(model.intrinsics)
    back = model.volume_from_camera.inverse()
    Rm, tm = np.ascontiguousarray(back.rotation), back.translation
    R, t = start.rotation.copy(), start.translation.copy()
    H, g = np.zeros((6, 6)), np.zeros(6)
    pairs, total, squares, step = 0, 0.0, 0.0, 1
    for step, gate, scale, most in levels:
        for _ in range(most):
            pairs, total, squares = normal_equations(
                depth, camera, R, t, model.depth, model.normals, model_camera, Rm, tm, centre, step, gate, scale, H, g
            )
            if pairs < 50:
                return Tracked(start, 0.0, float("inf"))
            # the smallest ridge that keeps a flat or round patch from sliding without bound
            x = -np.linalg.solve(H + 1e-6 * np.diag(np.diag(H)) + 1e-9 * np.eye(6), g)
            turn = rotation_from_vector(x[:3])
            t = turn @ (t - centre) + centre + x[3:]
            R = turn @ R
            if np.abs(x[:3]).max() < _SMALL_TURN and np.abs(x[3:]).max() < _SMALL_SHIFT:
                break
    n_pixels = int(np.count_nonzero(depth[::step, ::step]))
    return Tracked(RigidMotion(R, t), total / max(n_pixels, 1), float(np.sqrt(squares / max(total, 1e-12))))


def frame_residuals(
    depth: NDArray[np.float32],
    intrinsics: Intrinsics,
    model: SurfaceView,
    volume_from_frame: RigidMotion,
    gate_mm: float = 20.0,
) -> NDArray[np.float32]:
    """Return each pixel's depth minus the model's, along the model camera's axis; NaN without a partner in the gate.

    Parameters are those of `track_frame`.
    """
    back = model.volume_from_camera.inverse()
    out = np.empty(depth.shape, np.float32)
    axial_residuals(
        depth, camera_row(intrinsics), np.ascontiguousarray(volume_from_frame.rotation), volume_from_frame.translation,
        model.depth, camera_row(model.intrinsics), np.ascontiguousarray(back.rotation), back.translation, gate_mm, out,
    )  # fmt: skip
    return out
