"""facewright simulate: recordings and people made up, to try things without a camera."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from facewright.cli.console import JsonOption, finish, progress_bar, say
from facewright.cli.wording import counted

app = typer.Typer(
    no_args_is_help=True, help="Make up recordings and people to try things with.", rich_markup_mode="rich"
)


@app.command("captures")
def captures(
    out: Annotated[Path, typer.Argument(help="Folder for the captures; one folder a person is added to it.")],
    subjects: Annotated[int, typer.Option(help="People.", min=1, max=1000)] = 3,
    faces: Annotated[str, typer.Option("--faces", help="Face: builtin, ict, or the path of a .npz file.")] = "builtin",
    frames: Annotated[int, typer.Option(help="Frames a recording, 30 a second.", min=1, max=3000)] = 24,
    expressions: Annotated[str | None, typer.Option(help="Expressions with commas between; all 20 if absent.")] = None,
    turn: Annotated[float, typer.Option(help="Turn of the head to each side, degrees.", min=0.0, max=60.0)] = 15.0,
    noise: Annotated[bool, typer.Option("--noise/--no-noise", help="A Kinect's noise, or perfect pictures.")] = True,
    landmarks: Annotated[
        str,
        typer.Option(help="none, or refined: also write points as a careful person sets them."),
    ] = "none",
    truth: Annotated[bool, typer.Option("--truth", help="Write the true meshes beside, as truth.npz.")] = False,
    seed: Annotated[int, typer.Option(help="Seed of people, acting and noise.", min=0)] = 0,
    as_json: JsonOption = False,
) -> None:
    """Simulate people who act expressions before a Kinect while they turn their heads: RGB-D recordings on disk.

    \b
    Examples:
      facewright simulate captures people
      facewright simulate captures people --expressions neutral,smile
      facewright simulate captures people --faces ict --truth
    """
    from facewright.apps.simulate_captures import SimulateCapturesRequest, simulate_captures
    from facewright.faces.expressions import EXPRESSION_NAMES

    chosen = EXPRESSION_NAMES if expressions is None else tuple(name.strip() for name in expressions.split(","))
    request = SimulateCapturesRequest(
        out=out,
        n_subjects=subjects,
        face=faces,
        n_frames=frames,
        expressions=chosen,
        turn_degrees=turn,
        seed=seed,
        noise=noise,
        landmarks=landmarks,
        truth=truth,
    )
    with progress_bar(as_json) as progress:
        result = simulate_captures(request, progress)
    payload = {
        "path": result.out,
        "subjects": result.subjects,
        "recordings": result.n_recordings,
        "frames": result.n_frames,
        "bytes": result.n_bytes,
    }
    finish(
        payload,
        as_json,
        lambda: say(
            f"Wrote {counted(len(result.subjects), 'person', 'people')}, {counted(result.n_recordings, 'recording')}, "
            f"{counted(result.n_frames, 'frame')} "
            f"({result.n_bytes / 1e6:.0f} MB) to {result.out}; next: facewright build {result.out} -o faces.zarr"
        ),
    )


@app.command("people")
def people(
    out: Annotated[str, typer.Argument(help="Database: a folder, or a URL such as s3://bucket/faces.zarr.")],
    number: Annotated[int, typer.Option("--people", help="People; those who are there already stay.", min=1)] = 40,
    faces: Annotated[str, typer.Option("--faces", help="Face: builtin, ict, or the path of a .npz file.")] = "builtin",
    seed: Annotated[int, typer.Option(help="Seed of the people.", min=0)] = 0,
    as_json: JsonOption = False,
) -> None:
    """Put simulated people with 46 blendshapes straight into a database, so that a model can be built early.

    \b
    Examples:
      facewright simulate people faces.zarr
      facewright simulate people faces.zarr --people 150 --faces ict
    """
    from facewright.apps.simulate_people import SimulatePeopleRequest, simulate_people

    with progress_bar(as_json) as progress:
        result = simulate_people(SimulatePeopleRequest(out, number, faces, seed), progress)
    payload = {"database": result.url, "added": result.added, "present": result.present}
    there = f"; {counted(len(result.present), 'was', 'were')} there already" if result.present else ""
    added = counted(len(result.added), "simulated person", "simulated people")
    finish(
        payload,
        as_json,
        lambda: say(f"Added {added} to {out}{there}; next: facewright model build {out} -o faces.fwbm"),
    )


@app.command("performance")
def performance(
    out: Annotated[Path, typer.Argument(help="Folder for the session; one folder a performer is added to it.")],
    faces: Annotated[str, typer.Option("--faces", help="Face: builtin, ict, or the path of a .npz file.")] = "builtin",
    performers: Annotated[
        str | None, typer.Option(help="Of M1, F1, M2 and F2, with commas between; all four if absent.")
    ] = None,
    clips: Annotated[str | None, typer.Option(help="Clips with commas between; all if absent.")] = None,
    file_format: Annotated[str, typer.Option("--format", help="Of the marker files: c3d, trc or csv.")] = "c3d",
    meshes: Annotated[bool, typer.Option("--meshes", help="Write the true surfaces beside, 15 a second.")] = False,
    curves: Annotated[
        str | None,
        typer.Option(help="Live Link Face recording for the range of motion, or none for a made-up one."),
    ] = None,
    seed: Annotated[int, typer.Option(help="Seed of performers, takes and noise.", min=0)] = 0,
    as_json: JsonOption = False,
) -> None:
    """Simulate a motion capture session: four performers act 18 emotional sentences each, with markers on their faces.

    The first, M1, also acts a range of motion and 86 FACS combinations. Markers are 3 mm wide and about 1 cm apart,
    120 frames a second, with 0.2 mm of noise, dropouts and swapped labels.

    \b
    Examples:
      facewright simulate performance session
      facewright simulate performance session --performers M1 --clips neutral,pride_01,rage_05 --format csv
      facewright simulate performance session --faces ict --meshes
    """
    from facewright.apps.simulate_performance import SimulatePerformanceRequest, simulate_performance

    request = SimulatePerformanceRequest(
        out=out,
        face=faces,
        seed=seed,
        format=file_format,
        performers=_listed(performers),
        clips=_listed(clips),
        meshes=meshes,
        curves=curves,
    )
    with progress_bar(as_json) as progress:
        result = simulate_performance(request, progress)
    payload = {
        "path": result.out,
        "performers": result.performers,
        "clips": result.n_clips,
        "frames": result.n_frames,
        "bytes": result.n_bytes,
        "range_of_motion": result.range_of_motion,
    }
    finish(
        payload,
        as_json,
        lambda: say(
            f"Wrote {counted(result.n_clips, 'clip')} of {counted(len(result.performers), 'performer')}, "
            f"{counted(result.n_frames, 'frame')} ({result.n_bytes / 1e6:.0f} MB) to {result.out}; "
            f"next: facewright mocap import {result.out}/{next(iter(result.performers))}/*.{file_format} -o face.fwms"
        ),
    )


def _listed(text: str | None) -> tuple[str, ...] | None:
    return None if text is None else tuple(name.strip() for name in text.split(","))
