"""Options that the commands on videos share, and how they say what they made."""

from __future__ import annotations

from typing import TYPE_CHECKING, Annotated, Any

import typer

from facewright.cli.console import finish, say
from facewright.cli.photo_options import say_remarks

if TYPE_CHECKING:
    from facewright.apps.animate import ClipResult

HeadOption = Annotated[
    str,
    typer.Option(
        "--head",
        help="follow: the photo's head turns as the actor's, within what a photo can bear; keep: it stays; scale: it "
        "turns by --head-scale of it.",
    ),
]
HeadScaleOption = Annotated[float, typer.Option("--head-scale", help="Share of the actor's turns, 0 to 2.")]
RestOption = Annotated[
    str,
    typer.Option(
        "--rest",
        help="Which pose and gaze of the actor mean those of the photo: clip, the usual ones of the clip (median), or "
        "camera, facing the camera.",
    ),
]
SizeOption = Annotated[int, typer.Option("--size", help="Photos with a longer side are drawn at this size, pixels.")]
QualityOption = Annotated[
    int,
    typer.Option("--quality", help="H.264 rate factor: 18 is hardly visible loss, larger is smaller.", min=0, max=51),
]
GlbOption = Annotated[bool, typer.Option("--glb", help="Also write the photo's person, animated, beside the video.")]


def finish_clip(result: ClipResult, as_json: bool) -> None:
    """Say what was made."""
    payload: dict[str, Any] = {
        "paths": result.paths,
        "frames": result.n_frames,
        "frames_per_second": result.frame_rate,
        "frames_tracked": result.tracked,
        "notes": list(result.notes),
        **result.numbers,
    }

    def show() -> None:
        say_remarks(result.notes)
        for what, path in result.paths.items():
            say(f"{what}: {path}")
        say(f"{result.n_frames} frames, {result.frame_rate:.4g} a second.")

    finish(payload, as_json, show)
