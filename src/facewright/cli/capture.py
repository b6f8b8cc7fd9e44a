"""facewright capture: look at recordings of depth cameras, mark landmarks in them."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from facewright.cli.capture_fuse import fuse
from facewright.cli.console import JsonOption, finish, progress_bar, say, table
from facewright.cli.wording import counted

app = typer.Typer(
    no_args_is_help=True, help="Look at recordings of depth cameras, mark landmarks.", rich_markup_mode="rich"
)


@app.command("show")
def show(
    recording: Annotated[
        Path, typer.Argument(help="Folder (TUM style, or TrueDepth .ply frames), or .r3d, .bag, .mkv file.")
    ],
    out: Annotated[
        Path | None, typer.Option("--out", "-o", help="Picture to write: frames in colour and depth.")
    ] = None,
    frames: Annotated[int, typer.Option(help="Frames on the picture.", min=1, max=100)] = 8,
    turn: Annotated[
        int | None,
        typer.Option(help="Counter-clockwise quarter turns, for heads that lie on their side.", min=0, max=3),
    ] = None,
    save: Annotated[
        bool, typer.Option("--save-turn", help="Note the turn beside the recording: every command then turns it.")
    ] = False,
    as_json: JsonOption = False,
) -> None:
    """Describe a recording, reading every frame, and draw some of them with --out.

    \b
    Examples:
      facewright capture show captures/anna/smile
      facewright capture show scan.r3d --out sheet.png
      facewright capture show truedepth_frames --turn 3 --out sheet.png
    """
    from facewright.apps.show_capture import ShowCaptureRequest, show_capture
    from facewright.capture.camera_file import camera_path

    request = ShowCaptureRequest(recording, out, frames, turn, save)
    with progress_bar(as_json) as progress:
        facts = show_capture(request, progress)
    noted = camera_path(recording) if save else None
    facts["turn_noted_in"] = noted

    def lines() -> None:
        camera = f"{facts['focal_x']:.2f}, {facts['focal_y']:.2f}; {facts['centre_x']:.2f}, {facts['centre_y']:.2f}"
        rows = [
            ["kind", facts["kind"]],
            ["frames", f"{facts['frames']} in {facts['seconds']:.2f} s"],
            ["size", f"{facts['width']} x {facts['height']}"],
            ["focal lengths; principal point", camera],
            ["quarter turns", str(facts["quarter_turns"])],
            ["nearest things", f"{facts['nearest_mm']:.0f} mm"],
            ["pixels with depth", f"{100 * facts['depth_share']:.0f} % (least {100 * facts['depth_share_least']:.0f})"],
        ]
        table(f"Recording {recording}", ["", "value"], rows)
        for sentence in facts["warnings"]:
            say(f"Note: {sentence}")
        if noted is not None:
            say(f"Noted {counted(facts['quarter_turns'], 'quarter turn')} in {noted}: every command turns it now.")
        if out is not None:
            say(f"Wrote {out}.")

    finish(facts, as_json, lines)


@app.command("landmarks")
def landmarks(
    captures: Annotated[Path, typer.Argument(help="Folder of subjects with recordings of expressions.")],
    overwrite: Annotated[
        bool, typer.Option("--overwrite", help="Replace landmark files, though somebody may have refined them.")
    ] = False,
    pictures: Annotated[
        Path | None, typer.Option(help="Folder for a sheet per subject with the points drawn in.")
    ] = None,
    only: Annotated[list[str] | None, typer.Option(help="Mark only this subject; may be given again.")] = None,
    task_file: Annotated[
        Path | None, typer.Option(help="MediaPipe face_landmarker.task file, for newer MediaPipe releases.")
    ] = None,
    as_json: JsonOption = False,
) -> None:
    """Detect 74 points in the most frontal frame of every recording and leave them there as landmarks-FRAME.json.

    Edit the points by hand where they are off: the build takes them before the detector's own.

    \b
    Examples:
      facewright capture landmarks captures
      facewright capture landmarks captures --pictures sheets --only anna
    """
    from facewright.apps.mark_captures import MarkCapturesRequest, mark_captures

    request = MarkCapturesRequest(captures, overwrite, pictures, tuple(only or ()), task_file)
    with progress_bar(as_json) as progress:
        result = mark_captures(request, progress)
    payload = {
        "written": result.written,
        "kept": result.kept,
        "turned": result.turned,
        "failed": result.failed,
        "pictures": result.pictures,
    }

    def lines() -> None:
        if result.failed:
            table("No landmarks", ["recording", "why"], [[name, why] for name, why in result.failed.items()])
        for name, turns in result.turned.items():
            say(f"{name} lay on its side: {counted(turns, 'quarter turn is', 'quarter turns are')} noted beside it.")
        kept = f", kept {len(result.kept)} that were there (--overwrite replaces them)" if result.kept else ""
        say(f"Wrote {counted(len(result.written), 'landmark file')}{kept}; {len(result.failed)} failed.")

    finish(payload, as_json, lines)


app.command("fuse")(fuse)
