"""Where jobs run as Dask tasks: in this process, on workers of this machine, or on a cluster that exists already."""

from __future__ import annotations

import logging
import os
import secrets
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager, suppress
from functools import partial
from typing import Any, NamedTuple, Protocol

from facewright.errors import FacewrightError, MissingExtraError, ValueRangeError
from facewright.numeric.threads import thread_count, thread_environment

Call = tuple[str, tuple[Any, ...]]  # a label, which is unique among the calls, and the arguments

_CONNECT_SECONDS = 20.0
_POLL_SECONDS = 2.0  # how often to look for workers that joined


class Finished(NamedTuple):
    """How one call ended.

    Attributes
    ----------
    label : str
        The call's label.
    value : object
        What it returned; None after an error.
    error : Exception or None
        What it raised in its last attempt.
    worker_died : bool
        Whether the process that ran it died in each attempt.
    """

    label: str
    value: Any = None
    error: Exception | None = None
    worker_died: bool = False


class Cluster(Protocol):
    """Runs calls as Dask tasks."""

    @property
    def in_process(self) -> bool:
        """Whether calls run in this process, one after the other."""

    @property
    def dashboard(self) -> str:
        """Where to watch the tasks, or how to get there, in one sentence; empty where there is nothing to watch."""

    def run(self, function: Callable[..., Any], calls: Iterable[Call], *, retries: int = 0) -> Iterator[Finished]:
        """Yield the results of `function` as they finish; whatever it raises is handed back, not raised.

        Parameters
        ----------
        function : callable
            Module-level function. An Exception is tried again `retries` times; so is the death of the process.
        calls : iterable of (label, arguments)
            Taken as places become free, so that it may be long.
        retries : int
            Attempts after the first. On an existing cluster its scheduler says how many workers may die on a task.
        """


@contextmanager
def open_cluster(workers: int = 0, scheduler: str | None = None, *, retries: int = 2) -> Iterator[Cluster]:
    """Yield where jobs run; workers that were started end with the context, an existing cluster goes on.

    Parameters
    ----------
    workers : int
        Worker processes to start on this machine; 0 runs everything in this process.
    scheduler : str, optional
        Address of an existing scheduler, such as ``tcp://host:8786``. Its workers need the same facewright and must
        reach the same files.
    retries : int
        How often a task may be tried again on another worker after its worker died; for `workers`.

    Raises
    ------
    ValueRangeError
        If both or a negative number are given.
    MissingExtraError
        If dask or distributed is not installed.
    FacewrightError
        If the scheduler does not answer, or its workers have another version of facewright.

    Notes
    -----
    The workers of this machine share its cores: with N workers each computes with cores / N threads, at least one.
    """
    if workers < 0 or (workers and scheduler):
        what = f"{workers}" if workers < 0 else f"{workers} beside the scheduler {scheduler}"
        raise ValueRangeError(f"workers must be 0 or more, and 0 where a scheduler is given, got {what}.")
    if retries < 0:
        raise ValueRangeError(f"retries must be 0 or more, got {retries}.")
    if scheduler is not None:
        with _existing_cluster(scheduler) as existing:
            yield existing
    elif workers:
        with _local_cluster(workers, retries) as local:
            yield local
    else:
        _import_dask("dask")
        yield _InProcess()


def _import_dask(name: str) -> Any:
    import importlib

    try:
        return importlib.import_module(name)
    except ImportError as error:
        raise MissingExtraError(f'{name} must be installed for this: pip install "facewright[warehouse]".') from error


class _InProcess:
    """One call after the other, on Dask's scheduler without threads: what interrupts this process stops the work."""

    in_process = True
    dashboard = ""

    def run(self, function: Callable[..., Any], calls: Iterable[Call], *, retries: int = 0) -> Iterator[Finished]:
        for label, arguments in calls:
            yield self._attempt(label, partial(function, *arguments), retries)

    def _attempt(self, label: str, call: Callable[[], Any], retries: int) -> Finished:
        import dask

        task = dask.delayed(call, name=f"call-{label}", pure=False)(dask_key_name=label)
        for left in range(retries, -1, -1):
            try:
                return Finished(label, task.compute(scheduler="synchronous"))
            except Exception as error:
                if not left:
                    return Finished(label, error=error)
        raise AssertionError("unreachable")


class _Distributed:
    """Calls as tasks of a Dask client; no more at a time than there are threads, so that none waits on a worker.

    A task that waits on a worker which dies would be suspected of the death, and nobody could take it meanwhile.
    """

    in_process = False

    def __init__(self, client: Any, address: str) -> None:
        self.client, self.address = client, address

    @property
    def dashboard(self) -> str:
        from distributed.utils import TimeoutError as DaskTimeoutError

        with suppress(OSError, DaskTimeoutError, ValueError):
            if self.client.run_on_scheduler(_has_bokeh):
                return f"dashboard: {self.client.dashboard_link}"
            return 'dashboard: pip install "facewright[warehouse]" where the scheduler runs, and it shows here'
        return ""

    def run(self, function: Callable[..., Any], calls: Iterable[Call], *, retries: int = 0) -> Iterator[Finished]:
        name = f"{function.__name__.strip('_')}-{secrets.token_hex(8)}"  # two builds share no keys
        waiting = iter(calls)
        running: dict[Any, str] = {}
        try:
            while True:
                self._submit(function, waiting, running, name, retries)
                if not running:
                    return
                for future in self._finished(running):
                    yield self._result(future, running.pop(future))
        finally:  # the caller stops early, or is interrupted
            if running:
                with suppress(Exception):
                    self.client.cancel(list(running), force=True)

    def _submit(
        self, function: Callable[..., Any], waiting: Iterator[Call], running: dict[Any, str], name: str, retries: int
    ) -> None:
        with self._reaching():
            places = max(1, sum(self.client.nthreads().values()))
        while len(running) < places and (call := next(waiting, None)) is not None:
            label, arguments = call
            with self._reaching():
                future = self.client.submit(function, *arguments, key=(name, label), retries=retries, pure=False)
            running[future] = label

    def _finished(self, running: dict[Any, str]) -> list[Any]:
        from distributed import wait
        from distributed.utils import TimeoutError as DaskTimeoutError

        with self._reaching():
            try:
                return list(wait(list(running), timeout=_POLL_SECONDS, return_when="FIRST_COMPLETED").done)
            except DaskTimeoutError:
                if self.client.status != "running":
                    raise
                return []

    def _result(self, future: Any, label: str) -> Finished:
        from distributed.scheduler import KilledWorker

        if future.status == "finished":
            with self._reaching():
                return Finished(label, future.result())
        with self._reaching():
            error = future.exception()
        return Finished(label, error=error, worker_died=isinstance(error, KilledWorker))

    @contextmanager
    def _reaching(self) -> Iterator[None]:
        """Say in one sentence that the scheduler went away, however Dask puts it."""
        from concurrent.futures import CancelledError

        try:
            yield
        except (OSError, CancelledError, RuntimeError) as error:  # TimeoutError is an OSError
            raise FacewrightError(
                f"scheduler {self.address} must stay reachable while jobs run, got no answer; what is done is kept, "
                "run again to go on."
            ) from error


@contextmanager
def _local_cluster(workers: int, retries: int) -> Iterator[Cluster]:
    distributed = _import_dask("distributed")
    import dask

    _quiet()
    environment = thread_environment(max(1, thread_count() // workers)) | _worker_logging()
    before = dict(os.environ)
    settings = {
        # Set before a worker starts, also one that takes the place of a dead one: BLAS reads them when it is loaded.
        "distributed.nanny.pre-spawn-environ": environment,
        "distributed.scheduler.allowed-failures": retries,
    }
    try:
        try:
            with dask.config.set(settings):
                cluster = distributed.LocalCluster(
                    n_workers=workers,
                    threads_per_worker=1,
                    dashboard_address=":0",
                    silence_logs=logging.CRITICAL,
                    preload=["facewright.warehouse.dask_worker"],
                )
        except RuntimeError as error:
            raise FacewrightError(
                "worker processes must be able to start, got none; a script that starts them must do its work under "
                "`if __name__ == '__main__':`, since each worker imports it."
            ) from error
        with cluster, distributed.Client(cluster) as client:
            yield _Distributed(client, cluster.scheduler_address)
    finally:  # Dask sets the workers' environment in this process too
        for name in environment:
            if name in before:
                os.environ[name] = before[name]
            else:
                os.environ.pop(name, None)


@contextmanager
def _existing_cluster(address: str) -> Iterator[Cluster]:
    distributed = _import_dask("distributed")
    _quiet()
    try:
        client = distributed.Client(address, timeout=_CONNECT_SECONDS, set_as_default=False)
    except (OSError, ValueError, TimeoutError) as error:
        raise FacewrightError(
            f"scheduler must be the address of a running Dask scheduler, such as tcp://host:8786, got {address} "
            f"({type(error).__name__})."
        ) from error
    with client:
        _check_versions(client, address)
        yield _Distributed(client, address)


def _check_versions(client: Any, address: str) -> None:
    """Refuse workers that would compute something else."""
    from facewright import __version__

    try:
        versions = set(client.run(_version).values())
    except Exception as error:
        raise FacewrightError(
            f'workers of {address} must have facewright {__version__} (pip install "facewright[capture,warehouse]"), '
            f"got {type(error).__name__}: {error}."
        ) from error
    if versions - {__version__}:
        found = ", ".join(sorted(versions))
        raise FacewrightError(f"workers of {address} must have facewright {__version__}, as here, got {found}.")


def _version() -> str:
    from facewright import __version__

    return __version__


def _has_bokeh() -> bool:
    import importlib.util

    return importlib.util.find_spec("bokeh") is not None


def _quiet() -> None:
    """Leave it to us what is told: Dask would print a traceback for each subject that fails."""
    if not os.environ.get("FACEWRIGHT_DEBUG"):
        for name in (
            "distributed",
            "distributed.client",
            "distributed.nanny",
            "distributed.scheduler",
            "distributed.core",
            "bokeh",
        ):
            logging.getLogger(name).setLevel(logging.CRITICAL)


def _worker_logging() -> dict[str, str]:
    return {} if os.environ.get("FACEWRIGHT_DEBUG") else {"DASK_LOGGING__DISTRIBUTED": "critical"}
