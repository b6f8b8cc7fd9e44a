"""facewright demo: the whole tour on the built-in face and a real photograph."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from facewright.cli.console import JsonOption, finish, progress_bar, say


def demo(
    out: Annotated[Path, typer.Option("--out", "-o", help="Folder for the page and its files.")] = Path("demo"),
    seed: Annotated[int, typer.Option(help="Seed of the simulated people.", min=0)] = 0,
    as_json: JsonOption = False,
) -> None:
    """Build a model, fit a photograph, export a rig, and show it all on one page.

    Uses the built-in face and the astronaut portrait that scikit-image ships; needs no download, and the landmarks
    extra for the detector. Takes about a minute on two cores.

    \b
    Examples:
      facewright demo
      facewright demo --out /tmp/tour --seed 7
    """
    from dataclasses import asdict

    from facewright.apps.demo import run_demo

    with progress_bar(as_json) as progress:
        result = run_demo(out, seed, progress)
    finish(asdict(result), as_json, lambda: say(f"Open {out / 'index.html'} in a browser."))
