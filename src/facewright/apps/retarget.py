"""A video drives a photo: the face of a clip is tracked, and the photo's person does the same (FaceWarehouse 4.4)."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path

from facewright.apps.animate import ClipResult, PhotoChoice, subject_for_video, write_clip
from facewright.apps.default_model import model_or_default
from facewright.apps.landmark_video import frame_rate_of
from facewright.apps.performance_files import write_performance_csv
from facewright.apps.photo_motion import MotionOptions, carry_to_photo
from facewright.apps.track_video import VideoChoice, track
from facewright.io.video_reader import VideoReader
from facewright.io.video_writer import FrameClock, check_video_path
from facewright.io.work_folder import WorkFolder

Progress = Callable[[str, int, int], None]


@dataclass(frozen=True)
class RetargetRequest:
    """Whose motion goes to whose photo.

    Parameters
    ----------
    actor : VideoChoice
        The video.
    choice : PhotoChoice
        The photo.
    out : Path
        The video to write, ``.mp4``, ``.mov``, ``.m4v`` or ``.mkv``.
    motion : MotionOptions
        How head and gaze are carried.
    sound : bool
        Whether the video's sound is kept.
    csv, glb : bool
        Also write the curves as a Live Link Face recording, and the photo's person playing them, beside the video.
    quality : int
        See `facewright.io.video_writer.VideoWriter`.
    """

    actor: VideoChoice
    choice: PhotoChoice
    out: Path
    motion: MotionOptions = field(default_factory=MotionOptions)
    sound: bool = True
    csv: bool = False
    glb: bool = False
    quality: int = 18

    def __post_init__(self) -> None:
        check_video_path(self.out)


def retarget(request: RetargetRequest, progress: Progress | None = None) -> ClipResult:
    """Make the person in a photo do what the person in a video does.

    Frames keep their times. Coefficients are absolute: where the actor is neutral the photo's person is, whatever the
    photo or the first frame shows. What was tracked and drawn is kept beside the output until that is there: a killed
    run is taken up by asking for the same again, and ends with the same bytes.

    Parameters
    ----------
    request : RetargetRequest
        What.
    progress : callable, optional
        Called with stage, done, total.

    Returns
    -------
    ClipResult
        Paths, and numbers: ``fps`` from end to end without loading and opening the photo, ``detect_ms``, ``fit_ms`` and
        ``draw_ms`` a frame, ``landmark_residual_iod``.

    Raises
    ------
    NoFaceError
        If the photo or no frame of the video shows a face.
    FacewrightError
        Of the video, the photo, the model or the files; one sentence each.
    """
    with VideoReader(request.actor.video):
        pass  # a file that is no video is told at once
    with WorkFolder(request.out) as work:
        model = model_or_default(request.choice.model, progress)
        subject = subject_for_video(request.choice, progress)  # so is a photo that cannot be used
        subject.synthesiser  # noqa: B018  built before the clock starts
        began = time.perf_counter()
        tracked = track(work, request.actor, model, progress)
        performance, landmarks = tracked.performance, tracked.video.track
        motion = carry_to_photo(
            performance,
            subject.camera_from_model,
            subject.gaze,
            subject.rig.names,
            request.motion,
            cuts=landmarks.cuts,
        )
        clock = FrameClock(performance.times, frame_rate_of(tracked.video))
        curves = None
        if request.csv:
            curves = work.path / "result.csv"
            write_performance_csv(curves, performance)
        drawing = time.perf_counter()
        paths, said = write_clip(
            work,
            request.choice,
            subject,
            motion,
            clock,
            request.out,
            glb=performance if request.glb else None,
            curves=curves,
            sound_of=request.actor.video if request.sound and tracked.video.info.has_audio else None,
            sound_start=tracked.video.start,
            quality=request.quality,
            progress=progress,
        )
        ended = time.perf_counter()
    T = performance.n_frames
    numbers = tracked.numbers | {"draw_ms": 1e3 * (ended - drawing) / T, "fps": T / (ended - began)}
    if not clock.is_constant:
        said.append("the frame rate of the video varies; every frame keeps its time.")
    notes = (*tracked.notes, *subject.remarks, *motion.notes, *said)
    return ClipResult(paths, T, float(clock.frame_rate), int(performance.tracked.sum()), notes, numbers)
