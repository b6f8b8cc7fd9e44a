"""Frame-to-model tracking: the rigid motion that lays a depth frame on a surface as a camera sees it (KinectFusion)."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from facewright.camera.pinhole import Intrinsics, RigidMotion
from facewright.capture._tracking_kernels import align_points, axial_residuals
from facewright.capture.volume import SurfaceView, camera_row

#: Coarse to fine: every how many points, gate on distance (mm), Tukey scale of residuals (mm), most steps. Odd numbers
#: that do not divide a picture's width spread the points over it.
LEVELS = ((13, 40.0, 25.0, 10), (5, 20.0, 10.0, 6), (2, 12.0, 6.0, 6))
#: A level ends when a step turns by less than this (rad) and shifts by less than this (mm).
_SMALL_TURN, _SMALL_SHIFT = 5e-5, 5e-3


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
    points = seen_points(depth, intrinsics)
    model_camera = camera_row(model.intrinsics)
    back = model.volume_from_camera.inverse()
    Rm, tm = np.ascontiguousarray(back.rotation), back.translation
    R, t = np.array(start.rotation, np.float64, order="C"), np.array(start.translation, np.float64)
    share, rms = align_points(
        points, R, t, model.depth, model.normals, model_camera, Rm, tm, centre, np.array(levels, np.float64),
        _SMALL_TURN, _SMALL_SHIFT,
    )  # fmt: skip
    if share == 0:
        return Tracked(start, 0.0, float("inf"))
    return Tracked(RigidMotion(R, t), float(share), float(rms))


def frame_residuals(
    depth: NDArray[np.float32],
    intrinsics: Intrinsics,
    model: SurfaceView,
    volume_from_frame: RigidMotion,
    gate_mm: float = 20.0,
) -> NDArray[np.float64]:
    """Return the depth of each pixel that has one minus the model's, along the model camera's axis, shape (N,).

    NaN for pixels without a partner in the gate. Parameters are those of `track_frame`.
    """
    back = model.volume_from_camera.inverse()
    points = seen_points(depth, intrinsics)
    out = np.empty(len(points))
    axial_residuals(
        points, np.ascontiguousarray(volume_from_frame.rotation), volume_from_frame.translation, model.depth,
        camera_row(model.intrinsics), np.ascontiguousarray(back.rotation), back.translation, gate_mm, out,
    )  # fmt: skip
    return out


def seen_points(depth: NDArray[np.float32], intrinsics: Intrinsics) -> NDArray[np.float64]:
    """Return the points (N, 3), mm, of the pixels that have depth, row by row."""
    v, u = np.nonzero(depth)
    z = depth[v, u].astype(np.float64)
    x = (u - intrinsics.centre_x) / intrinsics.focal_x * z
    y = (v - intrinsics.centre_y) / intrinsics.focal_y * z
    return np.stack([x, y, z], axis=1)
