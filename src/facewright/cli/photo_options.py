"""Options that all commands on photos share, and how they become a photo's person."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from facewright.cli.console import Progress, say_aside

if TYPE_CHECKING:
    from facewright.apps.photo_subject import PhotoSubject
    from facewright.models.bilinear import BilinearModel

ModelOption = Annotated[
    Path | None,
    typer.Option("--model", "-m", help="Model file; the default one, built once and kept, if absent."),
]
FaceOption = Annotated[int, typer.Option("--face", help="Which of several faces; 0 is the largest.", min=0)]
LandmarksOption = Annotated[
    Path | None,
    typer.Option(
        "--landmarks", help="Points file (.pts, .ljson, .json); its points win over detected ones, point by point."
    ),
]
TaskFileOption = Annotated[
    Path | None,
    typer.Option("--task-file", help="MediaPipe face_landmarker.task file, for newer MediaPipe releases."),
]
FocalOption = Annotated[
    float | None,
    typer.Option("--focal", help="Focal length in pixels; from the photo's EXIF data, or estimated, if absent."),
]


def load_model(model: Path | None, progress: Progress | None = None) -> BilinearModel:
    """Return the model of `--model`, or the default one."""
    if model is None:
        from facewright.apps.default_model import default_model

        return default_model(progress)
    from facewright.models.bilinear_store import load_bilinear

    return load_bilinear(model)


def open_subject(
    photo: Path,
    model: BilinearModel,
    *,
    face: int = 0,
    landmarks: Path | None = None,
    task_file: Path | None = None,
    focal: float | None = None,
    progress: Progress | None = None,
) -> PhotoSubject:
    """Return the person in a photo, with the remarks about it said aside."""
    from facewright.apps.photo_subject import open_photo_subject

    points = None
    if landmarks is not None:
        from facewright.landmarks.files import read_landmarks

        points = read_landmarks(landmarks)
    subject = open_photo_subject(
        photo,
        model,
        face_index=face,
        landmarks=points,
        task_file=task_file,
        focal_length=focal,
        progress=progress,
    )
    say_remarks(subject.remarks)
    return subject


def say_remarks(remarks: tuple[str, ...]) -> None:
    """Say on stderr what was made of unusual input."""
    for remark in remarks:
        say_aside(remark)
