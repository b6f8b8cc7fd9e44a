import os

import numpy as np
import pytest

from facewright.errors import ValueRangeError
from facewright.numeric.threads import for_blocks, one_blas_thread, thread_count, thread_environment


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


def test_blocks_within_blocks_do_not_wait_for_each_other(monkeypatch):
    monkeypatch.setenv("NUMBA_NUM_THREADS", "2")
    seen = np.zeros((8, 8), dtype=int)

    def work(start, stop):
        def inner(first, last):
            seen[start:stop, first:last] += 1

        for_blocks(8, 2, inner)

    for_blocks(8, 1, work)
    assert (seen == 1).all()


@pytest.mark.skipif(not hasattr(os, "fork"), reason="needs fork")
def test_a_forked_process_has_threads_of_its_own(monkeypatch):
    monkeypatch.setenv("NUMBA_NUM_THREADS", "2")
    for_blocks(4, 1, lambda start, stop: None)  # the parent's threads exist
    child = os.fork()
    if child == 0:
        for_blocks(4, 1, lambda start, stop: None)
        os._exit(0)
    assert os.waitpid(child, 0)[1] == 0


def test_without_settings_there_is_at_least_one_thread(monkeypatch):
    monkeypatch.delenv("NUMBA_NUM_THREADS", raising=False)
    monkeypatch.setenv("OMP_NUM_THREADS", "many")
    assert thread_count() >= 1


def test_refuses_an_empty_block():
    with pytest.raises(ValueRangeError):
        for_blocks(3, 0, lambda start, stop: None)


def test_the_environment_of_a_process_names_every_pool(monkeypatch):
    import subprocess
    import sys

    environment = thread_environment(3)
    assert set(environment.values()) == {"3"} and {"OMP_NUM_THREADS", "NUMBA_NUM_THREADS"} <= set(environment)
    program = "from facewright.numeric.threads import thread_count; print(thread_count())"
    found = subprocess.run([sys.executable, "-c", program], env={**os.environ, **environment}, capture_output=True)
    assert found.stdout.strip() == b"3"
    with pytest.raises(ValueRangeError, match="n_threads must be positive"):
        thread_environment(0)


def test_blas_computes_in_one_thread_within_the_block_only():
    from threadpoolctl import threadpool_info

    def blas_threads():
        return [pool["num_threads"] for pool in threadpool_info() if pool["user_api"] == "blas"]

    before = blas_threads()
    with one_blas_thread():
        assert set(blas_threads()) <= {1}
    assert blas_threads() == before
