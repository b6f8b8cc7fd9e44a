"""Let a generator run ahead in a thread of its own: its work overlaps with that of whoever takes what it gives."""

from __future__ import annotations

import queue
import threading
from collections.abc import Callable, Generator, Iterable
from concurrent.futures import Future, ThreadPoolExecutor
from typing import Any, TypeVar

T = TypeVar("T")
R = TypeVar("R")


def read_ahead(items: Iterable[T], depth: int = 8) -> Generator[T, None, None]:
    """Give the items of an iterable that runs in another thread, at most `depth` items ahead.

    Errors of the iterable are raised here. The thread ends when the taker closes the generator: a taker that may stop
    early uses ``contextlib.closing``, so that what the iterable reads from is not closed under it.
    """
    waiting: queue.Queue[tuple[str, Any]] = queue.Queue(maxsize=depth)
    stop = threading.Event()

    def put(entry: tuple[str, Any]) -> bool:
        while not stop.is_set():
            try:
                waiting.put(entry, timeout=0.1)
                return True
            except queue.Full:
                continue
        return False

    def work() -> None:
        try:
            for item in items:
                if not put(("item", item)):
                    return
            put(("end", None))
        except BaseException as error:
            put(("error", error))

    thread = threading.Thread(target=work, name="facewright-read-ahead", daemon=True)
    thread.start()
    try:
        while True:
            kind, value = waiting.get()
            if kind == "end":
                return
            if kind == "error":
                raise value
            yield value
    finally:
        stop.set()
        thread.join()


def in_threads(work: Callable[[T], R], items: Iterable[T], workers: int, depth: int = 4) -> Generator[R, None, None]:
    """Give ``work(item)`` in the items' order, computed by several threads, at most `depth` items ahead."""
    if workers < 2:
        yield from map(work, items)
        return
    with ThreadPoolExecutor(workers, thread_name_prefix="facewright-work") as pool:
        running: list[Future[R]] = []
        try:
            for item in items:
                running.append(pool.submit(work, item))
                if len(running) > depth:
                    yield running.pop(0).result()
            while running:
                yield running.pop(0).result()
        finally:
            for future in running:
                future.cancel()
