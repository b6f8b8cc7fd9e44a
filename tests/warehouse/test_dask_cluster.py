"""Jobs run as Dask tasks: in this process, in workers, on a cluster that exists; errors and deaths are handed back."""

import os
import sys
import time
from pathlib import Path

import pytest

from facewright.errors import FacewrightError, MissingExtraError, ValueRangeError
from facewright.numeric.threads import thread_count
from facewright.warehouse import dask_cluster
from facewright.warehouse.dask_cluster import open_cluster

pytest.importorskip("distributed")

sys.path.insert(0, str(Path(__file__).parent))
import jobs_for_workers as jobs


def run(cluster, function, arguments, **options):
    return {f.label: f for f in cluster.run(function, [(str(a[0]), a) for a in arguments], **options)}


@pytest.fixture(scope="module")
def two_workers():
    with open_cluster(2, retries=1) as cluster:
        yield cluster


@pytest.fixture(params=["in process", "two workers"])
def cluster(request):
    if request.param == "two workers":
        yield request.getfixturevalue("two_workers")
    else:
        with open_cluster() as cluster:
            yield cluster


def test_values_and_errors_are_handed_back(cluster):
    done = run(cluster, jobs.square, [(k,) for k in range(7)])
    assert {label: f.value for label, f in done.items()} == {str(k): k * k for k in range(7)}
    done = run(cluster, jobs.refuse_odd, [(k,) for k in range(4)])
    assert [done[str(k)].error is None for k in range(4)] == [True, False, True, False]
    assert isinstance(done["1"].error, ValueRangeError) and str(done["1"].error) == "odd 1."
    assert not done["1"].worker_died


def test_calls_are_taken_as_places_become_free(cluster):
    """An endless list of calls is no trouble, and stopping early ends it."""
    import itertools

    taken = []
    calls = ((str(k), (k,)) for k in itertools.count() if not taken.append(k))
    results = cluster.run(jobs.square, calls)
    first = [next(results).value for _ in range(3)]
    results.close()
    assert sorted(first) == [0, 1, 4] or len(set(first)) == 3
    assert len(taken) <= 3 + 2


def test_what_may_pass_is_tried_again(cluster, tmp_path):
    done = run(cluster, jobs.succeed_at_last, [("a", str(tmp_path), 2), ("b", str(tmp_path), 3)], retries=1)
    assert done["a"].value == 2 and isinstance(done["b"].error, OSError)
    assert sorted(p.name for p in tmp_path.iterdir()) == ["a-1", "a-2", "b-1", "b-2"]


def test_a_worker_that_dies_takes_only_its_own_task_along(two_workers, tmp_path):
    done = run(two_workers, jobs.die_if, [(k, k == 2, str(tmp_path)) for k in range(8)], retries=1)
    assert done["2"].worker_died and done["2"].error is not None
    assert {label for label, f in done.items() if f.error is None} == {str(k) for k in range(8)} - {"2"}
    assert len(list(tmp_path.glob("2-*"))) == 2  # the attempt and one more


def test_workers_share_the_cores(two_workers):
    expected = str(max(1, thread_count() // 2))
    for finished in run(two_workers, jobs.environment, [(k,) for k in range(2)]).values():
        assert {finished.value[name] for name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "NUMBA_NUM_THREADS")} == {
            expected
        }
        assert finished.value["thread_count"] == int(expected) and finished.value["blas"] in (None, int(expected))


@pytest.mark.slow
def test_this_process_keeps_its_own_threads(monkeypatch):
    monkeypatch.setenv("OMP_NUM_THREADS", "7")
    monkeypatch.delenv("NUMBA_NUM_THREADS", raising=False)
    with open_cluster(4) as cluster:
        assert cluster.in_process is False
        value = next(cluster.run(jobs.environment, [("a", (1,))])).value
        assert value["thread_count"] == 1  # 7 threads among 4
    assert os.environ["OMP_NUM_THREADS"] == "7" and "NUMBA_NUM_THREADS" not in os.environ


def test_an_existing_cluster_is_used_and_left_alone(monkeypatch):
    from distributed import LocalCluster

    monkeypatch.setattr(dask_cluster, "_CONNECT_SECONDS", 2.0)
    with LocalCluster(n_workers=1, threads_per_worker=2, processes=False, dashboard_address=None) as existing:
        for _ in range(2):
            with open_cluster(scheduler=existing.scheduler_address) as cluster:
                done = run(cluster, jobs.square, [(k,) for k in range(5)])
                assert sorted(f.value for f in done.values()) == [0, 1, 4, 9, 16]
        with open_cluster(scheduler=existing.scheduler_address) as cluster:
            results = cluster.run(jobs.nap, [(str(k), (k,)) for k in range(40)])
            next(results)
            existing.close()
            with pytest.raises(FacewrightError, match=r"must stay reachable .* run again"):
                list(results)


def test_workers_of_another_version_are_refused(monkeypatch):
    from distributed import LocalCluster

    with LocalCluster(n_workers=1, threads_per_worker=1, processes=False, dashboard_address=None) as existing:
        monkeypatch.setattr(dask_cluster, "_version", jobs.old_version)
        with (
            pytest.raises(FacewrightError, match=r"must have facewright .*, got 0\.0\.1"),
            open_cluster(scheduler=existing.scheduler_address),
        ):
            pass


def test_nonsense_is_refused(monkeypatch):
    for wrong in ({"workers": -1}, {"workers": 2, "scheduler": "tcp://h:1"}, {"retries": -1}):
        with pytest.raises(ValueRangeError, match="must be 0 or more"), open_cluster(**wrong):
            pass
    monkeypatch.setattr(dask_cluster, "_CONNECT_SECONDS", 0.5)
    for address in ("tcp://127.0.0.1:1", "nonsense://x"):
        wrong = pytest.raises(FacewrightError, match="must be the address of a running Dask scheduler")
        with wrong, open_cluster(scheduler=address):
            pass


def test_without_dask_the_extra_is_named(monkeypatch):
    for options in ({}, {"workers": 1}, {"scheduler": "tcp://h:1"}):
        monkeypatch.setitem(sys.modules, "dask" if not options else "distributed", None)
        with pytest.raises(MissingExtraError, match=r"facewright\[warehouse\]"), open_cluster(**options):
            pass


def test_the_dashboard_is_told(two_workers):
    import importlib.util

    if importlib.util.find_spec("bokeh"):
        assert "http://" in two_workers.dashboard
    else:
        assert 'pip install "facewright[warehouse]"' in two_workers.dashboard
    with open_cluster() as cluster:
        assert cluster.dashboard == ""


def test_interrupting_stops_the_work_in_process():
    with open_cluster() as cluster:
        start = time.perf_counter()
        with pytest.raises(KeyboardInterrupt):
            list(cluster.run(jobs.interrupt, [("a", (1,)), ("b", (2,))], retries=3))
        assert time.perf_counter() - start < 5
