"""facewright animate: curves play on a photograph."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from facewright.cli.clip_options import (
    GlbOption,
    HeadOption,
    HeadScaleOption,
    QualityOption,
    RestOption,
    SizeOption,
    finish_clip,
)
from facewright.cli.console import JsonOption, progress_bar
from facewright.cli.photo_options import FaceOption, FocalOption, LandmarksOption, ModelOption, TaskFileOption


def animate(
    photo: Annotated[Path, typer.Argument(help="The photograph.")],
    curves: Annotated[
        Path,
        typer.Option(
            "--curves",
            "-c",
            help="CSV (Live Link Face, Audio2Face, any with ARKit's names), or JSON of track.",
        ),
    ],
    out: Annotated[Path, typer.Option("--out", "-o", help="The video: .mp4, .mov, .m4v or .mkv.")] = Path(
        "animated.mp4"
    ),
    head: HeadOption = "follow",
    head_scale: HeadScaleOption = 0.5,
    rest: RestOption = "camera",
    fps: Annotated[float | None, typer.Option("--fps", help="Frames a second; the curves' own if absent.")] = None,
    sound: Annotated[Path | None, typer.Option("--sound", help="Sound or video file whose sound is added.")] = None,
    glb: GlbOption = False,
    size: SizeOption = 1280,
    quality: QualityOption = 18,
    model: ModelOption = None,
    face: FaceOption = 0,
    landmarks: LandmarksOption = None,
    task_file: TaskFileOption = None,
    focal: FocalOption = None,
    as_json: JsonOption = False,
) -> None:
    """Play a recording of face curves on a photograph.

    Coefficients are absolute: a smiling photo becomes neutral where the curves are zero. A killed run is taken up where
    it ended by giving the same command again.

    \b
    Examples:
      facewright animate portrait.jpg --curves recording.csv -o speaks.mp4
      facewright animate portrait.jpg --curves tracked.json -o speaks.mp4
      facewright animate portrait.jpg --curves a2f.csv --sound voice.wav --head keep -o speaks.mp4
      facewright animate portrait.jpg --curves recording.csv --glb --fps 25
    """
    from facewright.apps.animate import AnimateRequest, PhotoChoice
    from facewright.apps.animate import animate as run
    from facewright.apps.photo_motion import MotionOptions

    choice = PhotoChoice(photo, model, face, landmarks, task_file, focal, size)
    motion = MotionOptions(head, head_scale, rest)
    request = AnimateRequest(choice, curves, out, motion, fps, sound, glb, quality)
    with progress_bar(as_json) as progress:
        result = run(request, progress)
    finish_clip(result, as_json)
