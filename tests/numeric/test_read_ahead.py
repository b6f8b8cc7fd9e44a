"""Generators that run ahead in threads: order, errors, an early end."""

from __future__ import annotations

import threading
import time
from collections.abc import Iterator

import pytest

from facewright.numeric.read_ahead import in_threads, read_ahead


def test_order_and_depth() -> None:
    made = []

    def items() -> Iterator[int]:
        for k in range(30):
            made.append(k)
            yield k

    taken = []
    for item in read_ahead(items(), depth=3):
        assert len(made) - len(taken) <= 3 + 2
        taken.append(item)
    assert taken == list(range(30))


def test_errors_arrive_after_what_was_before() -> None:
    def items() -> Iterator[int]:
        yield 1
        raise KeyError("x")

    taken = []
    with pytest.raises(KeyError):
        for item in read_ahead(items()):
            taken.append(item)
    assert taken == [1]


def test_thread_ends_with_its_taker() -> None:
    def endless() -> Iterator[int]:
        while True:
            yield 0

    ahead = read_ahead(endless(), depth=2)
    next(ahead)
    ahead.close()
    assert not any(thread.name == "facewright-read-ahead" for thread in threading.enumerate())


@pytest.mark.parametrize("workers", [1, 4])
def test_threads_keep_the_order(workers: int) -> None:
    def slow_first(k: int) -> int:
        time.sleep(0.02 if k == 0 else 0)
        return k * k

    assert list(in_threads(slow_first, range(20), workers)) == [k * k for k in range(20)]


@pytest.mark.parametrize("workers", [1, 3])
def test_errors_of_the_work_are_raised(workers: int) -> None:
    def fails(k: int) -> int:
        if k == 5:
            raise KeyError(k)
        return k

    taken = []
    with pytest.raises(KeyError):
        for item in in_threads(fails, range(20), workers):
            taken.append(item)
    assert taken == list(range(5))
