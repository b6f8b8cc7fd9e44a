"""facewright fit: a photograph becomes a 3D face."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from facewright.cli.console import JsonOption, finish, progress_bar, say


def fit(
    photo: Annotated[Path, typer.Argument(help="The photograph.")],
    model: Annotated[Path, typer.Option("--model", "-m", help="Model file, see: facewright model build.")],
    out: Annotated[Path, typer.Option("--out", "-o", help="Folder for the results.")] = Path("fit"),
    as_json: JsonOption = False,
) -> None:
    """Fit the face in a photograph.

    \b
    Examples:
      facewright fit portrait.jpg --model face.fwbm
    """
    from facewright.apps.fit_photo import FitPhotoRequest, fit_photo

    with progress_bar(as_json) as progress:
        result = fit_photo(FitPhotoRequest(photo=photo, model=model, out=out), progress)
    finish({"result": str(result)}, as_json, lambda: say(str(result)))
