"""Options that all commands on photos and videos share, and how they say what they noticed."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path
from typing import Annotated

import typer

from facewright.cli.console import say_aside

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


def say_remarks(remarks: Iterable[str]) -> None:
    """Say on stderr what was made of unusual input, a sentence a line."""
    for remark in remarks:
        is_file = "." in remark.partition(" ")[0]  # names of files stay as they are
        say_aside(remark if is_file else remark[:1].upper() + remark[1:])
