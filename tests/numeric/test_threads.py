import numpy as np
import pytest

from facewright.errors import ValueRangeError
from facewright.numeric.threads import for_blocks, thread_count


@pytest.mark.parametrize("threads", ["1", "3"])
def test_blocks_cover_the_range_once(monkeypatch, threads):
    monkeypatch.setenv("NUMBA_NUM_THREADS", threads)
    assert thread_count() == int(threads)
    seen = np.zeros(23, dtype=int)

    def work(start, stop):
        seen[start:stop] += 1

    for_blocks(23, 5, work)
    assert (seen == 1).all()
    for_blocks(0, 5, work)
    assert (seen == 1).all()


def test_errors_in_a_thread_are_raised(monkeypatch):
    monkeypatch.setenv("NUMBA_NUM_THREADS", "2")

    def work(start, stop):
        raise ZeroDivisionError

    with pytest.raises(ZeroDivisionError):
        for_blocks(10, 2, work)


def test_without_settings_there_is_at_least_one_thread(monkeypatch):
    monkeypatch.delenv("NUMBA_NUM_THREADS", raising=False)
    monkeypatch.setenv("OMP_NUM_THREADS", "many")
    assert thread_count() >= 1


def test_refuses_an_empty_block():
    with pytest.raises(ValueRangeError):
        for_blocks(3, 0, lambda start, stop: None)
