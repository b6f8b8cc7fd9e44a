"""Build a face database from a folder of captures."""

from __future__ import annotations

import os
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from facewright.errors import StoreError, ValueRangeError

if TYPE_CHECKING:
    from facewright.capture.captures import SubjectCapture
    from facewright.warehouse.build import BuildReport, BuildStep, SubjectOutcome

Progress = Callable[[str, int, int], None]

#: Up to so many subjects or sentences are told, up to so many expressions named.
_MOST_TOLD, _MOST_NAMED = 5, 6


@dataclass(frozen=True)
class BuildRequest:
    """What to build, from what, and where the work runs.

    Parameters
    ----------
    captures : Path
        Folder of captures: ``<subject>/<expression>/``.
    out : str
        The database: a folder or an fsspec URL. Made if it is not there; continued if it is.
    options : ProcessOptions
        How each subject is processed.
    workers : int
        Worker processes on this machine; 0 runs one subject after the other in this process.
    scheduler : str, optional
        Address of an existing Dask scheduler instead.
    retries : int
        Attempts after the first where what went wrong may pass.
    only : tuple of str
        Subjects to build; all where empty.
    skip_failed : bool
        Leave out subjects that failed in an earlier build.
    process : callable, optional
        What makes a subject of a capture; `process_subject` by default.
    """

    captures: Path
    out: str
    options: Any
    workers: int = 0
    scheduler: str | None = None
    retries: int = 2
    only: tuple[str, ...] = ()
    skip_failed: bool = False
    process: Callable[..., Any] | None = None

    def __post_init__(self) -> None:
        if self.retries < 0:
            raise ValueRangeError(f"retries must be 0 or more, got {self.retries}.")
        if (self.workers or self.scheduler) and self.out.startswith("memory:"):
            raise ValueRangeError(
                f"out must be a place that other processes reach, got {self.out}, which only this process sees."
            )


@dataclass(frozen=True)
class BuildResult:
    """What a build did.

    Parameters
    ----------
    url : str
        The database.
    report : BuildReport
        Subjects built, there before, and failed, and what was unusual about those built.
    warnings : tuple of str
        What was unusual about captures before any recording was opened, see `capture_warnings`.
    """

    url: str
    report: BuildReport
    warnings: tuple[str, ...] = field(default=())


def build(
    request: BuildRequest,
    progress: Progress | None = None,
    *,
    on_step: Callable[[BuildStep], None] | None = None,
    on_dashboard: Callable[[str], None] | None = None,
    on_warning: Callable[[str], None] | None = None,
) -> BuildResult:
    """Build or continue a database; see `build_warehouse`. Paths are told as the request gives them.

    Parameters
    ----------
    request : BuildRequest
        Captures, database, options and where the work runs.
    progress : callable, optional
        Stages within a subject, called with stage, done, total, where the work runs in this process.
    on_step : callable(BuildStep), optional
        Called after each subject.
    on_dashboard : callable(str), optional
        Called once with where to watch the workers.
    on_warning : callable(str), optional
        Called before the work with each of the result's warnings.

    Returns
    -------
    BuildResult

    Raises
    ------
    StoreError
        If the captures cannot be read or the database cannot be written.
    FileFormatError
        If there are no captures in the folder, or the database is none.
    TopologyError
        If the database holds another face.
    MissingExtraError, MissingFaceError
        If a package or the face is not installed.
    ValueRangeError
        If `only` names a subject that was not captured.
    """
    from facewright.capture.captures import list_captures
    from facewright.faces import load_face
    from facewright.warehouse.build import build_warehouse
    from facewright.warehouse.dask_cluster import open_cluster
    from facewright.warehouse.store import Warehouse

    captures = _wanted(list_captures(request.captures.resolve()), request)
    if Path(request.out).is_file():
        raise StoreError(f"{request.out} must be a database or a place for a new one, got a file.")
    warehouse = Warehouse.create(request.out, load_face(request.options.face), exist_ok=True)
    skip = set(warehouse.failures()) if request.skip_failed else set()
    there = skip.union(warehouse.subject_names())
    as_given = _AsGiven(request.captures)
    warnings = as_given.texts(capture_warnings([capture for capture in captures if capture.name not in there]))

    def tell_step(step: BuildStep) -> None:
        if on_step is not None:
            on_step(replace(step, outcome=as_given.outcome(step.outcome)))

    with open_cluster(request.workers, request.scheduler, retries=request.retries) as cluster:
        if on_dashboard is not None and cluster.dashboard:
            on_dashboard(cluster.dashboard)
        if on_warning is not None:
            for sentence in warnings:
                on_warning(sentence)
        report = build_warehouse(
            warehouse,
            captures,
            request.options,
            cluster,
            process=request.process,
            retries=request.retries,
            skip=skip,
            progress=progress,
            on_step=tell_step,
        )
    return BuildResult(warehouse.url, as_given.report(report), warnings)


def capture_warnings(captures: Sequence[SubjectCapture]) -> tuple[str, ...]:
    """Return what was unusual about captures that can be used: few lines, however many captures there are.

    Parameters
    ----------
    captures : sequence of SubjectCapture
        Those with problems are left out: they fail with their reasons.

    Returns
    -------
    tuple of str
        One sentence about all missing expressions, then others; more than a few of those are counted only.
    """
    from facewright.faces.expressions import EXPRESSION_NAMES

    usable = [capture for capture in captures if not capture.problems]
    lacking = {c.name: [name for name in EXPRESSION_NAMES if name not in c.recordings] for c in usable}
    lacking = {name: missing for name, missing in lacking.items() if missing}
    others = [s for c in usable for s in c.warnings if not s.startswith(f"{c.path} lacks ")]
    if len(others) > _MOST_TOLD:
        others[_MOST_TOLD:] = [f"{len(others) - _MOST_TOLD} more such entries of the captures are ignored."]
    return (*([_lacking_sentence(lacking, len(usable))] if lacking else []), *others)


def _lacking_sentence(lacking: dict[str, list[str]], n_subjects: int) -> str:
    from facewright.faces.expressions import EXPRESSION_NAMES

    counts = sorted(len(missing) for missing in lacking.values())
    number = f"{counts[0]}" if counts[0] == counts[-1] else f"{counts[0]} to {counts[-1]}"
    names = list(lacking)
    who = ", ".join(names[:_MOST_TOLD]) + (f" and {len(names) - _MOST_TOLD} more" if len(names) > _MOST_TOLD else "")
    verb = "lacks" if len(names) == 1 else "lack"
    missing = next(iter(lacking.values()))
    same = all(other == missing for other in lacking.values()) and len(missing) <= _MOST_NAMED
    which = f": {', '.join(missing)}" if same else ""
    share = f" ({len(names)} of {n_subjects} subjects)" if len(names) > 1 else ""
    return f"{who}{share} {verb} {number} of {len(EXPRESSION_NAMES)} expressions{which}."


class _AsGiven:
    """Names the folder of captures as the user did; workers know it by its absolute path."""

    def __init__(self, captures: Path) -> None:
        self.root, self.given = captures.resolve(), captures

    def text(self, sentence: str) -> str:
        return sentence.replace(f"{self.root}{os.sep}", f"{self.given}{os.sep}")

    def texts(self, sentences: Sequence[str]) -> tuple[str, ...]:
        return tuple(self.text(sentence) for sentence in sentences)

    def outcome(self, outcome: SubjectOutcome) -> SubjectOutcome:
        return replace(outcome, reason=self.text(outcome.reason), notes=self.texts(outcome.notes))

    def report(self, report: BuildReport) -> BuildReport:
        failed = {name: self.outcome(outcome) for name, outcome in report.failed.items()}
        notes = {name: self.texts(found) for name, found in report.notes.items()}
        return replace(report, failed=failed, notes=notes)


def _wanted(captures: list[SubjectCapture], request: BuildRequest) -> list[SubjectCapture]:
    if not request.only:
        return captures
    unknown = sorted(set(request.only) - {capture.name for capture in captures})
    if unknown:
        raise ValueRangeError(f"only must name subjects of {request.captures}, got {', '.join(unknown)}.")
    return [capture for capture in captures if capture.name in request.only]
