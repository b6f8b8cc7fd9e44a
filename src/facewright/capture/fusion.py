"""Fusion of a recording into one smooth depth map of its reference frame (FaceWarehouse 3.1; KinectFusion)."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from typing import Protocol, cast

import numpy as np
from numpy.typing import NDArray

from facewright.camera.pinhole import Intrinsics, RigidMotion
from facewright.capture.face_rectangle import (
    HeadRegion,
    Rectangle,
    check_rectangle,
    chin_row,
    head_region,
    rectangle_from_depth,
    rectangle_from_landmarks,
)
from facewright.capture.frame import RGBDFrame
from facewright.capture.fused_depth import FusedDepth
from facewright.capture.fusion_quality import measure_fusion
from facewright.capture.model_building import (
    ENGINES,
    DepthFrame,
    HeadModel,
    refine_model,
    smoothed,
    track_sequence,
)
from facewright.capture.reference_frame import middle_of_turn, most_frontal
from facewright.errors import DegenerateError, ShapeError, ValueRangeError
from facewright.landmarks.detector import LandmarkDetector
from facewright.numeric.check import check_choice

Progress = Callable[[str, int, int], None]


@dataclass(frozen=True)
class FusionOptions:
    """How a recording is fused.

    Parameters
    ----------
    voxel_mm : float
        Edge of a voxel of the fused volume.
    truncation_mm : float
        Signed distances are cut here.
    tracking_voxel_mm : float
        Edge of a voxel of the volume that frames are first tracked against; truncated at four of them.
    least_frames : int
        A voxel seen by fewer frames is left out where the recording has at least three times as many.
    least_tracked : float
        A recording with a smaller share of its frames tracked is refused.
    most_consistency_mm, most_unsteady_mm : float
        A recording whose frames differ from the fused surface by more is refused: the median of all differences, and
        `FusionReport.unsteady_mm`, which tells a mouth that opened half-way.
    contradiction_mm : float
        Fused depth that is off the smoothed reference frame by more is left out; infinity keeps all.
    engine : {"numba", "open3d"}
        Whose signed distance volume: our own kernels, which interpolate between pixels and voxels, or Open3D's block
        grid and mesh (slower and with more noise, see `Open3DVolume`; needs ``facewright[capture]``). Tracking is the
        same for both.

    Raises
    ------
    ValueRangeError
        If the engine is unknown.
    MissingExtraError
        If it is not installed.
    """

    voxel_mm: float = 1.5
    truncation_mm: float = 6.0
    tracking_voxel_mm: float = 2.5
    least_frames: int = 2
    least_tracked: float = 0.6
    most_consistency_mm: float = 4.0
    most_unsteady_mm: float = 2.5
    contradiction_mm: float = 4.0
    engine: str = "numba"

    def __post_init__(self) -> None:
        check_choice("engine", self.engine, ENGINES)
        if self.engine == "open3d":
            from facewright.capture.open3d_volume import require_open3d

            require_open3d()


class Frames(Protocol):
    """What fusion needs of a recording."""

    @property
    def n_frames(self) -> int:
        """Number of frames."""
        ...

    def frame(self, i: int) -> RGBDFrame:
        """Return frame `i`."""
        ...

    def frames(self) -> Iterator[RGBDFrame]:
        """Yield all frames in order."""
        ...


def fuse(
    recording_or_frames: Frames | Iterable[RGBDFrame],
    *,
    rectangle: Rectangle | None = None,
    reference: int | None = None,
    detector: LandmarkDetector | None = None,
    options: FusionOptions = FusionOptions(),
    progress: Progress | None = None,
) -> FusedDepth:
    """Fuse a recording of a held expression and a turning head into one smooth depth map.

    Frames are tracked against the model of those before (point-to-plane ICP on ray-cast depth), then against the model
    of all, and integrated into a truncated signed distance volume, which is ray-cast from the reference frame. Only
    what lies in the head's region is used. Equal recordings give bit-equal results with any number of threads.

    Parameters
    ----------
    recording_or_frames : Recording or iterable of RGBDFrame
        Frames of one size, in order. Of a recording only the part round the face is held in memory.
    rectangle : (left, top, right, bottom), optional
        The face in the reference frame, pixels; from the detector where absent, or from the depth (the nearest thing
        of a head's size).
    reference : int, optional
        The frame to make the depth map of; where absent the most frontal one by the detector, or the middle of the
        head's turn.
    detector : LandmarkDetector, optional
        Finds the face.
    options : FusionOptions
        Voxels and limits.
    progress : callable, optional
        Called as progress(stage, done, total).

    Returns
    -------
    FusedDepth
        Depth map, picture, motion and report.

    Raises
    ------
    NoFaceError
        If no face is found, or the rectangle holds no depth.
    ValueRangeError
        If there are no frames, or reference or rectangle lie outside.
    ShapeError
        If frames differ in size.
    DegenerateError
        If too few frames can be tracked, or the face changed its shape while it was recorded.
    """
    source = _as_frames(recording_or_frames)
    if source.n_frames < 1:
        raise ValueRangeError("recording must hold at least one frame, got none.")
    if reference is not None and not 0 <= reference < source.n_frames:
        raise ValueRangeError(f"reference must be a frame in [0, {source.n_frames}), got {reference}.")
    warnings: list[str] = []
    anchor, box, chin = _find_face(source, rectangle, reference, detector, warnings)
    picture = source.frame(anchor)
    region = head_region(picture.depth, picture.intrinsics, box, anchor)
    window = _window(region, (picture.size[0], picture.size[1]))
    frames = _read(source, picture.size, window, progress)
    if len(frames) == 1:
        return _single(picture, anchor, box, region, warnings)
    first = track_sequence(
        frames, region, chin, anchor, options.tracking_voxel_mm, 4 * options.tracking_voxel_mm, progress,
        engine=options.engine,
    )  # fmt: skip
    if reference is None and detector is None:
        reference = middle_of_turn(first.poses)
        if reference != anchor:
            picture = source.frame(reference)
            box = box if rectangle is not None else rectangle_from_depth(picture.depth, picture.intrinsics, reference)
            region = head_region(picture.depth, picture.intrinsics, box, reference)
            chin = chin_row(box, None)
    chosen = anchor if reference is None else reference
    model = refine_model(
        frames, region, chin, first, chosen, options.voxel_mm, options.truncation_mm, progress, engine=options.engine
    )
    _check_tracked(model, options)
    return _finish(picture, chosen, box, region, frames, model, options, warnings)


def _finish(
    picture: RGBDFrame,
    reference: int,
    box: Rectangle,
    region: HeadRegion,
    frames: list[DepthFrame],
    model: HeadModel,
    options: FusionOptions,
    warnings: list[str],
) -> FusedDepth:
    left, top, right, bottom = box
    k = picture.intrinsics
    cut = Intrinsics(k.focal_x, k.focal_y, k.centre_x - left, k.centre_y - top)
    n_fused = sum(pose is not None for pose in model.poses)
    least = options.least_frames if n_fused >= 3 * options.least_frames else 1
    still = RigidMotion(np.eye(3), np.zeros(3))
    view = model.volume.view(cut, still, (bottom - top, right - left), least - 0.5)
    depth = np.zeros(picture.depth.shape, np.float32)
    depth[top:bottom, left:right] = view.depth
    _drop_contradicted(depth, smoothed(region.keep(picture.depth, k, still), 2.5, 12.0), options.contradiction_mm)
    report = measure_fusion(picture, reference, box, region, frames, model, depth, options.tracking_voxel_mm, warnings)
    for found, most, how in (
        (report.consistency_mm, options.most_consistency_mm, "(median)"),
        (report.unsteady_mm, options.most_unsteady_mm, "in places"),
    ):
        if found > most:
            raise DegenerateError(
                f"recording must show a held expression, got frames that differ by {found:.1f} mm {how} from the "
                f"surface fused of them, where at most {most:g} mm are taken: the face moved by itself, or the "
                "pictures are blurred."
            )
    return FusedDepth(depth, picture.color, k, reference, box, tuple(model.poses), report)


def _drop_contradicted(depth: NDArray[np.float32], seen: NDArray[np.float32], most_mm: float) -> None:
    """Set depths (H, W) to 0 that the smoothed reference frame contradicts: what did not move with the head is smeared.

    A shoulder in the face rectangle stood still; where the reference frame saw nothing, nothing is dropped.
    """
    depth[(seen > 0) & (np.abs(depth - seen) > most_mm)] = 0.0


def _find_face(
    source: Frames,
    rectangle: Rectangle | None,
    reference: int | None,
    detector: LandmarkDetector | None,
    warnings: list[str],
) -> tuple[int, Rectangle, float]:
    """Return the frame to start at (the reference where that is known), the face rectangle and the chin's row in it."""
    landmarks = None
    if detector is not None and reference is None:
        anchor, landmarks = most_frontal(source, detector)
        picture = source.frame(anchor)
    else:
        anchor = source.n_frames // 2 if reference is None else reference
        picture = source.frame(anchor)
        if detector is not None and rectangle is None:
            landmarks = next(iter(detector.detect(picture.color)), None)
            if landmarks is None:
                warnings.append(f"The detector found no face in frame {anchor}: the rectangle was told from the depth.")
    if rectangle is not None:
        box = check_rectangle(rectangle, picture.size)
        # landmarks of another face, or a rectangle without the chin
        known = landmarks if landmarks is not None and box[1] < landmarks.box[3] <= box[3] else None
        return anchor, box, chin_row(box, known)
    if landmarks is not None:
        box = rectangle_from_landmarks(landmarks, picture.size)
    else:
        box = rectangle_from_depth(picture.depth, picture.intrinsics, anchor)
    return anchor, box, chin_row(box, landmarks)


def _window(region: HeadRegion, size: tuple[int, int]) -> Rectangle:
    """Return the part of the picture that the head may be in while it turns."""
    left, top, right, bottom = region.box
    side = 0.35 * max(right - left, bottom - top)
    return (
        max(int(left - side), 0),
        max(int(top - side), 0),
        min(int(right + side) + 1, size[1]),
        min(int(bottom + side) + 1, size[0]),
    )


def _read(source: Frames, size: tuple[int, int], window: Rectangle, progress: Progress | None) -> list[DepthFrame]:
    left, top, right, bottom = window
    frames = []
    for i, frame in enumerate(source.frames()):
        if frame.size != size:
            raise ShapeError(f"frames must be of one size, {size[1]} x {size[0]}, got frame {i} of {frame.size[::-1]}.")
        k = frame.intrinsics
        cut = Intrinsics(k.focal_x, k.focal_y, k.centre_x - left, k.centre_y - top)
        frames.append(DepthFrame(np.ascontiguousarray(frame.depth[top:bottom, left:right]), cut))
        if progress is not None:
            progress("reading frames", i + 1, source.n_frames)
    return frames


def _single(picture: RGBDFrame, reference: int, box: Rectangle, region: HeadRegion, warnings: list[str]) -> FusedDepth:
    """Return the one frame there is, smoothed."""
    still = RigidMotion(np.eye(3), np.zeros(3))
    left, top, right, bottom = box
    warnings.append("The recording has one frame only: its depth is smoothed but not fused.")
    depth = np.zeros(picture.depth.shape, np.float32)
    head = smoothed(region.keep(picture.depth, picture.intrinsics, still), 2.0, 10.0)
    depth[top:bottom, left:right] = head[top:bottom, left:right]
    report = measure_fusion(picture, reference, box, region, [], None, depth, 0.0, warnings)
    return FusedDepth(depth, picture.color, picture.intrinsics, reference, box, (still,), report)


def _check_tracked(model: HeadModel, options: FusionOptions) -> None:
    n, n_tracked = len(model.poses), sum(pose is not None for pose in model.poses)
    if n_tracked < max(2, options.least_tracked * n):
        raise DegenerateError(
            f"recording must show a held expression and a head that turns slowly, got {n_tracked} of {n} frames that "
            "lie on one surface: the face moved by itself, was out of view, or the camera lost it."
        )


class _FrameList:
    """Frames in memory, as a recording."""

    def __init__(self, frames: list[RGBDFrame]) -> None:
        self._frames = frames
        self.n_frames = len(frames)

    def frame(self, i: int) -> RGBDFrame:
        return self._frames[i]

    def frames(self) -> Iterator[RGBDFrame]:
        return iter(self._frames)


def _as_frames(recording_or_frames: Frames | Iterable[RGBDFrame]) -> Frames:
    if hasattr(recording_or_frames, "n_frames") and hasattr(recording_or_frames, "frames"):
        return cast(Frames, recording_or_frames)
    return _FrameList(list(recording_or_frames))
