"""facewright track: a video becomes FACS coefficients and head poses."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from facewright.cli.console import JsonOption, finish, progress_bar, say
from facewright.cli.photo_options import FaceOption, ModelOption, TaskFileOption, say_remarks


def track(
    video: Annotated[Path, typer.Argument(help="The video.")],
    out: Annotated[
        Path, typer.Option("--out", "-o", help="The curves: .csv (Live Link Face) or .json (46 shapes, poses, gaze).")
    ] = Path("curves.csv"),
    glb: Annotated[bool, typer.Option("--glb", help="Also write the actor, animated, beside the curves.")] = False,
    model: ModelOption = None,
    face: FaceOption = 0,
    task_file: TaskFileOption = None,
    as_json: JsonOption = False,
) -> None:
    """Track the face in a video: FACS coefficients and head poses of every frame, absolute, one identity for the clip.

    Frames without a face hold the expression and ease to neutral. A killed run is taken up where it ended by giving the
    same command again.

    \b
    Examples:
      facewright track clip.mp4 -o curves.csv
      facewright track clip.mp4 -o everything.json --face 1 --glb
      facewright animate portrait.jpg --curves curves.csv -o portrait.mp4
    """
    from facewright.apps.track_video import TrackVideoRequest, VideoChoice, track_video

    request = TrackVideoRequest(VideoChoice(video, face, task_file), out, model, glb)
    with progress_bar(as_json) as progress:
        tracked = track_video(request, progress)
    performance = tracked.performance
    payload = {
        "paths": {"curves": out} | ({"glb": out.with_suffix(".glb")} if glb else {}),
        "frames": performance.n_frames,
        "frames_tracked": int(performance.tracked.sum()),
        "notes": list(tracked.notes),
        **tracked.numbers,
    }

    def show() -> None:
        say_remarks(tracked.notes)
        say(f"curves: {out}")
        if glb:
            say(f"glb: {out.with_suffix('.glb')}")
        say(
            f"{performance.n_frames} frames, a face in {int(performance.tracked.sum())}; points are off by "
            f"{100 * tracked.numbers['landmark_residual_iod']:.1f} % of the distance between the eyes."
        )

    finish(payload, as_json, show)
