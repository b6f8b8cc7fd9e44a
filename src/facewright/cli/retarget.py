"""facewright retarget: the person in a photograph does what the person in a video does."""

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


def retarget(
    video: Annotated[Path, typer.Argument(help="The video: who acts.")],
    photo: Annotated[Path, typer.Argument(help="The photograph: who shall do the same.")],
    out: Annotated[Path, typer.Option("--out", "-o", help="The video to write: .mp4, .mov, .m4v or .mkv.")] = Path(
        "retargeted.mp4"
    ),
    head: HeadOption = "follow",
    head_scale: HeadScaleOption = 0.5,
    rest: RestOption = "clip",
    sound: Annotated[bool, typer.Option("--sound/--no-sound", help="Keep the video's sound.")] = True,
    csv: Annotated[
        bool, typer.Option("--csv", help="Also write the curves, a Live Link Face recording, beside the video.")
    ] = False,
    glb: GlbOption = False,
    size: SizeOption = 1280,
    quality: QualityOption = 18,
    model: ModelOption = None,
    face: FaceOption = 0,
    video_face: Annotated[
        int, typer.Option("--video-face", help="Which of several faces of the video; 0 is the largest.", min=0)
    ] = 0,
    landmarks: LandmarksOption = None,
    task_file: TaskFileOption = None,
    focal: FocalOption = None,
    as_json: JsonOption = False,
) -> None:
    """Carry the performance in a video to a photograph, with its sound and frame rate.

    Coefficients are absolute: where the actor is neutral the photo's person is. Frames without a face hold the
    expression and ease to neutral. A killed run is taken up where it ended by giving the same command again.

    \b
    Examples:
      facewright retarget clip.mp4 portrait.jpg -o speaks.mp4
      facewright retarget clip.mp4 portrait.jpg --head keep --csv --glb -o speaks.mp4
      facewright retarget clip.mp4 group.jpg --face 1 --head scale --head-scale 0.5 -o speaks.mp4
    """
    from facewright.apps.animate import PhotoChoice
    from facewright.apps.photo_motion import MotionOptions
    from facewright.apps.retarget import RetargetRequest
    from facewright.apps.retarget import retarget as run
    from facewright.apps.track_video import VideoChoice

    request = RetargetRequest(
        VideoChoice(video, video_face, task_file),
        PhotoChoice(photo, model, face, landmarks, task_file, focal, size),
        out,
        MotionOptions(head, head_scale, rest),
        sound,
        csv,
        glb,
        quality,
    )
    with progress_bar(as_json) as progress:
        result = run(request, progress)
    finish_clip(result, as_json)
