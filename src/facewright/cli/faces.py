"""facewright faces: which faces there are, installing one, looking at one."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from facewright.cli.console import JsonOption, finish, progress_bar, say, table

app = typer.Typer(no_args_is_help=True, help="List, install and look at faces.", rich_markup_mode="rich")


@app.command("list")
def list_command(as_json: JsonOption = False) -> None:
    """List the faces and whether they are installed.

    \b
    Examples:
      facewright faces list
      facewright faces list --json
    """
    from dataclasses import asdict

    from facewright.faces import list_faces

    infos = [asdict(info) for info in list_faces()]
    rows = [[i["name"], "yes" if i["installed"] else "no", i["description"], i["licence"]] for i in infos]
    finish({"faces": infos}, as_json, lambda: table("Faces", ["name", "installed", "description", "licence"], rows))


@app.command("install")
def install(
    name: Annotated[str, typer.Argument(help="Face to install: ict.")],
    source: Annotated[
        Path | None,
        typer.Option("--from", help="Archive, unpacked folder or compact .npz that you have; else it is downloaded."),
    ] = None,
    as_json: JsonOption = False,
) -> None:
    """Install a face for this user: from its authors' site, or from a file.

    \b
    Examples:
      facewright faces install ict
      facewright faces install ict --from ICT-FaceKit.zip
    """
    from facewright.faces.install import install_ict
    from facewright.numeric.check import check_choice

    check_choice("face to install", name, ("ict",))
    with progress_bar(as_json) as progress:
        path = install_ict(source, progress)
    finish({"face": name, "path": path}, as_json, lambda: say(f"Installed {name} in {path}."))


@app.command("show")
def show(
    name: Annotated[str, typer.Argument(help="Name of a face, or path of its .npz file.")] = "builtin",
    out: Annotated[Path | None, typer.Option("--out", "-o", help="Picture to write: the 20 expressions.")] = None,
    seed: Annotated[
        int | None, typer.Option(help="Draw the simulated person of this seed in place of the mean.", min=0)
    ] = None,
    as_json: JsonOption = False,
) -> None:
    """Describe a face and, with --out, draw its 20 expressions.

    \b
    Examples:
      facewright faces show builtin
      facewright faces show ict --out ict.png --seed 3
    """
    from facewright.apps.show_face import ShowFaceRequest, show_face

    with progress_bar(as_json) as progress:
        found = show_face(ShowFaceRequest(name, out, seed), progress)
    rows = [[key.replace("_", " "), _short(value)] for key, value in found.items()]
    finish(found, as_json, lambda: table(f"Face {name}", ["", "value"], rows))


def _short(value: object) -> str:
    if isinstance(value, dict):
        return ", ".join(f"{key} {item}" for key, item in value.items())
    return ", ".join(map(str, value)) if isinstance(value, list | tuple) else str(value)
