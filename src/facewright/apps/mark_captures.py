"""Detect the landmarks of captures and leave them beside the recordings, to be refined by hand."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from facewright.errors import FacewrightError, StoreError, ValueRangeError

if TYPE_CHECKING:
    from facewright.capture.captures import SubjectCapture
    from facewright.capture.frame import RGBDFrame
    from facewright.landmarks.detector import LandmarkDetector
    from facewright.landmarks.points import Landmarks

Progress = Callable[[str, int, int], None]

_PORTRAIT = 480


@dataclass(frozen=True)
class MarkCapturesRequest:
    """Which captures to mark.

    Parameters
    ----------
    captures : Path
        Folder of subjects, see `facewright.capture.captures.list_captures`.
    overwrite : bool
        Replace landmark files that are there, though somebody may have refined them.
    pictures : Path, optional
        Folder for a sheet per subject with the points drawn in.
    only : tuple of str
        Names of subjects; all where empty.
    task_file : Path, optional
        See `facewright.landmarks.detector.open_detector`.
    """

    captures: Path
    overwrite: bool = False
    pictures: Path | None = None
    only: tuple[str, ...] = ()
    task_file: Path | None = None


@dataclass
class MarkCapturesResult:
    """What was written.

    Parameters
    ----------
    written, kept : list of Path
        Landmark files that are new, and those that were there and stay.
    turned : dict of str to int
        Recordings whose heads lay on their side -> counter-clockwise quarter turns noted in their camera file.
    failed : dict of str to str
        Recordings or subjects -> why there are no landmarks.
    pictures : list of Path
        Sheets.
    """

    written: list[Path] = field(default_factory=list)
    kept: list[Path] = field(default_factory=list)
    turned: dict[str, int] = field(default_factory=dict)
    failed: dict[str, str] = field(default_factory=dict)
    pictures: list[Path] = field(default_factory=list)


def mark_captures(
    request: MarkCapturesRequest, progress: Progress | None = None, detector: LandmarkDetector | None = None
) -> MarkCapturesResult:
    """Write ``landmarks-<frame>.json`` beside every recording: 74 points of its most frontal frame.

    What fails is recorded and stops nothing else. Where a face is only found with the frames turned, the turn is noted
    in the recording's camera file, so that every reader turns it from then on.

    Parameters
    ----------
    request : MarkCapturesRequest
        Which captures.
    progress : callable(stage, done, total), optional
        Counts recordings.
    detector : LandmarkDetector, optional
        In place of the default one.

    Raises
    ------
    StoreError, FileFormatError
        If the captures cannot be listed.
    MissingExtraError
        If no detector is installed.
    """
    from facewright.capture.captures import list_captures
    from facewright.landmarks.detector import open_detector

    subjects = list_captures(request.captures)
    unknown = sorted(set(request.only) - {s.name for s in subjects})
    if unknown:
        raise ValueRangeError(f"only must name subjects of {request.captures}, got {', '.join(unknown)}.")
    subjects = [s for s in subjects if not request.only or s.name in request.only]
    if detector is None:
        with open_detector(request.task_file) as found:
            return _mark_all(request, subjects, found, progress)
    return _mark_all(request, subjects, detector, progress)


def _mark_all(
    request: MarkCapturesRequest,
    subjects: list[SubjectCapture],
    detector: LandmarkDetector,
    progress: Progress | None,
) -> MarkCapturesResult:
    result = MarkCapturesResult()
    total, done = sum(len(s.recordings) for s in subjects), 0
    for subject in subjects:
        if subject.problems:
            result.failed[subject.name] = " ".join(subject.problems)
        portraits: list[NDArray[np.uint8]] = []
        captions: list[str] = []
        for expression, path in subject.recordings.items():
            name = f"{subject.name}/{expression}"
            try:
                marked = _mark(request, path, name, detector, result)
            except FacewrightError as error:
                result.failed[name] = str(error)
                marked = None
            if marked is not None and request.pictures is not None:
                portraits.append(_portrait(*marked))
                captions.append(expression)
            done += 1
            if progress is not None:
                progress("marking recordings", done, total)
        if portraits and request.pictures is not None:
            result.pictures.append(_write_sheet(request.pictures, subject.name, portraits, captions))
    return result


def _mark(
    request: MarkCapturesRequest, path: Path, name: str, detector: LandmarkDetector, result: MarkCapturesResult
) -> tuple[RGBDFrame, Landmarks] | None:
    """Mark one recording; returns the frame and its points for the sheet."""
    from facewright.capture.camera_file import save_quarter_turns
    from facewright.capture.captures import find_sidecar, sidecar_path
    from facewright.capture.recording import open_recording
    from facewright.capture.reference_frame import most_frontal
    from facewright.capture.upright import find_quarter_turns
    from facewright.landmarks.files import read_landmarks, write_landmarks

    old = find_sidecar(path)
    recording = open_recording(path)
    if old is not None and not request.overwrite:
        result.kept.append(old[1])
        if not old[0] < recording.n_frames:
            raise ValueRangeError(f"{old[1]} must name a frame in [0, {recording.n_frames}), got {old[0]}.")
        return recording.frame(old[0]), read_landmarks(old[1]).convert("fw74")
    turns = find_quarter_turns(recording, detector)
    if turns:
        turns = (recording.quarter_turns + turns) % 4
        recording = open_recording(path, quarter_turns=turns)
    number, found = most_frontal(recording, detector)
    landmarks = found.convert("fw74")
    if turns:
        save_quarter_turns(path, turns)
        result.turned[name] = turns
    file = sidecar_path(path, number)
    write_landmarks(file, landmarks)
    if old is not None and old[1] != file:
        try:
            old[1].unlink()
        except OSError as error:
            raise StoreError(f"{old[1]} cannot be replaced: {error.strerror or error}.") from error
    result.written.append(file)
    return recording.frame(number), landmarks


def _portrait(frame: RGBDFrame, landmarks: Landmarks) -> NDArray[np.uint8]:
    from facewright.imaging.overlay import crop_around, draw_points

    crop, origin, zoom = crop_around(frame.color, landmarks.points, height=_PORTRAIT)
    return draw_points(crop, (landmarks.points + 0.5 - origin) * zoom - 0.5, radius=2.0)


def _write_sheet(folder: Path, name: str, portraits: list[NDArray[np.uint8]], captions: list[str]) -> Path:
    from facewright.imaging.contact_sheet import contact_sheet
    from facewright.io.image import write_image

    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise StoreError(f"{folder} must be a folder that can be made, got: {error.strerror or error}.") from error
    file = folder / f"{name}.png"
    write_image(file, contact_sheet(portraits, captions, columns=5))
    return file
