"""What fusion makes of a recording: a smooth depth map of one reference frame, and how good it is."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from facewright.camera.pinhole import Intrinsics, RigidMotion
from facewright.numeric.check import check_shape


@dataclass(frozen=True)
class FusionReport:
    """Quality of a fused recording, from the recording alone.

    Parameters
    ----------
    n_frames, n_fused : int
        Frames read, and frames that were tracked and integrated.
    lost : tuple of int
        Frames that could not be tracked.
    raw_noise_mm : float
        Root mean square difference of the raw frames from the fused surface on the inner face (no hair, no outline),
        along the optical axis.
    drift_mm, drift_degrees : float
        How far the tracked motion is off where it can be checked without truth: the last frames tracked directly
        against the reference frame, against the pose that the chain of frames gave.
    coverage : float
        Share of the rectangle's face pixels in which the fused map has depth.
    turn_degrees : float
        Largest turn of the head away from the reference frame.
    consistency_mm : float
        Median absolute difference of the tracked frames from the fused surface: grows when the face moved by itself
        (an expression that was not held, blur).
    warnings : tuple of str
        Sentences for the user, such as that depths looked like metres.
    unsteady_mm : float
        97th percentile of the mean differences in small patches of the inner face, where noise averages out: tells
        parts of it that moved by themselves.
    """

    n_frames: int
    n_fused: int
    lost: tuple[int, ...]
    raw_noise_mm: float
    drift_mm: float
    drift_degrees: float
    coverage: float
    turn_degrees: float
    consistency_mm: float
    warnings: tuple[str, ...] = ()
    unsteady_mm: float = 0.0

    def to_dict(self) -> dict[str, Any]:
        """Return the report as plain values for JSON."""
        return asdict(self)


@dataclass(frozen=True, eq=False)
class FusedDepth:
    """The smooth depth map of a recording's reference frame (FaceWarehouse 3.1).

    Parameters
    ----------
    depth : ndarray of shape (H, W), float32, millimetres
        Ray-cast from the fused surface as the reference frame's camera sees it; 0 outside the face rectangle and
        where nothing was fused.
    color : ndarray of shape (H, W, 3), uint8
        The reference frame's picture.
    intrinsics : Intrinsics
        Of both.
    reference : int
        Number of the reference frame in the recording, counted from 0.
    rectangle : (left, top, right, bottom), int
        The face rectangle, pixels of the reference frame; right and bottom are exclusive.
    reference_from_frame : tuple of RigidMotion or None
        Motion of every frame's camera coordinates into those of the reference frame; None where tracking was lost.
    report : FusionReport
        How good it is.
    """

    depth: NDArray[np.float32]
    color: NDArray[np.uint8]
    intrinsics: Intrinsics
    reference: int
    rectangle: tuple[int, int, int, int]
    reference_from_frame: tuple[RigidMotion | None, ...]
    report: FusionReport

    def __post_init__(self) -> None:
        sizes = check_shape("depth", self.depth, "H", "W")
        check_shape("color", self.color, "H", "W", 3, **sizes)
