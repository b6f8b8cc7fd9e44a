"""Build a database from captures: each subject is one Dask task, which writes its result as a whole."""

from __future__ import annotations

import time
import traceback
from collections.abc import Callable, Collection, Iterator, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

from facewright.errors import (
    FacewrightError,
    MissingExtraError,
    MissingFaceError,
    StoreError,
    TopologyError,
    ValueRangeError,
)
from facewright.warehouse.dask_cluster import Call, Cluster, Finished
from facewright.warehouse.subject import check_name
from facewright.warehouse.subject_notes import subject_notes

if TYPE_CHECKING:
    from facewright.capture.captures import SubjectCapture
    from facewright.warehouse.store import Warehouse
    from facewright.warehouse.subject import Subject

Progress = Callable[[str, int, int], None]
Process = Callable[..., "Subject"]  # process(capture, options, progress) -> Subject

BUILT, ALREADY, FAILED = "built", "already there", "failed"


@dataclass(frozen=True)
class SubjectOutcome:
    """What became of one subject.

    Parameters
    ----------
    name : str
        The subject.
    status : {"built", "already there", "failed"}
    reason : str
        One sentence where it failed.
    kind : str
        Type of the error where it failed.
    seconds : float
        Time of its work.
    notes : tuple of str
        What was unusual about a subject that was built, see `subject_notes`.
    """

    name: str
    status: str
    reason: str = ""
    kind: str = ""
    seconds: float = 0.0
    notes: tuple[str, ...] = ()


@dataclass(frozen=True)
class BuildStep:
    """Where a build stands after one more subject.

    Parameters
    ----------
    outcome : SubjectOutcome
        The subject that was just finished.
    done, total : int
        Subjects finished, and in all.
    failed : int
        How many of the finished ones failed.
    seconds_left : float
        Expected time until the end, at the pace of this build so far.
    """

    outcome: SubjectOutcome
    done: int
    total: int
    failed: int
    seconds_left: float


@dataclass(frozen=True)
class BuildReport:
    """What a build did.

    Parameters
    ----------
    built, already_there : tuple of str
        Subjects of this run, and those that were in the database before.
    failed : dict of str to SubjectOutcome
        Subjects that failed; the database keeps their reasons.
    seconds : float
        Wall-clock time.
    notes : dict of str to tuple of str
        What was unusual about subjects that were built in this run; those without notes are left out.
    """

    built: tuple[str, ...] = ()
    already_there: tuple[str, ...] = ()
    failed: dict[str, SubjectOutcome] = field(default_factory=dict)
    seconds: float = 0.0
    notes: dict[str, tuple[str, ...]] = field(default_factory=dict)


class _Written(NamedTuple):
    """What a task sends back: how it ended, or what ends the whole build."""

    outcome: SubjectOutcome
    fatal: FacewrightError | None = None


def build_warehouse(
    warehouse: Warehouse,
    captures: Sequence[SubjectCapture],
    options: Any,
    cluster: Cluster,
    *,
    process: Process | None = None,
    retries: int = 2,
    skip: Collection[str] = (),
    progress: Progress | None = None,
    on_step: Callable[[BuildStep], None] | None = None,
) -> BuildReport:
    """Process captures into subjects of a database; what is there already stays as it is.

    A subject that fails is recorded with its reason and stops nobody else. A build that is killed at any moment is
    continued by running it again, and gives the same contents. Several builds may write to one database.

    Parameters
    ----------
    warehouse : Warehouse
        Open for writing; workers open it by its URL.
    captures : sequence of SubjectCapture
        The subjects; those whose `problems` is not empty are recorded as failed.
    options : ProcessOptions
        Handed to `process`.
    cluster : Cluster
        Where the tasks run, see `open_cluster`.
    process : callable(capture, options, progress) -> Subject, optional
        A module-level function; `process_subject` by default.
    retries : int
        Attempts after the first, where a subject fails for what may pass: a file that cannot be read, short memory, a
        process that dies. An error that the input gives rise to would come again and is not retried.
    skip : collection of str
        Subjects to leave alone, such as those that failed before.
    progress : callable(stage, done, total), optional
        Stages within a subject; only where the cluster runs in this process.
    on_step : callable(BuildStep), optional
        Called after each subject.

    Returns
    -------
    BuildReport

    Raises
    ------
    StoreError
        If the database cannot be written (full disk, no permission): nothing is lost, run it again when it can.
    MissingExtraError, MissingFaceError
        If what `process` needs is not installed.
    FacewrightError
        If the cluster is lost.
    """
    if process is None:
        from facewright.warehouse.process_subject import process_subject as process
    start = time.perf_counter()
    wanted = [capture for capture in captures if capture.name not in skip]
    tally = _Tally(warehouse, len(wanted), start, on_step)
    inner = progress if cluster.in_process else None
    calls = _calls(warehouse, wanted, options, process, inner, tally)
    for finished in cluster.run(_build_subject, calls, retries=retries):
        written = _written(finished, retries)
        if written.fatal is not None:
            raise written.fatal
        tally.count(written.outcome)
    return tally.report()


def _calls(
    warehouse: Warehouse, captures: Sequence[SubjectCapture], options: Any, process: Any, progress: Any, tally: _Tally
) -> Iterator[Call]:
    """Yield the tasks; what needs none is counted on the way."""
    for capture in captures:
        problems = _problems(capture)
        if capture.name in warehouse:
            tally.count(SubjectOutcome(capture.name, ALREADY))
        elif problems:
            tally.count(SubjectOutcome(capture.name, FAILED, problems, "CaptureProblem"))
        else:
            yield capture.name, (warehouse, capture, options, process, progress)


def _problems(capture: SubjectCapture) -> str:
    try:
        check_name(capture.name)
    except ValueRangeError as error:
        return str(error)
    return " ".join(capture.problems)


def _build_subject(
    warehouse: Warehouse, capture: SubjectCapture, options: Any, process: Process, progress: Any
) -> _Written:
    """Process one subject and write it; the task. Raises what another attempt may mend."""
    start = time.perf_counter()

    def ended(status: str, error: Exception | None = None) -> SubjectOutcome:
        reason, kind = ("", "") if error is None else (str(error), type(error).__name__)
        return SubjectOutcome(capture.name, status, reason, kind, time.perf_counter() - start)

    if capture.name in warehouse:  # by another build, or by an attempt whose worker died after its commit
        return _Written(ended(ALREADY))
    try:
        subject = process(capture, options, progress)
    except (MissingExtraError, MissingFaceError) as error:  # every subject would fail alike
        return _Written(ended(FAILED, error), error)
    except StoreError:  # a recording that could not be read, perhaps for the moment
        raise
    except FacewrightError as error:
        return _Written(ended(FAILED, error))
    try:
        warehouse.write_subject(subject)
    except StoreError as error:
        return _Written(ended(ALREADY)) if capture.name in warehouse else _Written(ended(FAILED, error), error)
    except TopologyError as error:
        return _Written(ended(FAILED, error), error)
    except FacewrightError as error:
        return _Written(ended(FAILED, error))
    return _Written(replace(ended(BUILT), notes=subject_notes(subject.provenance)))


def _written(finished: Finished, retries: int) -> _Written:
    """Turn how a task ended into what became of its subject."""
    name, error = finished.label, finished.error
    if error is None:
        return finished.value
    attempts = f"{retries + 1} times" if retries else "once"
    if finished.worker_died:
        reason = f"The worker process died while it built this subject ({attempts}): short of memory, or a crash."
        return _Written(SubjectOutcome(name, FAILED, reason, "WorkerDied"))
    kind = type(error).__name__
    if isinstance(error, FacewrightError):
        reason = str(error)
    elif isinstance(error, MemoryError):
        reason = f"There was not enough memory (tried {attempts})."
    elif isinstance(error, OSError):
        where = f"{error.filename}: " if error.filename else ""
        reason = f"{where}{error.strerror or error} (tried {attempts})."
    else:
        place = traceback.extract_tb(error.__traceback__)[-1:]
        where = f" at {Path(place[0].filename).name}:{place[0].lineno}" if place else ""
        reason = f"This is a mistake in facewright ({kind}{where}: {error})."
    return _Written(SubjectOutcome(name, FAILED, " ".join(reason.split()), kind))


class _Tally:
    """Counts subjects, records failures, and tells how long the rest will take."""

    def __init__(
        self, warehouse: Warehouse, total: int, start: float, on_step: Callable[[BuildStep], None] | None
    ) -> None:
        self.warehouse, self.total, self.start, self.on_step = warehouse, total, start, on_step
        self.outcomes: list[SubjectOutcome] = []
        self.worked = 0

    def count(self, outcome: SubjectOutcome) -> None:
        if outcome.status == FAILED and outcome.name in self.warehouse:  # another build had more luck
            outcome = replace(outcome, status=ALREADY, reason="", kind="")
        if outcome.status == FAILED:
            self.warehouse.record_failure(outcome.name, outcome.reason, outcome.kind)
        self.outcomes.append(outcome)
        self.worked += outcome.status != ALREADY
        if self.on_step is None:
            return
        done = len(self.outcomes)
        pace = (time.perf_counter() - self.start) / max(self.worked, 1)
        failed = sum(item.status == FAILED for item in self.outcomes)
        self.on_step(BuildStep(outcome, done, self.total, failed, pace * (self.total - done)))

    def report(self) -> BuildReport:
        def names(status: str) -> tuple[str, ...]:
            return tuple(sorted(item.name for item in self.outcomes if item.status == status))

        failures = {item.name: item for item in self.outcomes if item.status == FAILED}
        seconds = time.perf_counter() - self.start
        notes = {item.name: item.notes for item in self.outcomes if item.status == BUILT and item.notes}
        return BuildReport(
            names(BUILT), names(ALREADY), dict(sorted(failures.items())), seconds, dict(sorted(notes.items()))
        )
