"""The landmarks of one face through a video file, found in pieces that a killed run keeps."""

from __future__ import annotations

import json
from collections import deque
from collections.abc import Callable, Iterator
from contextlib import closing
from dataclasses import dataclass
from fractions import Fraction
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from facewright.io.atomic import write_atomically
from facewright.io.video_reader import VideoFrame, VideoInfo, VideoReader
from facewright.landmarks.face_crops import FaceCrop, FaceCrops, cut_face
from facewright.landmarks.track import LandmarkTrack
from facewright.numeric.read_ahead import read_ahead

if TYPE_CHECKING:
    from facewright.landmarks.video_detector import VideoDetector

Progress = Callable[[str, int, int], None]

STAGE = "finding landmarks"
#: Frames of a piece: what a killed run loses at most. Every piece has a detector of its own, in every run, so that the
#: result does not depend on where a run was killed.
PIECE = 750
#: Frames before a piece that its detector is shown first, to be in the state of one that has followed the face.
WARM_UP = 10
_NAMES = ("times", "points", "tracked", "cuts")


@dataclass(frozen=True, eq=False)
class LandmarkVideo:
    """What was found in a video file.

    Parameters
    ----------
    track : LandmarkTrack
        The landmarks of all frames.
    info : VideoInfo
        What the file says of itself.
    start : float, seconds
        The file's own time of the first frame.
    notes : tuple of str
        What a user should know of the file: sentences.
    crops : FaceCrops or None
        The face's brightness in all frames, in mapped files of the work folder.
    """

    track: LandmarkTrack
    info: VideoInfo
    start: float
    notes: tuple[str, ...]
    crops: FaceCrops | None = None


def find_video_landmarks(
    path: Path,
    folder: Path,
    *,
    face_index: int = 0,
    task_file: Path | None = None,
    progress: Progress | None = None,
) -> LandmarkVideo:
    """Follow one face through a video file; decoding runs beside the detector.

    Parameters
    ----------
    path : Path
        The video.
    folder : Path
        Where pieces are kept, of this video and these options only; those that lie there are not computed again.
    face_index : int
        Which face, the largest being 0, chosen anew in every shot.
    task_file : Path, optional
        See `VideoDetector`.
    progress : callable, optional
        Called with stage, done, total.

    Raises
    ------
    MissingExtraError, StoreError, FileFormatError
        As `VideoReader` and `VideoDetector`.
    """
    ending = folder / "end.json"
    with VideoReader(path) as video:
        info = video.info
        done = _complete_pieces(folder)
        if not ending.exists():
            first = done * PIECE
            # Closed before the file is: the thread must not decode what is no longer open.
            with closing(read_ahead(video.frames(start=max(0, first - WARM_UP)))) as frames:
                n_frames = _find_pieces(frames, first, folder, info, face_index, task_file, progress)
            _write_json(ending, {"frames": n_frames, "notes": video.notes})
        start = video.start
    said = json.loads(ending.read_text(encoding="utf-8"))
    track, crops = _joined(folder, int(said["frames"]), (info.height, info.width))
    if progress is not None:
        progress(STAGE, track.n_frames, track.n_frames)
    return LandmarkVideo(track, info, start, tuple(said["notes"]), crops)


def _find_pieces(
    frames: Iterator[VideoFrame],
    first: int,
    folder: Path,
    info: VideoInfo,
    face_index: int,
    task_file: Path | None,
    progress: Progress | None,
) -> int:
    """Detect and keep all pieces from frame `first` on; returns the number of frames of the video."""
    from facewright.landmarks.video_detector import VideoDetector

    n_frames = first
    warm: deque[VideoFrame] = deque(maxlen=WARM_UP)
    for piece in _pieces(frames, first, warm):
        with VideoDetector(face_index, task_file) as detector:
            for frame in warm:
                detector.detect(frame.image)
            found, crops = _detected(detector, piece, warm, info, progress)
        n_frames += len(found["times"])
        _write_piece(folder, (n_frames - 1) // PIECE, found, crops)
    return n_frames


def frame_rate_of(video: LandmarkVideo) -> Fraction:
    """Return the rate of the frames that were read: the stated one where their times agree with it, else the mean."""
    times, stated = video.track.times, video.info.frame_rate
    if len(times) < 2:
        return stated
    measured = (len(times) - 1) / float(times[-1] - times[0])
    if abs(measured - float(stated)) < 0.01 * measured:
        return stated
    return Fraction(measured).limit_denominator(1001)


def _pieces(frames: Iterator[VideoFrame], first: int, warm: deque[VideoFrame]) -> Iterator[Iterator[VideoFrame]]:
    """Split frames into pieces; those before `first` go into `warm`."""
    ahead = next(frames, None)
    while ahead is not None and ahead.number < first:
        warm.append(ahead)
        ahead = next(frames, None)

    def piece(start: VideoFrame) -> Iterator[VideoFrame]:
        nonlocal ahead
        end = (start.number // PIECE + 1) * PIECE
        frame: VideoFrame | None = start
        while frame is not None and frame.number < end:
            yield frame
            frame = next(frames, None)
        ahead = frame

    while ahead is not None:
        yield piece(ahead)


def _detected(
    detector: VideoDetector,
    piece: Iterator[VideoFrame],
    warm: deque[VideoFrame],
    info: VideoInfo,
    progress: Progress | None,
) -> tuple[dict[str, NDArray[Any]], FaceCrops]:
    """Detect the face in the frames of one piece, and cut it out; the piece's last frames go into `warm`."""
    times, points, cuts = [], [], []
    crops: list[FaceCrop | None] = []
    for frame in piece:
        found = detector.detect(frame.image)
        times.append(frame.time)
        points.append(found.points)
        crops.append(None if found.points is None else cut_face(frame.image, found.points))
        cuts.append(found.cut)
        warm.append(frame)
        if progress is not None:
            progress(STAGE, frame.number + 1, max(info.n_frames, frame.number + 1))
    track = LandmarkTrack.of(times, points, (info.height, info.width), cuts)
    return {name: getattr(track, name) for name in _NAMES}, FaceCrops.of(crops)


def _piece_path(folder: Path, number: int) -> Path:
    return folder / f"{number:06d}.npz"


def _crops_path(folder: Path, number: int) -> Path:
    return folder / f"{number:06d}.crops.npy"


def _write_piece(folder: Path, number: int, found: dict[str, NDArray[Any]], crops: FaceCrops) -> None:
    # the pixels first: a piece that is there is whole
    with write_atomically(_crops_path(folder, number)) as temporary, temporary.open("wb") as stream:
        np.save(stream, crops.pieces[0])
    with write_atomically(_piece_path(folder, number)) as temporary, temporary.open("wb") as stream:
        np.savez(stream, **found, corners=crops.corners, steps=crops.steps)


def _write_json(path: Path, content: dict[str, Any]) -> None:
    with write_atomically(path) as temporary:
        temporary.write_text(json.dumps(content), encoding="utf-8")


def _complete_pieces(folder: Path) -> int:
    """Return the number of full pieces from the start on; a last, shorter one is done again."""
    done = 0
    while (path := _piece_path(folder, done)).exists():
        with np.load(path) as stored:
            if len(stored["times"]) < PIECE:
                break
        done += 1
    return done


def _joined(folder: Path, n_frames: int, image_size: tuple[int, int]) -> tuple[LandmarkTrack, FaceCrops]:
    parts: dict[str, list[NDArray[Any]]] = {name: [] for name in (*_NAMES, "corners", "steps")}
    pixels = []
    for number in range(-(-n_frames // PIECE)):
        with np.load(_piece_path(folder, number)) as stored:
            for name, arrays in parts.items():
                arrays.append(stored[name])
        pixels.append(np.load(_crops_path(folder, number), mmap_mode="r"))
    joined = {name: np.concatenate(arrays) for name, arrays in parts.items()}
    track = LandmarkTrack(joined["times"], joined["points"], joined["tracked"], image_size, joined["cuts"])
    return track, FaceCrops(pixels, joined["corners"], joined["steps"])
