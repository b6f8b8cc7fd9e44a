"""facewright evaluate: measure one suite and compare with its targets."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Annotated, Any

import typer

from facewright.cli.console import finish, plain, progress_bar, say, table


def evaluate(
    suite: Annotated[
        str,
        typer.Argument(
            help="Suite: transfer, rigging, bilinear, photo, fusion, scan, registration, subject, scale, edit, "
            "component, retarget or regions."
        ),
    ],
    faces: Annotated[str, typer.Option("--faces", help="Face: builtin, ict, or the path of a .npz file.")] = "builtin",
    seed: Annotated[int, typer.Option(help="Seed of the simulated people and noise.", min=0)] = 0,
    file: Annotated[
        Path | None, typer.Option("--json", metavar="FILE", help="File to write the numbers to; - for stdout.")
    ] = None,
    subjects: Annotated[
        int | None, typer.Option(help="People to measure on; the suite's own number if absent.", min=1)
    ] = None,
) -> None:
    """Measure a suite on simulated people; shows a table, writes the numbers to a file.

    \b
    Examples:
      facewright evaluate transfer
      facewright evaluate bilinear --faces ict --seed 1 --json bilinear.json
    """
    from facewright.apps.describe import describe_machine
    from facewright.evaluation.suites import compare, has_targets, run_suite

    to_stdout = file is not None and str(file) == "-"
    with progress_bar(to_stdout) as progress:
        metrics = run_suite(suite, faces, seed, subjects=subjects, progress=progress)
    payload: dict[str, Any] = {
        "suite": suite,
        "faces": faces,
        "seed": seed,
        "metrics": metrics,
        "machine": describe_machine(),
    }
    if file is not None and not to_stdout:
        from facewright.io.atomic import write_atomically

        with write_atomically(file) as temporary:
            temporary.write_text(json.dumps(plain(payload), indent=2, allow_nan=False) + "\n", encoding="utf-8")

    def show() -> None:
        targets = has_targets(suite, faces, subjects)
        compared = compare(suite, metrics, targets=targets)
        rows = [[name, f"{value:.4g}", target, met] for name, value, target, met in compared]
        table(f"{suite}, face {faces}, seed {seed}", ["metric", "value", "target (ict)", "met"], rows)
        if not targets:
            say("Targets are for the face ict and the suite's own number of people.")
        if file is not None:
            say(f"Wrote {file}.")

    finish(payload, to_stdout, show)
