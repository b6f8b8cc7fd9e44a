"""Which frame the fused depth is of: the most frontal one by the detector, or the middle of the head's turn."""

from __future__ import annotations

from typing import NamedTuple, Protocol

import numpy as np
from numpy.typing import NDArray

from facewright.camera.pinhole import RigidMotion
from facewright.capture.frame import RGBDFrame
from facewright.errors import NoFaceError
from facewright.landmarks.detector import LandmarkDetector
from facewright.landmarks.points import Landmarks
from facewright.numeric.rotation import rotation_vector_from_matrix

#: Frames that the detector looks at, spread over the recording.
N_LOOKS = 7


class _Frames(Protocol):
    @property
    def n_frames(self) -> int: ...

    def frame(self, i: int) -> RGBDFrame: ...


class FrontalFrame(NamedTuple):
    """Number of the most frontal frame of those looked at, and its landmarks."""

    number: int
    landmarks: Landmarks


def most_frontal(frames: _Frames, detector: LandmarkDetector, n_looks: int = N_LOOKS) -> FrontalFrame:
    """Let the detector look at frames spread over a recording; return the one whose face looks into the camera.

    Parameters
    ----------
    frames : Recording or alike
        With `n_frames` and `frame`.
    detector : LandmarkDetector
        Finds faces.
    n_looks : int
        At most so many frames are looked at.

    Raises
    ------
    NoFaceError
        If no face is found in any of them.
    """
    looks = sorted({int(i) for i in np.linspace(0, frames.n_frames - 1, min(n_looks, frames.n_frames)).round()})
    best: tuple[float, FrontalFrame] | None = None
    for i in looks:
        faces = detector.detect(frames.frame(i).color)
        if faces:
            turn = facing_away(faces[0])
            if best is None or turn < best[0]:
                best = (turn, FrontalFrame(i, faces[0]))
    if best is None:
        raise NoFaceError(
            f"recording must show a face, the detector found none in {len(looks)} of its {frames.n_frames} frames."
        )
    return best[1]


def facing_away(landmarks: Landmarks) -> float:
    """Tell how far a face is turned away, from its landmarks: 0 frontal, 1 about a profile.

    The nose's tip lies ahead of the eyes, so that turning shifts it to one eye; nodding is told by where it lies
    between eyes and mouth.
    """
    points = landmarks if landmarks.scheme == "fw74" else landmarks.convert("fw74")
    groups = points.definition.groups
    eyes = [points.points[groups[f"{side}_eye"]].mean(axis=0) for side in ("right", "left")]
    nose = points.points[groups["nose"]].mean(axis=0)
    across = eyes[1] - eyes[0]
    middle = 0.5 * (eyes[0] + eyes[1])
    along = float((nose - middle) @ across / max(float(across @ across), 1e-9))
    return abs(along) if np.isfinite(along) else np.inf


def middle_of_turn(reference_from_frame: list[RigidMotion | None]) -> int:
    """Return the tracked frame whose rotation is nearest to the middle of the range that the head turned through."""
    tracked = [i for i, motion in enumerate(reference_from_frame) if motion is not None]
    turns: NDArray[np.float64] = np.array(
        [rotation_vector_from_matrix(m.rotation) for m in reference_from_frame if m is not None]
    )
    centred = turns - turns.mean(axis=0)
    axis = np.linalg.svd(centred, full_matrices=False)[2][0]
    along = centred @ axis
    middle = 0.5 * (along.min() + along.max())
    # of frames near the middle, the one that nods least
    cost = np.abs(along - middle) + 0.3 * np.linalg.norm(centred - along[:, None] * axis, axis=1)
    return tracked[int(cost.argmin())]
