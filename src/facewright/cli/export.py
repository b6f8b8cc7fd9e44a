"""facewright export: a rig as glTF or OBJ files."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from facewright.cli.console import JsonOption, finish, progress_bar, say


def export(
    out: Annotated[Path, typer.Argument(help="File to write (.glb, .gltf), or a folder for one OBJ per shape.")],
    model: Annotated[Path | None, typer.Option("--model", "-m", help="A model file; else a face is exported.")] = None,
    person: Annotated[
        int | None, typer.Option(help="Training person of the model, from 0; else its mean.", min=0)
    ] = None,
    fit: Annotated[
        Path | None, typer.Option("--fit", help="Parameters of a fitted photo (JSON), with its model.")
    ] = None,
    database: Annotated[
        str | None, typer.Option("--database", help="A database of people; exports the person of --subject.")
    ] = None,
    subject: Annotated[str | None, typer.Option(help="A person of the database.")] = None,
    faces: Annotated[str, typer.Option("--faces", help="Face: builtin, ict, or the path of a .npz file.")] = "builtin",
    seed: Annotated[
        int | None, typer.Option(help="Simulated person of that face; else its generic rig.", min=0)
    ] = None,
    names: Annotated[
        str, typer.Option(help="Shape names: facewright, arkit52, facewarehouse46, or a map file (.json).")
    ] = "facewright",
    texture: Annotated[Path | None, typer.Option(help="Picture for the skin, laid out by the face's uv.")] = None,
    animate: Annotated[bool, typer.Option("--animate", help="Add a clip that goes through the expressions.")] = False,
    as_json: JsonOption = False,
) -> None:
    """Export a rig with named blendshapes for Blender, three.js, Unity and others.

    \b
    Examples:
      facewright export face.glb --animate
      facewright export me.glb --model face.fwbm --fit photo/fit.json --texture photo/texture.png
      facewright export anna.glb --database faces.zarr --subject anna --names arkit52
      facewright export shapes/ --faces ict --seed 3 --names arkit52
    """
    from facewright.apps.export_person import ExportPersonRequest, export_person

    request = ExportPersonRequest(
        out=out,
        model=model,
        person=person,
        fit=fit,
        face=faces,
        seed=seed,
        names=names,
        texture=texture,
        animate=animate,
        database=database,
        subject=subject,
    )
    with progress_bar(as_json) as progress:
        result = export_person(request, progress)
    payload = {
        "paths": result.paths,
        "shapes": result.shape_names,
        "driven_shapes": len(result.shape_names) - len(result.empty_shapes),
        "empty_shapes": result.empty_shapes,
        "vertices": result.n_vertices,
        "faces": result.n_faces,
        "bytes": result.n_bytes,
    }
    what = result.paths[0] if len(result.paths) == 1 else f"{len(result.paths)} files in {result.paths[0].parent}"
    empty = ""
    if result.empty_shapes:
        empty = (
            f", {payload['driven_shapes']} of them driven; {len(result.empty_shapes)} are there by name "
            f"and move nothing: {', '.join(result.empty_shapes)}"
        )
    finish(
        payload,
        as_json,
        lambda: say(
            f"Wrote {what} ({result.n_bytes / 1e6:.1f} MB): {result.n_vertices} vertices, "
            f"{len(result.shape_names)} named shapes{empty}."
        ),
    )
