"""One recording of one expression: read, fused, and with landmarks on its reference frame."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from concurrent.futures import Future
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from time import perf_counter
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from facewright.capture.captures import find_sidecar
from facewright.capture.fused_depth import FusedDepth
from facewright.errors import NoFaceError, ValueRangeError
from facewright.landmarks.points import Landmarks

if TYPE_CHECKING:
    from facewright.capture.frame import RGBDFrame
    from facewright.capture.recording import Recording
    from facewright.landmarks.detector import LandmarkDetector

Progress = Callable[[str, int, int], None]

#: Recordings up to this size are kept in memory while they are fused.
_MOST_BYTES = 256 * 2**20
_BYTES_PER_PIXEL = 7


@dataclass(eq=False)
class StageClock:
    """Seconds spent in each stage, and what calls itself at the end of one.

    Parameters
    ----------
    seconds : dict of str to float
        Stage -> wall-clock seconds so far.
    """

    seconds: dict[str, float] = field(default_factory=dict)

    def add(self, stage: str, seconds: float) -> None:
        """Add to a stage (also a negative number: time that belongs to another)."""
        self.seconds[stage] = self.seconds.get(stage, 0.0) + seconds

    @contextmanager
    def time(self, stage: str) -> Iterator[None]:
        """Count what happens inside to a stage, also when it fails."""
        start = perf_counter()
        try:
            yield
        finally:
            self.add(stage, perf_counter() - start)


@dataclass(frozen=True, eq=False)
class ExpressionRecord:
    """What is known of one expression before any mesh is fitted.

    Parameters
    ----------
    name : str
        The expression.
    fused : FusedDepth
        Depth and picture of the reference frame.
    landmarks : Landmarks
        ``fw74`` points of that picture.
    facts : dict
        For the provenance: recording, fusion report, where the landmarks come from.
    raw_depth : ndarray of shape (H, W), float32, millimetres
        The reference frame's depth as the camera gave it.
    """

    name: str
    fused: FusedDepth
    landmarks: Landmarks
    facts: dict[str, Any]
    raw_depth: NDArray[np.float32]


def needs_detector(recordings: dict[str, Path]) -> bool:
    """Tell whether any recording lacks a sidecar with all 74 points.

    Raises
    ------
    FileFormatError, StoreError
        If a sidecar cannot be read.
    """
    return not all(_is_complete(_sidecar(path)) for path in recordings.values())


def read_record(
    name: str,
    path: Path,
    detector: LandmarkDetector | None,
    clock: StageClock,
    loaded: Future[LoadedRecording],
    engine: str = "numba",
    progress: Progress | None = None,
) -> ExpressionRecord:
    """Fuse and mark one recording.

    Points of a sidecar win over the detector's, point by point; its frame number is the reference frame.

    Parameters
    ----------
    name : str
        The expression.
    path : Path
        The recording.
    detector : LandmarkDetector or None
        None where sidecars hold all points.
    clock : StageClock
        Gets the seconds of the stages "read" (waiting for the frames), "fuse" and "landmark".
    loaded : Future of LoadedRecording
        The recording, which is read by another thread.
    engine : str
        Of the fusion, see `FusionOptions`.
    progress : callable, optional
        Called by the fusion as progress(stage, done, total).

    Raises
    ------
    NoFaceError
        If no face is found in the reference frame.
    FileFormatError, StoreError, ValueRangeError
        If recording or sidecar are damaged.
    """
    from facewright.capture.face_rectangle import rectangle_from_landmarks
    from facewright.capture.fusion import FusionOptions, fuse
    from facewright.capture.upright import turns_of_a_phone

    sidecar = _sidecar(path)
    with clock.time("read"):
        source = loaded.result()
    recording = source.recording
    reference = None if sidecar is None else _checked_frame(sidecar[0], recording, path)
    rectangle = None
    if sidecar is not None and _is_complete(sidecar):
        rectangle = rectangle_from_landmarks(sidecar[1], recording.size)
    if sidecar is None and detector is not None and not source.turn_given:
        with clock.time("landmark"):
            turns = turns_of_a_phone(recording, detector)
            source = LoadedRecording(path, turns) if turns else source
        recording = source.recording
    with clock.time("fuse"):
        fused = fuse(
            source,
            rectangle=rectangle,
            reference=reference,
            detector=detector,
            options=FusionOptions(engine=engine),
            progress=progress,
        )
    with clock.time("landmark"):
        landmarks, found_by = _landmarks(fused, sidecar, detector, path)
    facts = {
        "recording": path.name,
        "kind": recording.kind,
        "quarter_turns": recording.quarter_turns,
        "reference_frame": fused.reference,
        "rectangle": [int(v) for v in fused.rectangle],
        "landmarks": found_by,
        "landmarks_found": int(landmarks.present.sum()),
        "fusion": {key: value for key, value in fused.report.to_dict().items() if key != "warnings"},
        "warnings": [*recording.warnings, *(w for w in fused.report.warnings if w not in recording.warnings)],
    }
    return ExpressionRecord(name, fused, landmarks, facts, source.frame(fused.reference).depth)


class LoadedRecording:
    """An open recording whose frames are in memory where it is short; others are streamed.

    Parameters
    ----------
    path : Path
        The recording.
    quarter_turns : int, optional
        Turn its frames so; by default as its camera file says, or not. `read_record` then asks no detector.

    Raises
    ------
    FileFormatError, StoreError
        If it is damaged.
    """

    def __init__(self, path: Path, quarter_turns: int | None = None) -> None:
        from facewright.capture.recording import open_recording

        self.recording: Recording = open_recording(path, quarter_turns=quarter_turns)
        self.turn_given = quarter_turns is not None
        self.n_frames = self.recording.n_frames
        pixels = self.recording.size[0] * self.recording.size[1] * self.n_frames
        self._kept = list(self.recording.frames()) if pixels * _BYTES_PER_PIXEL <= _MOST_BYTES else None

    def frame(self, i: int) -> RGBDFrame:
        """Return frame `i`."""
        return self.recording.frame(i) if self._kept is None else self._kept[i]

    def frames(self) -> Iterator[RGBDFrame]:
        """Yield all frames in order."""
        return self.recording.frames() if self._kept is None else iter(self._kept)


def _sidecar(path: Path) -> tuple[int, Landmarks] | None:
    from facewright.landmarks.files import read_landmarks

    found = find_sidecar(path)
    if found is None:
        return None
    landmarks = read_landmarks(found[1])
    return found[0], landmarks if landmarks.scheme == "fw74" else landmarks.convert("fw74")


def _is_complete(sidecar: tuple[int, Landmarks] | None) -> bool:
    return sidecar is not None and bool(sidecar[1].present.all())


def _checked_frame(number: int, recording: Recording, path: Path) -> int:
    if not 0 <= number < recording.n_frames:
        raise ValueRangeError(
            f"landmarks of {path} must name a frame in [0, {recording.n_frames}), got {number} in the file's name."
        )
    return number


def _landmarks(
    fused: FusedDepth, sidecar: tuple[int, Landmarks] | None, detector: LandmarkDetector | None, path: Path
) -> tuple[Landmarks, str]:
    """Return fw74 landmarks of the reference frame and where they come from."""
    if sidecar is not None and (_is_complete(sidecar) or detector is None):
        return sidecar[1], "sidecar"
    faces = detector.detect(fused.color) if detector is not None else []
    inside = [face for face in faces if _overlaps(face.box, fused.rectangle)]
    if not inside:
        if sidecar is not None and sidecar[1].present.any():
            return sidecar[1], "sidecar"
        raise NoFaceError(
            f"frame {fused.reference} of {path} must show a face in its face rectangle, the detector found none."
        )
    found = inside[0].convert("fw74")
    if sidecar is None:
        return found, "detector"
    return found.overridden_by(sidecar[1]), "detector and sidecar"


def _overlaps(box: tuple[float, float, float, float], rectangle: tuple[int, int, int, int]) -> bool:
    x, y = 0.5 * (box[0] + box[2]), 0.5 * (box[1] + box[3])
    return rectangle[0] <= x < rectangle[2] and rectangle[1] <= y < rectangle[3]


def padded(pictures: list[NDArray[Any]]) -> NDArray[Any]:
    """Stack pictures (H, W) or (H, W, C), smaller ones filled with zeros on the right and below: pixels stay."""
    height, width = (max(picture.shape[axis] for picture in pictures) for axis in (0, 1))
    stack = np.zeros((len(pictures), height, width, *pictures[0].shape[2:]), dtype=pictures[0].dtype)
    for row, picture in zip(stack, pictures):
        row[: picture.shape[0], : picture.shape[1]] = picture
    return stack
