"""Build a face database from a folder of captures."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

from facewright.errors import ValueRangeError

if TYPE_CHECKING:
    from facewright.capture.captures import SubjectCapture
    from facewright.warehouse.build import BuildReport, BuildStep

Progress = Callable[[str, int, int], None]


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
        Subjects built, there before, and failed.
    warnings : tuple of str
        What was unusual about captures that could be used.
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
) -> BuildResult:
    """Build or continue a database; see `build_warehouse`.

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
    warehouse = Warehouse.create(request.out, load_face(request.options.face), exist_ok=True)
    skip = set(warehouse.failures()) if request.skip_failed else set()
    with open_cluster(request.workers, request.scheduler, retries=request.retries) as cluster:
        if on_dashboard is not None and cluster.dashboard:
            on_dashboard(cluster.dashboard)
        report = build_warehouse(
            warehouse,
            captures,
            request.options,
            cluster,
            process=request.process,
            retries=request.retries,
            skip=skip,
            progress=progress,
            on_step=on_step,
        )
    warnings = tuple(sentence for capture in captures if capture.name not in skip for sentence in capture.warnings)
    return BuildResult(warehouse.url, report, warnings)


def _wanted(captures: list[SubjectCapture], request: BuildRequest) -> list[SubjectCapture]:
    if not request.only:
        return captures
    unknown = sorted(set(request.only) - {capture.name for capture in captures})
    if unknown:
        raise ValueRangeError(f"only must name subjects of {request.captures}, got {', '.join(unknown)}.")
    return [capture for capture in captures if capture.name in request.only]
