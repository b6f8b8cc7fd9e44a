"""facewright demo: the whole tour, from a depth camera's recordings to a rig."""

from __future__ import annotations

import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Annotated

import typer

from facewright.cli.console import JsonOption, Progress, finish, progress_bar, say, say_aside


def demo(
    out: Annotated[Path, typer.Option("--out", "-o", help="Folder for the page and its files.")] = Path("demo"),
    seed: Annotated[int, typer.Option(help="Seed of the simulated people.", min=0)] = 0,
    as_json: JsonOption = False,
) -> None:
    """Record a simulated person, build the database and its model, fit a photograph, export a rig: all on one page.

    Uses the built-in face, a simulated depth camera and the astronaut portrait that scikit-image ships; needs no
    download, but the extras landmarks, capture and warehouse. Takes about two minutes on two idle cores.

    \b
    Examples:
      facewright demo
      facewright demo --out /tmp/tour --seed 7
    """
    from dataclasses import asdict

    from facewright.apps.demo import run_demo

    with _following(as_json) as progress:
        result = run_demo(out, seed, progress)
    finish(asdict(result), as_json, lambda: say(f"Open {out / 'index.html'} in a browser."))


@contextmanager
def _following(as_json: bool) -> Iterator[Progress | None]:
    """Draw bars on a terminal; elsewhere say each stage once on stderr, so that minutes do not pass in silence."""
    if as_json or sys.stderr.isatty():
        with progress_bar(as_json) as progress:
            yield progress
        return
    said: set[str] = set()

    def report(stage: str, done: int, total: int) -> None:
        if stage not in said:
            said.add(stage)
            say_aside(f"{stage} ...")

    yield report
