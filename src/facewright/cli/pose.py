"""facewright pose: the page on which a face is pulled into shape."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from facewright.cli.console import JsonOption, finish, progress_bar, say


def pose(
    model: Annotated[
        Path | None,
        typer.Argument(help="A region model (.fwrm, facewright regions train); the default one if absent."),
    ] = None,
    character: Annotated[
        str | None,
        typer.Option(
            "--character",
            "-c",
            help="The face that is driven: builtin, ict, or none for the model's mesh; the built-in face if absent, "
            "where the model can drive it.",
        ),
    ] = None,
    file: Annotated[
        Path | None, typer.Option("--file", "-f", help="A pose (.fwpose) to go on with; every step is saved there.")
    ] = None,
    holistic: Annotated[
        Path | None, typer.Option("--holistic", help="A model of one region, to be shown beside the other.")
    ] = None,
    beta: Annotated[float, typer.Option("--beta", help="Weight of the boundaries (eq. 9).")] = 0.5,
    gamma: Annotated[float, typer.Option("--gamma", help="Weight of the deformation (eq. 9).")] = 0.025,
    port: Annotated[int, typer.Option("--port", help="Port of the page; 0 takes a free one.", min=0, max=65535)] = 8437,
    browser: Annotated[bool, typer.Option("--browser/--no-browser", help="Open the page in a browser.")] = True,
    as_json: JsonOption = False,
) -> None:
    """Pose a face in the browser: drag a point of it, and only its region follows.

    The page stays on this machine and needs no network. It ends with Ctrl-C; every step is saved in the file of --file,
    pose.fwpose where there is none yet.

    \b
    Examples:
      facewright pose
      facewright pose face.fwrm --character ict --file smile.fwpose
      facewright pose --no-browser --port 8500
    """
    from facewright.apps.open_session import OpenSessionRequest, open_session
    from facewright.studio.app import StudioOptions, check_studio, serve_pose_page

    check_studio()
    request = OpenSessionRequest(model, character, file, holistic, beta, gamma)
    with progress_bar(as_json) as progress:
        opened = open_session(request, progress)

    def ready(address: str) -> None:
        payload = {"address": address, "file": opened.session.autosave, "model": opened.title}
        finish(
            payload,
            as_json,
            lambda: say(f"{opened.title} at {address} (Ctrl-C ends; saved in {opened.session.autosave})"),
        )

    options = StudioOptions(port, show=browser, title=opened.title)
    serve_pose_page(opened.session, opened.character, options, ready)
