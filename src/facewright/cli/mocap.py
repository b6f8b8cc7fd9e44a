"""facewright mocap: facial motion capture becomes meshes in dense correspondence."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from facewright.cli.console import JsonOption, finish, progress_bar, say, say_aside
from facewright.cli.wording import counted

app = typer.Typer(
    no_args_is_help=True,
    help="Facial motion capture becomes meshes in dense correspondence.",
    rich_markup_mode="rich",
)


@app.callback()
def root() -> None:
    """Facial motion capture becomes meshes in dense correspondence."""


@app.command("import")
def import_files(
    files: Annotated[list[Path], typer.Argument(help="One performer's .c3d, .trc or .csv files, or folders of them.")],
    out: Annotated[Path, typer.Option("--out", "-o", help="The performer's file to write, .fwms.")],
    template: Annotated[str, typer.Option(help="Face to fit: builtin, ict, or the path of a .npz file.")] = "builtin",
    vertices: Annotated[int, typer.Option(help="Vertices of the coarse mesh.", min=20, max=5000)] = 397,
    neutral: Annotated[
        str | None, typer.Option(help="CLIP or CLIP:FRAME at rest; a clip called neutral or the first frame if absent.")
    ] = None,
    performer: Annotated[str | None, typer.Option(help="The performer's name; the file's if absent.")] = None,
    unit: Annotated[str | None, typer.Option(help="mm, cm, m or in; as the files say, or guessed, if absent.")] = None,
    up: Annotated[
        str | None, typer.Option(help="Axis that points up: x, y, z or -x ...; as the files say, or found, if absent.")
    ] = None,
    standoff: Annotated[float, typer.Option(help="Height of the markers' centres above the skin, mm.")] = 1.5,
    gap_limit: Annotated[float, typer.Option(help="Longest gap that is interpolated, seconds.")] = 0.5,
    fps: Annotated[float | None, typer.Option(help="Frames a second to keep; all if absent.")] = None,
    meshes: Annotated[
        bool,
        typer.Option("--meshes", help="FILES are mesh sequences: folders of OBJ or PLY, .npz, or folders of .npz."),
    ] = False,
    picture: Annotated[Path | None, typer.Option(help="Picture of markers over mesh; beside OUT if absent.")] = None,
    as_json: JsonOption = False,
) -> None:
    """Fit a generic face to every frame of a performer's markers; one file with all clips, head motion apart.

    Markers may be of any number and in any place; labels must be those of one performer throughout. Gaps are filled,
    swapped labels mended, and it is said.

    \b
    Examples:
      facewright mocap import M1/ -o M1.fwms --template ict
      facewright mocap import neutral.c3d take1.c3d -o anna.fwms --neutral neutral:0 --fps 30
      facewright mocap import --meshes smile/ talk/ -o bob.fwms
      facewright mocap import --meshes session/M1/meshes/ -o M1.fwms
    """
    from facewright.apps.import_mocap import ImportMocapRequest, import_mocap

    request = ImportMocapRequest(
        files=tuple(files),
        out=out,
        template=template,
        n_vertices=vertices,
        neutral=neutral,
        performer=performer,
        unit=unit,
        up=up,
        standoff_mm=standoff,
        gap_limit_s=gap_limit,
        frames_per_second=fps,
        meshes=meshes,
        picture=out.with_suffix(".png") if picture is None else picture,
    )
    with progress_bar(as_json) as progress:
        result = import_mocap(request, progress)
    summary = result.summary()

    def show() -> None:
        for note in result.notes:
            say_aside(note)
        clips, frames = summary["clips"], summary["frames"]
        say(
            f"{summary['performer']}: {counted(clips, 'clip')}, {counted(frames, 'frame')} of {summary['vertices']} "
            f"vertices in {out}; picture: {result.picture}."
        )

    finish(summary, as_json, show)
