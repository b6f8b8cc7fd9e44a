"""facewright build: captures become a face database."""

from __future__ import annotations

import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from facewright.cli.console import EXIT_INCOMPLETE, JsonOption, Progress, finish, say, say_aside, table

if TYPE_CHECKING:
    from facewright.apps.build import BuildResult
    from facewright.warehouse.build import BuildStep


def build(
    captures: Annotated[Path, typer.Argument(help="Folder of captures: <subject>/<expression>/.")],
    out: Annotated[
        str, typer.Option("--out", "-o", help="Database, a folder or any fsspec URL; continued where it is there.")
    ] = "faces.zarr",
    faces: Annotated[str, typer.Option("--faces", help="Face: builtin, ict, or the path of a .npz file.")] = "builtin",
    workers: Annotated[
        int, typer.Option(help="Worker processes on this machine; 0: one subject after the other in this one.", min=0)
    ] = 0,
    scheduler: Annotated[
        str | None, typer.Option(help="Address of an existing Dask scheduler, such as tcp://host:8786.")
    ] = None,
    retries: Annotated[
        int, typer.Option(help="Further attempts where a file could not be read or a worker died.", min=0)
    ] = 2,
    only: Annotated[list[str] | None, typer.Option(help="Build this subject only; may be repeated.")] = None,
    skip_failed: Annotated[
        bool, typer.Option("--skip-failed", help="Leave out subjects that failed before; they are tried again if not.")
    ] = False,
    records: Annotated[
        bool, typer.Option("--records/--no-records", help="Keep fused depth and pictures in the database.")
    ] = True,
    least_expressions: Annotated[
        int, typer.Option(help="Usable expressions beside the neutral that a subject must have.", min=1, max=19)
    ] = 10,
    raw: Annotated[bool, typer.Option("--raw/--no-raw", help="Also keep the depth as the camera gave it.")] = False,
    fusion: Annotated[str, typer.Option(help="Engine of the fusion: numba, or open3d (extra capture).")] = "numba",
    task_file: Annotated[
        Path | None, typer.Option(help="MediaPipe face_landmarker.task file, for newer MediaPipe releases.")
    ] = None,
    as_json: JsonOption = False,
) -> None:
    """Build a database from RGB-D captures: fused depth, landmarks, meshes and 46 personal blendshapes per subject.

    Run it again to go on after an interruption: what is there stays. Subjects that fail are listed with their reason
    and kept by the database, see `facewright warehouse ls`; the others are built, and the exit code is then 3. What was
    unusual about a subject that was built (expressions left out, depth in metres, one frame only) is told after it and
    stays readable by `facewright warehouse show`.

    \b
    Examples:
      facewright build captures -o faces.zarr
      facewright build captures -o faces.zarr --faces ict --workers 8
      facewright build /data/captures -o s3://bucket/faces.zarr --scheduler tcp://head:8786
    """
    from facewright.apps.build import BuildRequest
    from facewright.apps.build import build as build_database
    from facewright.warehouse.process_subject import ProcessOptions

    options = ProcessOptions(
        face=faces,
        least_expressions=least_expressions,
        keep_records=records,
        keep_raw=raw,
        task_file="" if task_file is None else str(task_file.absolute()),
        fusion=fusion,
    )
    request = BuildRequest(
        captures=captures,
        out=out,
        options=options,
        workers=workers,
        scheduler=scheduler,
        retries=retries,
        only=tuple(only or ()),
        skip_failed=skip_failed,
    )
    with _following(as_json) as (progress, on_step, tell):
        result = build_database(request, progress, on_step=on_step, on_dashboard=tell, on_warning=tell)
    finish(_payload(result), as_json, lambda: _show(result))
    if result.report.failed:
        raise typer.Exit(EXIT_INCOMPLETE)


def _payload(result: BuildResult) -> dict[str, Any]:
    report = result.report
    return {
        "path": result.url,
        "built": report.built,
        "already_there": report.already_there,
        "failed": {name: {"kind": item.kind, "reason": item.reason} for name, item in report.failed.items()},
        "seconds": round(report.seconds, 3),
        "warnings": result.warnings,
        "notes": report.notes,
    }


def _show(result: BuildResult) -> None:
    report = result.report
    if report.failed:
        rows = [[name, item.reason] for name, item in report.failed.items()]
        table("Failed", ["subject", "reason"], rows)
    noted = f" ({len(report.notes)} with notes)" if report.notes else ""
    say(
        f"{result.url}: {len(report.built)} built{noted}, {len(report.already_there)} already there, "
        f"{len(report.failed)} failed; {duration(report.seconds)}."
    )


def duration(seconds: float) -> str:
    """Return a time that people read at a glance.

    Examples
    --------
    >>> duration(8.2), duration(200), duration(7500)
    ('8 s', '3 min', '2 h 05 min')
    """
    if seconds < 100:
        return f"{seconds:.0f} s"
    minutes = round(seconds / 60)
    return f"{minutes} min" if minutes < 100 else f"{minutes // 60} h {minutes % 60:02d} min"


_Following = tuple[Progress | None, Callable[["BuildStep"], None] | None, Callable[[str], None]]


@contextmanager
def _following(as_json: bool) -> Iterator[_Following]:
    """Tell on stderr how the build goes: bars on a terminal, a line a subject elsewhere, only errors with --json."""
    if as_json:
        yield None, None, lambda text: None
    elif not sys.stderr.isatty():
        yield _at_times(), _say_step, say_aside
    else:
        with _bars() as following:
            yield following


def _at_times(seconds: float = 30.0) -> Progress:
    """Say now and then where the subject at work is: one takes minutes."""
    last = time.monotonic()

    def report(stage: str, done: int, total: int) -> None:
        nonlocal last
        if time.monotonic() - last >= seconds:
            last = time.monotonic()
            say_aside(f"  {stage}, {done} of {total}")

    return report


def _say_step(step: BuildStep) -> None:
    say_aside(_step_text(step))
    for note in step.outcome.notes:
        say_aside(f"  {step.outcome.name}: {note}")


def _step_text(step: BuildStep) -> str:
    outcome = step.outcome
    seconds = f" in {duration(outcome.seconds)}" if outcome.seconds else ""
    reason = f": {outcome.reason}" if outcome.reason else ""
    left = f"; {duration(step.seconds_left)} left" if step.done < step.total else ""
    return f"{step.done} of {step.total}: {outcome.name} {outcome.status}{seconds}{reason}{left}"


@contextmanager
def _bars() -> Iterator[_Following]:
    """Draw one bar for all subjects, with the time left at the pace so far, and one for the subject at work."""
    from rich.console import Console
    from rich.progress import BarColumn, MofNCompleteColumn, TextColumn
    from rich.progress import Progress as Bars

    columns = (
        TextColumn("{task.description:<28}"),
        BarColumn(),
        MofNCompleteColumn(),
        TextColumn("{task.fields[left]}"),
    )
    with Bars(*columns, console=Console(stderr=True)) as bars:
        whole = bars.add_task("subjects", total=None, left="")
        inner = bars.add_task("", total=1, left="", visible=False)

        def tell(text: str) -> None:
            bars.console.print(text, markup=False, highlight=False, soft_wrap=True)

        def progress(stage: str, done: int, total: int) -> None:
            bars.update(inner, description=stage, completed=done, total=total, visible=True)

        def on_step(step: BuildStep) -> None:
            failed = f", {step.failed} failed" if step.failed else ""
            left = f"{duration(step.seconds_left)} left{failed}"
            bars.update(whole, completed=step.done, total=step.total, left=left)
            bars.update(inner, visible=False)
            for sentence in (step.outcome.reason, *step.outcome.notes):
                if sentence:
                    tell(f"{step.outcome.name}: {sentence}")

        yield progress, on_step, tell
