"""How good a fused recording is, from the recording alone."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from facewright.camera.pinhole import RigidMotion
from facewright.camera.rotation import rotation_angle
from facewright.capture.face_rectangle import HeadRegion, Rectangle
from facewright.capture.frame import RGBDFrame
from facewright.capture.fused_depth import FusionReport
from facewright.capture.model_building import DepthFrame, HeadModel, frame_view
from facewright.capture.tracking import frame_residuals, track_frame

#: Frames that are compared with the fused surface, and that are tracked directly against the reference frame.
_N_COMPARED, _N_DIRECT = 4, 3
#: Held expressions of simulated people (8 and 24 frames) gave patches of up to 1.2 mm.
_PATCH_MM, _WARN_UNSTEADY_MM = 12.0, 1.5
_WARN_LOST, _WARN_CONSISTENCY_MM, _WARN_COVERAGE, _WARN_DRIFT_MM = 0.2, 1.8, 0.8, 3.0
_INNER_DEPTH_MM = 110.0
_STILL = RigidMotion(np.eye(3), np.zeros(3))


def measure_fusion(
    picture: RGBDFrame,
    reference: int,
    box: Rectangle,
    region: HeadRegion,
    frames: list[DepthFrame],
    model: HeadModel | None,
    depth: NDArray[np.float32],
    tracking_voxel_mm: float,
    warnings: list[str],
) -> FusionReport:
    """Measure noise, drift, coverage and consistency of a fused recording; see `FusionReport`.

    Parameters
    ----------
    picture : RGBDFrame
        The reference frame.
    reference : int
        Its number.
    box : (left, top, right, bottom)
        Face rectangle.
    region : HeadRegion
        What belongs to the head.
    frames : list of DepthFrame
        All frames; empty where there was one only.
    model : HeadModel or None
        Fused frames; None where there was one only.
    depth : ndarray of shape (H, W), float32, millimetres
        The fused map.
    tracking_voxel_mm : float
        Voxels for the surface of single frames.
    warnings : list of str
        Sentences so far; the report adds its own.
    """
    inside = np.zeros(depth.shape, np.bool_)
    inside[box[1] : box[3], box[0] : box[2]] = True
    raw = region.keep(picture.depth, picture.intrinsics, _STILL)
    face = inside & ((raw > 0) | (depth > 0))
    coverage = float(np.count_nonzero(depth[face]) / max(np.count_nonzero(face), 1))
    both = inside & (raw > 0) & (depth > 0)
    if model is None:
        off = raw[both] - depth[both]
        noise = float(np.sqrt(np.mean(off**2, dtype=np.float64))) if off.size else 0.0
        consistency = float(np.median(np.abs(off))) if off.size else 0.0
        return FusionReport(1, 1, (), noise, 0.0, 0.0, coverage, 0.0, consistency, tuple(warnings))
    lost = tuple(i for i, pose in enumerate(model.poses) if pose is None)
    turns = [0.0 if pose is None else rotation_angle(np.eye(3), pose.rotation) for pose in model.poses]
    noise, consistency, unsteady = _noise(frames, model, _inner_face(region, box))
    drift_mm, drift = _drift(frames, model, region, reference, tracking_voxel_mm)
    _warn(warnings, lost, len(frames), consistency, unsteady, coverage, drift_mm)
    return FusionReport(
        len(frames),
        len(frames) - len(lost),
        lost,
        noise,
        drift_mm,
        float(np.rad2deg(drift)),
        coverage,
        float(np.rad2deg(max(turns))),
        consistency,
        tuple(warnings),
        unsteady,
    )


def _inner_face(region: HeadRegion, box: Rectangle) -> HeadRegion:
    """Return the part of the region that is skin for sure: hair, ears and the bending neck differ in every frame."""
    left, top, right, bottom = box
    wide, high = right - left, bottom - top
    return HeadRegion(
        region.intrinsics,
        (left + 0.22 * wide, top + 0.3 * high, right - 0.22 * wide, top + 0.86 * high),
        region.near_mm,
        region.near_mm + _INNER_DEPTH_MM,
    )


def _noise(frames: list[DepthFrame], model: HeadModel, inner: HeadRegion) -> tuple[float, float, float]:
    """Compare raw frames with the fused surface on the inner face, along the optical axis, mm.

    Returns the root mean square, the median absolute difference, and the 97th percentile of the mean difference in
    small patches: noise averages out there, so that it tells parts that moved by themselves.
    """
    tracked = [i for i, pose in enumerate(model.poses) if pose is not None]
    looks = sorted({tracked[int(k)] for k in np.linspace(0, len(tracked) - 1, _N_COMPARED).round()})
    off, patches = [], []
    for i in looks:
        pose, frame = model.poses[i], frames[i]
        assert pose is not None
        # the surface at half the resolution, against every raw pixel
        view = frame.half.view(model.volume, pose)
        face = frame.on_head(inner, pose)
        residuals = frame_residuals(face, frame.intrinsics, view, pose)
        off.append(residuals[np.isfinite(residuals)])
        patches.append(_patch_means(face, residuals, _PATCH_MM * frame.intrinsics.focal_x / inner.near_mm))
    values = np.concatenate(off)
    if not values.size:
        return 0.0, 0.0, 0.0
    means = np.abs(np.concatenate(patches))
    unsteady = float(np.percentile(means, 97.0)) if means.size else 0.0
    return float(np.sqrt(np.mean(values**2))), float(np.median(np.abs(values))), unsteady


def _patch_means(depth: NDArray[np.float32], residuals: NDArray[np.float64], side: float) -> NDArray[np.float64]:
    """Return the mean of the residuals, one for each pixel with depth, in square patches that are half full or more."""
    v, u = np.nonzero(depth)
    good = np.isfinite(residuals)
    columns = int(depth.shape[1] / side) + 1
    patch = ((v[good] / side).astype(int) * columns + (u[good] / side).astype(int)).astype(np.int64)
    count = np.bincount(patch)
    total = np.bincount(patch, residuals[good])
    full = count >= 0.5 * side**2
    return total[full] / count[full]


def _drift(
    frames: list[DepthFrame], model: HeadModel, region: HeadRegion, reference: int, voxel_mm: float
) -> tuple[float, float]:
    """Return how far the last frames, tracked directly against the reference frame, are off their poses (mm, rad)."""
    view = frame_view(frames[reference].half, region, voxel_mm, 4 * voxel_mm)
    seen = view.depth[view.depth > 0]
    if not seen.size:
        return 0.0, 0.0
    centre = region.corners.mean(axis=0) * [1.0, 1.0, 0.0] + [0.0, 0.0, float(np.median(seen))]
    shifts, turns = [0.0], [0.0]
    last = [i for i, pose in enumerate(model.poses) if pose is not None and i != reference][-_N_DIRECT:]
    for i in last:
        pose, frame = model.poses[i], frames[i].half
        assert pose is not None
        direct = track_frame(frame.on_head(region, pose), frame.intrinsics, view, pose, centre)
        if direct.share > 0:
            off = direct.volume_from_frame.after(pose.inverse())
            shifts.append(float(np.linalg.norm(off.apply(centre) - centre)))
            turns.append(rotation_angle(np.eye(3), off.rotation))
    n = max(len(shifts) - 1, 1)
    return sum(shifts) / n, sum(turns) / n


def _warn(
    warnings: list[str],
    lost: tuple[int, ...],
    n: int,
    consistency: float,
    unsteady: float,
    coverage: float,
    drift_mm: float,
) -> None:
    if len(lost) > _WARN_LOST * n:
        warnings.append(f"{len(lost)} of {n} frames could not be tracked: the head moved fast, or was out of view.")
    if consistency > _WARN_CONSISTENCY_MM or unsteady > _WARN_UNSTEADY_MM:
        warnings.append(
            f"Frames differ from the fused surface by {consistency:.1f} mm (median), and by {unsteady:.1f} mm where "
            "they differ as a patch: the expression was not held, or the pictures are blurred."
        )
    if coverage < _WARN_COVERAGE:
        warnings.append(f"The fused depth covers {100 * coverage:.0f} % of the face: parts were not seen well.")
    if drift_mm > _WARN_DRIFT_MM:
        warnings.append(f"Tracking drifted by about {drift_mm:.1f} mm.")
