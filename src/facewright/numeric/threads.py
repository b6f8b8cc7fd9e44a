"""Threads: compiled kernels on blocks of an index range, and how many others may use."""

from __future__ import annotations

import os
import threading
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor, wait
from contextlib import contextmanager
from functools import lru_cache

from facewright.errors import ValueRangeError

_NAME = "facewright-blocks"


def thread_count() -> int:
    """Return the number of threads to use: NUMBA_NUM_THREADS or OMP_NUM_THREADS where set, else usable cores."""
    for name in ("NUMBA_NUM_THREADS", "OMP_NUM_THREADS"):
        value = os.environ.get(name, "")
        if value.isdigit() and int(value) > 0:
            return int(value)
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def for_blocks(size: int, block: int, work: Callable[[int, int], None]) -> None:
    """Call work(start, stop) for consecutive blocks of [0, size), in threads where there are several blocks.

    Parameters
    ----------
    size : int
        Length of the range.
    block : int
        Largest length of a block.
    work : callable
        Must write only to its own block of the results. Its first error is raised here.

    Raises
    ------
    ValueRangeError
        If `block` is not positive.
    """
    if block < 1:
        raise ValueRangeError(f"block must be positive, got {block}.")
    starts = range(0, size, block)
    workers = min(len(starts), thread_count())
    if workers < 2:
        for start in starts:
            work(start, min(start + block, size))
        return
    if threading.current_thread().name.startswith(_NAME):  # inside a block: waiting for the pool would be for ever
        for start in starts:
            work(start, min(start + block, size))
        return
    pool = _pool(thread_count(), os.getpid())
    blocks = [pool.submit(work, start, min(start + block, size)) for start in starts]
    wait(blocks)
    for finished in blocks:
        finished.result()


@lru_cache(maxsize=1)
def _pool(n_threads: int, process: int) -> ThreadPoolExecutor:
    """Return threads that stay: starting them took longer than small blocks. A forked process gets its own."""
    return ThreadPoolExecutor(n_threads, thread_name_prefix=_NAME)


def thread_environment(n_threads: int) -> dict[str, str]:
    """Return the environment of a process that shall compute with `n_threads` threads: BLAS, OpenMP, numba, ours.

    Libraries read these when they are loaded: the variables must be set before the process starts.

    Raises
    ------
    ValueRangeError
        If `n_threads` is not positive.
    """
    if n_threads < 1:
        raise ValueRangeError(f"n_threads must be positive, got {n_threads}.")
    names = ("OMP_NUM", "OPENBLAS_NUM", "MKL_NUM", "BLIS_NUM", "VECLIB_MAXIMUM", "NUMBA_NUM")
    return {f"{name}_THREADS": str(n_threads) for name in names}


@contextmanager
def one_blas_thread() -> Iterator[None]:
    """Let BLAS compute in one thread while the block runs.

    Sums in another order would change last bits with the number of threads; and thousands of small systems are slower
    on many threads, by several times where the machine is busy.
    """
    from threadpoolctl import threadpool_limits

    with threadpool_limits(limits=1, user_api="blas"):
        yield
