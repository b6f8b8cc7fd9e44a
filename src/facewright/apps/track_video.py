"""A video becomes FACS coefficients and head poses: one person, one identity, absolute coefficients."""

from __future__ import annotations

import os
import time
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from facewright.apps.default_model import model_or_default
from facewright.apps.landmark_video import LandmarkVideo, find_video_landmarks
from facewright.apps.performance_files import write_performance_csv, write_performance_glb
from facewright.apps.performance_json import write_performance_json
from facewright.apps.untracked_frames import fill_untracked, gaps_sentence
from facewright.errors import NoFaceError, ValueRangeError
from facewright.io.video_reader import VideoReader
from facewright.io.work_folder import WorkFolder, file_identity
from facewright.landmarks.face_crops import CROP_SIDE
from facewright.numeric.threads import one_blas_thread

if TYPE_CHECKING:
    from facewright.fitting.video import VideoFit
    from facewright.models.bilinear import BilinearModel
    from facewright.models.performance import Performance

Progress = Callable[[str, int, int], None]

STAGE = "landmarks"
WRITE_SUFFIXES = (".csv", ".json")


@dataclass(frozen=True)
class VideoChoice:
    """Which face of which video.

    Parameters
    ----------
    video : Path
        The video.
    face_index : int
        Which of several faces, the largest being 0.
    task_file : Path, optional
        MediaPipe task file.
    """

    video: Path
    face_index: int = 0
    task_file: Path | None = None

    def __post_init__(self) -> None:
        if self.face_index < 0:
            raise ValueRangeError(f"face_index must not be negative, got {self.face_index}.")

    def identity(self) -> dict[str, Any]:
        """Return what a resumed run compares."""
        task = None if self.task_file is None else file_identity(self.task_file)
        return {"video": file_identity(self.video), "face": self.face_index, "task": task}


@dataclass(frozen=True, eq=False)
class TrackedVideo:
    """What a face does in a video.

    Parameters
    ----------
    video : LandmarkVideo
        Landmarks and what the file says.
    fit : VideoFit
        Identity and residuals.
    performance : Performance
        Coefficients, poses and gaze; frames without a face filled by `fill_untracked`.
    notes : tuple of str
        What a user should know: sentences.
    numbers : mapping of str to float
        ``landmark_residual_iod`` (mean over frames), ``detect_ms`` and ``fit_ms`` a frame.
    """

    video: LandmarkVideo
    fit: VideoFit
    performance: Performance
    notes: tuple[str, ...]
    numbers: dict[str, float]


@dataclass(frozen=True)
class TrackVideoRequest:
    """What to track and where to write.

    Parameters
    ----------
    choice : VideoChoice
        The video.
    out : Path
        ``.csv`` (Live Link Face) or ``.json`` (our 46 shapes, poses, gaze, residuals).
    model : Path, optional
        Model file; the default model where absent.
    glb : bool
        Also write the actor, animated, beside the curves: the face at rest as the clip shows it, its head where it is.
    """

    choice: VideoChoice
    out: Path
    model: Path | None = None
    glb: bool = False

    def __post_init__(self) -> None:
        if self.out.suffix.lower() not in WRITE_SUFFIXES:
            raise ValueRangeError(f"out must end in {' or '.join(WRITE_SUFFIXES)}, got {self.out.name!r}.")


def track_video(request: TrackVideoRequest, progress: Progress | None = None) -> TrackedVideo:
    """Track the face in a video and write its curves; a killed run is taken up by asking for the same again.

    Parameters
    ----------
    request : TrackVideoRequest
        What.
    progress : callable, optional
        Called with stage, done, total.

    Raises
    ------
    NoFaceError
        If no frame shows a face.
    FacewrightError
        Of the video, the model or the files; one sentence each.
    """
    with VideoReader(request.choice.video):
        pass  # a file that is no video is told at once
    with WorkFolder(request.out) as work:
        model = model_or_default(request.model, progress)
        tracked = track(work, request.choice, model, progress)
        ready = work.path / f"result{request.out.suffix}"
        write_curves(ready, tracked)
        if request.glb:
            _write_actor(work.path / "result.glb", tracked)
            os.replace(work.path / "result.glb", request.out.with_suffix(".glb"))  # noqa: PTH105
        os.replace(ready, request.out)  # noqa: PTH105
        work.remove()
    return tracked


def track(
    work: WorkFolder, choice: VideoChoice, model: BilinearModel, progress: Progress | None = None
) -> TrackedVideo:
    """Find landmarks, fit them and fill frames without a face; landmarks are kept in the work folder.

    Raises
    ------
    NoFaceError
        If no frame shows a face.
    """
    from facewright import __version__
    from facewright.fitting.video import VideoFitter

    folder = work.stage(STAGE, choice.identity() | {"version": __version__, "crops": CROP_SIDE})
    began = time.perf_counter()
    video = find_video_landmarks(
        choice.video, folder, face_index=choice.face_index, task_file=choice.task_file, progress=progress
    )
    found = time.perf_counter()
    T = video.track.n_frames
    if not video.track.tracked.any():
        raise NoFaceError(f"{choice.video} must show a face, none was found in any of its {T} frames.")
    with one_blas_thread():
        fit = VideoFitter(model).fit(video.track, progress=progress, crops=video.crops)
    video = replace(video, crops=None)  # files of the work folder, which goes away
    performance, gaps = fill_untracked(fit.performance, video.track.cuts)
    fitted = time.perf_counter()
    notes = list(video.notes)
    if video.info.quarter_turns:
        notes.append(f"{choice.video.name} is turned upright by {90 * video.info.quarter_turns} degrees, as it asks.")
    # a cut into frames without a face is told with those
    cuts = np.flatnonzero(video.track.cuts & video.track.tracked)
    if len(cuts):
        listed = ", ".join(str(k) for k in cuts[:12]) + (" ..." if len(cuts) > 12 else "")
        shots = f"1 scene cut (at frame {listed})" if len(cuts) == 1 else f"{len(cuts)} scene cuts (at frames {listed})"
        notes.append(f"{shots}: pose and smoothing start anew there.")
    sentence = gaps_sentence(gaps, T)
    if sentence is not None:
        notes.append(sentence)
    numbers = {
        "landmark_residual_iod": float(np.nanmean(fit.residuals_iod)),
        "detect_ms": 1e3 * (found - began) / T,
        "fit_ms": 1e3 * (fitted - found) / T,
    }
    return TrackedVideo(video, fit, performance, tuple(notes), numbers)


def write_curves(path: Path, tracked: TrackedVideo) -> None:
    """Write curves by the suffix: Live Link Face CSV, or JSON with all that was found.

    Raises
    ------
    StoreError
        If the file cannot be written.
    """
    if path.suffix.lower() == ".csv":
        write_performance_csv(path, tracked.performance)
        return
    extras = {
        "residuals_iod": [None if np.isnan(r) else round(float(r), 6) for r in tracked.fit.residuals_iod],
        "identity_weights": tracked.fit.identity.identity_weights.tolist(),
    }
    write_performance_json(path, tracked.performance, tracked.video.track.cuts, extras)


def _write_actor(path: Path, tracked: TrackedVideo) -> None:
    """Write the clip's person playing the clip's performance, in made-up colours."""
    from facewright.apps.paint_person import person_colors
    from facewright.apps.photo_subject import complete_rig, face_of

    model = tracked.fit.identity.model
    face = face_of(model)
    rig, _ = complete_rig(model, tracked.fit.identity.rig, face)
    licence = str(model.provenance.get("licence", ""))
    write_performance_glb(
        path, tracked.performance, rig, face, places=True, vertex_colors=person_colors(face), copyright=licence
    )
