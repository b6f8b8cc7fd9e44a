"""Curves play on a photo: a tracked video, a Live Link Face recording or any table of ARKit's shapes is drawn."""

from __future__ import annotations

import hashlib
import os
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from fractions import Fraction
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from facewright.apps.draw_clip import STAGE, draw_clip, photo_for_video, photo_rig_texture, with_remarks
from facewright.apps.performance_files import read_performance, write_performance_glb
from facewright.apps.photo_motion import MotionOptions, PhotoMotion, carry_to_photo
from facewright.apps.untracked_frames import fill_untracked, gaps_sentence, pause_sentence
from facewright.errors import ValueRangeError
from facewright.io.video_writer import FrameClock, check_video_path
from facewright.io.work_folder import WorkFolder, file_identity
from facewright.models.resample_performance import resampled, usual_rate

if TYPE_CHECKING:
    from facewright.apps.photo_subject import PhotoSubject
    from facewright.models.performance import Performance

Progress = Callable[[str, int, int], None]

LONGEST_SIDE = 1280


@dataclass(frozen=True)
class PhotoChoice:
    """Which face of which photo, and how large its video is.

    Parameters
    ----------
    photo : Path
        The photo.
    model : Path, optional
        Model file; the default model where absent.
    face_index : int
        Which of several faces, the largest being 0.
    landmarks : Path, optional
        Points file for the photo.
    task_file : Path, optional
        MediaPipe task file.
    focal_length : float, optional
        Pixels of the photo file.
    longest_side : int
        Larger photos are drawn at this size, pixels.
    """

    photo: Path
    model: Path | None = None
    face_index: int = 0
    landmarks: Path | None = None
    task_file: Path | None = None
    focal_length: float | None = None
    longest_side: int = LONGEST_SIDE

    def identity(self) -> dict[str, Any]:
        """Return what a resumed run compares."""
        files = {"photo": self.photo, "model": self.model, "landmarks": self.landmarks, "task": self.task_file}
        named = {name: None if path is None else file_identity(path) for name, path in files.items()}
        return named | {"face": self.face_index, "focal": self.focal_length, "side": self.longest_side}


@dataclass(frozen=True)
class AnimateRequest:
    """What to play on what.

    Parameters
    ----------
    choice : PhotoChoice
        The photo.
    curves : Path
        CSV or JSON file of curves, see `facewright.apps.performance_files.read_performance`.
    out : Path
        The video, ``.mp4``, ``.mov``, ``.m4v`` or ``.mkv``.
    motion : MotionOptions
        How head and gaze are carried.
    frames_per_second : float, optional
        Of the video; the curves' own rate where absent.
    sound : Path, optional
        File whose sound is added, from its start.
    glb : bool
        Also write the photo's person playing the curves, ``.glb`` beside the video.
    quality : int
        See `facewright.io.video_writer.VideoWriter`.
    """

    choice: PhotoChoice
    curves: Path
    out: Path
    motion: MotionOptions = field(default_factory=lambda: MotionOptions(rest="camera"))
    frames_per_second: float | None = None
    sound: Path | None = None
    glb: bool = False
    quality: int = 18

    def __post_init__(self) -> None:
        check_video_path(self.out)
        rate = self.frames_per_second
        if rate is not None and not (np.isfinite(rate) and 1 <= rate <= 240):
            raise ValueRangeError(f"frames_per_second must be in [1, 240], got {rate}.")


@dataclass(frozen=True, eq=False)
class ClipResult:
    """What was made.

    Parameters
    ----------
    paths : mapping of str to Path
        ``video``, and ``curves``, ``glb`` where asked for.
    n_frames : int
        Frames of the video.
    frame_rate : float
        Frames a second.
    tracked : int
        Frames in which a face was seen.
    notes : tuple of str
        What a user should know: sentences.
    numbers : mapping of str to float
        What was measured.
    """

    paths: dict[str, Path]
    n_frames: int
    frame_rate: float
    tracked: int
    notes: tuple[str, ...]
    numbers: dict[str, float] = field(default_factory=dict)


def animate(request: AnimateRequest, progress: Progress | None = None) -> ClipResult:
    """Play curves on a photo.

    The video has a constant frame rate. A killed run is taken up by asking for the same again.

    Parameters
    ----------
    request : AnimateRequest
        What.
    progress : callable, optional
        Called with stage, done, total.

    Raises
    ------
    FacewrightError
        Of the curves, the photo, the model or the files; one sentence each.
    """
    performance, notes, cuts = read_performance(request.curves)
    filled, gaps = fill_untracked(performance, cuts)
    filled = replace(filled, times=filled.times - filled.times[0])
    sentence = gaps_sentence(gaps, performance.n_frames)
    rate = usual_rate(filled.times)
    pause = pause_sentence(filled.times, 1.0 / float(rate))
    if request.frames_per_second is not None:
        rate = Fraction(request.frames_per_second).limit_denominator(1001)
    n = int(np.floor(filled.times[-1] * float(rate) + 0.25)) + 1  # jitter of time codes is no frame less
    played = resampled(filled, np.minimum(np.arange(n) / float(rate), filled.times[-1]))
    shots = None if cuts is None else _cuts_at(played.times, filled.times[cuts])
    if request.sound is not None:
        file_identity(request.sound)  # tells now, not after the drawing, that it does not exist
    with WorkFolder(request.out) as work:
        subject = subject_for_video(request.choice, progress)
        motion = carry_to_photo(
            played, subject.camera_from_model, subject.gaze, subject.rig.names, request.motion, cuts=shots
        )
        clock = FrameClock(played.times, rate)
        paths, said = write_clip(
            work,
            request.choice,
            subject,
            motion,
            clock,
            request.out,
            glb=played if request.glb else None,
            sound_of=request.sound,
            quality=request.quality,
            progress=progress,
        )
    # The curves' reader counts untracked rows; the sentence about the gaps names them.
    kept = tuple(note for note in notes if sentence is None or "untracked" not in note)
    remarks = (*kept, *(said_of for said_of in (sentence, pause) if said_of), *subject.remarks, *motion.notes, *said)
    return ClipResult(paths, n, float(rate), int(performance.tracked.sum()), remarks)


def _cuts_at(times: NDArray[np.float64], cuts: NDArray[np.float64]) -> NDArray[np.bool_]:
    """Return which of the moments (N,) is the first of a shot that begins at one of `cuts`, seconds."""
    first = np.searchsorted(times, cuts - 1e-6)
    begins = np.zeros(len(times), bool)
    begins[first[first < len(times)]] = True
    return begins


def subject_for_video(choice: PhotoChoice, progress: Progress | None = None) -> PhotoSubject:
    """Open the photo of a choice at the size of its video, with the model that it names or the default one."""
    from facewright.apps.default_model import model_or_default
    from facewright.apps.photo_subject import open_photo_subject
    from facewright.landmarks.files import read_landmarks

    file, scale = photo_for_video(choice.photo, choice.longest_side)
    points = None if choice.landmarks is None else read_landmarks(choice.landmarks)
    if points is not None:  # about the picture's corner, which lies half a pixel before the first centre
        points = replace(points, points=(points.points + 0.5) * scale - 0.5)
    model = model_or_default(choice.model, progress)
    subject = open_photo_subject(
        file.pixels,
        model,
        face_index=choice.face_index,
        landmarks=points,
        task_file=choice.task_file,
        focal_length=file.focal_length if choice.focal_length is None else choice.focal_length * scale,
        progress=progress,
    )
    return with_remarks(subject, file.remarks)


def write_clip(
    work: WorkFolder,
    choice: PhotoChoice,
    subject: PhotoSubject,
    motion: PhotoMotion,
    clock: FrameClock,
    out: Path,
    *,
    glb: Performance | None = None,
    curves: Path | None = None,
    sound_of: Path | None = None,
    sound_start: float = 0.0,
    quality: int = 18,
    progress: Progress | None = None,
) -> tuple[dict[str, Path], list[str]]:
    """Draw a motion and write the video, with the files asked for; they appear together, at the end.

    Returns the paths and sentences about the sound. `curves` is a finished file to put beside the video, `glb` the
    performance for the animated person.
    """
    from facewright import __version__

    belongs = choice.identity() | {"version": __version__, "quality": quality, "motion": _digest(motion, clock)}
    folder = work.stage(STAGE, belongs)
    ready = {"video": work.path / f"result{out.suffix}"}
    notes = draw_clip(
        subject,
        motion,
        clock,
        folder,
        ready["video"],
        sound_of=sound_of,
        sound_start=sound_start,
        quality=quality,
        progress=progress,
    )
    if glb is not None:
        ready["glb"] = work.path / "result.glb"
        write_performance_glb(
            ready["glb"],
            glb,
            subject.rig,
            subject.face,
            texture=photo_rig_texture(subject),
            copyright=str(subject.fit.model.provenance.get("licence", "")),
        )
    if curves is not None:
        ready["curves"] = curves
    suffixes = {"video": out.suffix, "glb": ".glb", "curves": ".csv"}
    paths = {what: out.with_suffix(suffixes[what]) for what in ready}
    for what in reversed(list(ready)):  # the video last: where it is, everything is
        os.replace(ready[what], paths[what])  # noqa: PTH105
    work.remove()
    return paths, notes


def _digest(motion: PhotoMotion, clock: FrameClock) -> str:
    """Return a hash of all that is drawn."""
    digest = hashlib.sha256(repr((clock.frame_rate, clock.time_base)).encode())
    for array in (clock.ticks, motion.weights, motion.gaze):
        digest.update(np.ascontiguousarray(array).tobytes())
    for pose in motion.poses:
        digest.update(np.ascontiguousarray(pose.rotation).tobytes() + np.ascontiguousarray(pose.translation).tobytes())
    return digest.hexdigest()
