"""Tracking all frames of a recording and fusing them into a volume: once in sequence, then against the whole."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from facewright.camera.pinhole import Intrinsics, RigidMotion
from facewright.camera.rotation import rotation_angle
from facewright.capture._tracking_kernels import halve_depth, smooth_depth
from facewright.capture.face_rectangle import EDGE_MM, HeadRegion
from facewright.capture.tracking import Tracked, track_frame
from facewright.capture.volume import DepthVolume, SurfaceView
from facewright.numeric.check import check_choice
from facewright.numeric.threads import for_blocks

Progress = Callable[[str, int, int], None]

#: A frame is lost whose pixels on the head lie on the model to a smaller share, or less well.
LEAST_SHARE, MOST_RMS_MM = 0.35, 4.5
#: A head does not turn or move further between two frames that were tracked one after the other.
_MOST_TURN, _MOST_SHIFT_MM = np.deg2rad(25.0), 80.0
#: Frames from other sides see a little of what lies outside the reference frame's frustum.
_MARGIN_MM = 12.0
#: A view of the model serves the frames near it: casting rays costs more than tracking.
_VIEW_TURN, _VIEW_SHIFT_MM = np.deg2rad(4.0), 8.0
_STILL = RigidMotion(np.eye(3), np.zeros(3))
#: Whose signed distance volume: our own kernels, or Open3D.
ENGINES = ("numba", "open3d")


class SurfaceVolume(Protocol):
    """A volume that depth maps are fused in: `DepthVolume` or `Open3DVolume`."""

    def integrate(
        self,
        depth: NDArray[np.float32],
        intrinsics: Intrinsics,
        volume_from_camera: RigidMotion,
        share: NDArray[np.float32] | None = None,
    ) -> None:
        """Take in a depth map."""
        ...

    def view(
        self, intrinsics: Intrinsics, volume_from_camera: RigidMotion, size: tuple[int, int], least_weight: float = 0.5
    ) -> SurfaceView:
        """Return what a camera sees of the fused surface."""
        ...


@dataclass(frozen=True, eq=False)
class DepthFrame:
    """The part of a frame that the head may be in.

    Parameters
    ----------
    depth : ndarray of shape (h, w), float32, millimetres
        Cut out of the frame.
    intrinsics : Intrinsics
        Of the cut.
    """

    depth: NDArray[np.float32]
    intrinsics: Intrinsics

    @cached_property
    def half(self) -> DepthFrame:
        """The frame at half the resolution: enough to track with, at a quarter of the work and half the noise."""
        h, w = self.depth.shape[0] // 2, self.depth.shape[1] // 2
        out = np.empty((h, w), np.float32)
        halve_depth(self.depth, EDGE_MM, out)
        k = self.intrinsics
        # the centre of the first pixel becomes that of the first four
        half = Intrinsics(k.focal_x / 2, k.focal_y / 2, (k.centre_x - 0.5) / 2, (k.centre_y - 0.5) / 2)
        return DepthFrame(out, half)

    def on_head(self, region: HeadRegion, pose: RigidMotion) -> NDArray[np.float32]:
        """Return the depth where it lies in a region; `pose` is region_from_frame."""
        return region.keep(self.depth, self.intrinsics, pose)

    def view(self, volume: SurfaceVolume, pose: RigidMotion) -> SurfaceView:
        """Return what the frame's camera sees of a volume; `pose` is volume_from_frame."""
        return volume.view(self.intrinsics, pose, (self.depth.shape[0], self.depth.shape[1]))


@dataclass(frozen=True, eq=False)
class HeadModel:
    """A volume of the head in the reference camera's frame, and where the frames were when they saw it.

    Parameters
    ----------
    volume : SurfaceVolume
        Fused surface.
    poses : list of RigidMotion or None
        volume_from_frame; None where a frame was lost.
    tracked : list of Tracked or None
        How well each frame fits; None for lost frames and for the anchor.
    """

    volume: SurfaceVolume
    poses: list[RigidMotion | None]
    tracked: list[Tracked | None]


def make_volume(region: HeadRegion, voxel_mm: float, truncation_mm: float, engine: str = "numba") -> SurfaceVolume:
    """Return an empty volume of an engine (one of `ENGINES`) that holds a head region."""
    check_choice("engine", engine, ENGINES)
    corners = region.grown(_MARGIN_MM).corners
    low, high = corners.min(axis=0), corners.max(axis=0)
    if engine == "open3d":
        from facewright.capture.open3d_volume import Open3DVolume

        return Open3DVolume(low, high, voxel_mm, truncation_mm)
    return DepthVolume(low, high, voxel_mm, truncation_mm)


def track_sequence(
    frames: list[DepthFrame],
    region: HeadRegion,
    chin: float,
    anchor: int,
    voxel_mm: float,
    truncation_mm: float,
    progress: Progress | None = None,
    *,
    engine: str = "numba",
) -> HeadModel:
    """Track frame after frame from the anchor to both ends, each against the model of those before (KinectFusion).

    Parameters
    ----------
    frames : list of DepthFrame
        In order.
    region : HeadRegion
        What belongs to the head, in the frame of the anchor's camera.
    chin : float
        Row of the anchor's picture below which nothing is tracked.
    anchor : int
        Where to start; its pose is the identity.
    voxel_mm, truncation_mm : float
        Of the volume.
    progress : callable, optional
        Called as progress("tracking frames", done, total).
    engine : str
        One of `ENGINES`.
    """
    volume = make_volume(region, voxel_mm, truncation_mm, engine)
    wide = region.grown(_MARGIN_MM)
    rigid = wide.above(chin)
    poses: list[RigidMotion | None] = [None] * len(frames)
    tracked: list[Tracked | None] = [None] * len(frames)
    centre = region.corners.mean(axis=0)
    poses[anchor] = _STILL
    halves = [frame.half for frame in frames]
    # one noisy frame has no normals to track against: the model is made of smoothed depths
    volume.integrate(smoothed(halves[anchor].on_head(region, _STILL)), halves[anchor].intrinsics, _STILL)
    done = 1
    for order in (range(anchor + 1, len(frames)), range(anchor - 1, -1, -1)):
        pose, model = _STILL, None
        for i in order:
            frame = halves[i]
            if model is None or is_far(pose, model.volume_from_camera, centre):
                model = frame.view(volume, pose)
            found = track_frame(frame.on_head(rigid, pose), frame.intrinsics, model, pose, centre)
            if is_tracked(found, pose, centre):
                pose = found.volume_from_frame
                poses[i], tracked[i] = pose, found
                volume.integrate(smoothed(frame.on_head(wide, pose)), frame.intrinsics, pose)
            done += 1
            if progress is not None:
                progress("tracking frames", done, len(frames))
    return HeadModel(volume, poses, tracked)


def refine_model(
    frames: list[DepthFrame],
    region: HeadRegion,
    chin: float,
    first: HeadModel,
    reference: int,
    voxel_mm: float,
    truncation_mm: float,
    progress: Progress | None = None,
    *,
    engine: str = "numba",
) -> HeadModel:
    """Track every frame once more, against the model of all frames, and fuse the raw depths anew at finer voxels.

    Parameters
    ----------
    frames, voxel_mm, truncation_mm, progress, engine
        See `track_sequence`.
    region : HeadRegion
        Around the reference frame, in the frame of its camera.
    chin : float
        Row of the reference frame's picture below which nothing is tracked.
    first : HeadModel
        From `track_sequence`.
    reference : int
        Frame in whose camera's frame the new model is; it must be tracked in the first one.
    """
    volume = make_volume(region, voxel_mm, truncation_mm, engine)
    wide = region.grown(_MARGIN_MM)
    rigid = wide.above(chin)
    start = first.poses[reference]
    assert start is not None
    region_from_volume = start.inverse()
    centre = start.apply(region.corners.mean(axis=0))
    poses: list[RigidMotion | None] = [None] * len(frames)
    tracked: list[Tracked | None] = [None] * len(frames)
    model = None
    for i, (frame, pose) in enumerate(zip(frames, first.poses)):
        if pose is not None:
            half = frame.half
            if model is None or is_far(pose, model.volume_from_camera, centre):
                model = half.view(first.volume, pose)
            head = half.on_head(rigid, region_from_volume.after(pose))
            found = track_frame(head, half.intrinsics, model, pose, centre, FINE_LEVELS)
            if is_tracked(found, pose, centre):
                poses[i], tracked[i] = found.volume_from_frame, found
        if progress is not None:
            progress("refining poses", i + 1, len(frames))
    own = poses[reference]
    to_reference = region_from_volume if own is None else own.inverse()
    poses = [None if pose is None else to_reference.after(pose) for pose in poses]
    if own is None:
        poses[reference] = _STILL
    for frame, pose in zip(frames, poses):
        if pose is not None:
            volume.integrate(frame.on_head(wide, pose), frame.intrinsics, pose)
    return HeadModel(volume, poses, tracked)


#: Of the second pass, which starts near the end.
FINE_LEVELS = ((1, 8.0, 5.0, 8),)


def is_tracked(found: Tracked, start: RigidMotion, centre: NDArray[np.float64]) -> bool:
    """Tell whether to believe a tracked pose: the frame lies on the model, and the head did not jump."""
    motion = found.volume_from_frame.after(start.inverse())
    shift = float(np.linalg.norm(motion.apply(centre) - centre))
    turn = rotation_angle(np.eye(3), motion.rotation)
    return found.share >= LEAST_SHARE and found.rms_mm <= MOST_RMS_MM and turn <= _MOST_TURN and shift <= _MOST_SHIFT_MM


def is_far(pose: RigidMotion, other: RigidMotion, centre: NDArray[np.float64]) -> bool:
    """Tell whether a camera has moved so far round the head that it needs a view of its own."""
    motion = pose.after(other.inverse())
    turn = rotation_angle(np.eye(3), motion.rotation)
    return turn > _VIEW_TURN or float(np.linalg.norm(motion.apply(centre) - centre)) > _VIEW_SHIFT_MM


def smoothed(depth: NDArray[np.float32], sigma_pixels: float = 1.5, reach_mm: float = 8.0) -> NDArray[np.float32]:
    """Return a depth map (H, W), mm, smoothed but not across steps of depth: for normals of single frames."""
    r = int(np.ceil(2 * sigma_pixels))
    place = np.arange(-r, r + 1)
    spatial = np.exp(-(place[:, None] ** 2 + place[None, :] ** 2) / (2.0 * sigma_pixels**2))
    out = np.empty_like(depth)

    def work(first: int, last: int) -> None:
        smooth_depth(depth, spatial, reach_mm, first, last, out)

    for_blocks(depth.shape[0], max(16, depth.shape[0] // 8), work)
    return out


def frame_view(frame: DepthFrame, region: HeadRegion, voxel_mm: float, truncation_mm: float) -> SurfaceView:
    """Return the surface that one frame, taken as the reference, sees by itself."""
    volume = make_volume(region, voxel_mm, truncation_mm)
    volume.integrate(smoothed(frame.on_head(region, _STILL)), frame.intrinsics, _STILL)
    return frame.view(volume, _STILL)
