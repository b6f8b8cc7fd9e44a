"""Builds of databases: failures stay with their subject, what is killed is continued, builders leave others alone."""

import multiprocessing
import os
import signal
import sys
import time
from contextlib import nullcontext
from pathlib import Path

import numpy as np
import pytest

from facewright.errors import FileFormatError, MissingExtraError, StoreError, TopologyError
from facewright.warehouse.build import build_warehouse
from facewright.warehouse.dask_cluster import open_cluster
from facewright.warehouse.store import Warehouse

pytest.importorskip("zarr")
pytest.importorskip("distributed")

sys.path.insert(0, str(Path(__file__).parent))  # workers import these by name
import fake_process
from build_fixtures import OPTIONS, captures_of, contents, read_everything, tiny_topology

NAMES = ("anna", "ben", "carla", "dora", "emil")


@pytest.fixture
def notes(tmp_path):
    """Folder with one file for each attempt."""
    folder = tmp_path / "notes"
    folder.mkdir()
    return folder


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


def attempts(notes, name):
    return len(list(notes.glob(f"{name}@*")))


@pytest.fixture
def empty(tmp_path):
    return Warehouse.create(tmp_path / "faces.zarr", tiny_topology())


def build(warehouse, captures, cluster=None, **options):
    with nullcontext(cluster) if cluster else open_cluster() as cluster:
        return build_warehouse(warehouse, captures, OPTIONS, cluster, process=fake_process.process_subject, **options)


def test_subjects_are_what_was_processed(empty):
    steps, stages = [], []
    captures = captures_of(*NAMES)
    report = build(empty, captures, on_step=steps.append, progress=lambda *step: stages.append(step))
    assert report.built == NAMES and not report.failed and not report.already_there
    for name, found in read_everything(empty.url).items():
        truth = fake_process.subject_of(name)
        np.testing.assert_array_equal(found.blendshapes, truth.blendshapes)
        np.testing.assert_array_equal(found.depth, truth.depth)
        assert found.attributes == truth.attributes
    assert [(s.done, s.total, s.failed) for s in steps] == [(k, 5, 0) for k in range(1, 6)]
    assert steps[-1].seconds_left == 0 and all(s.seconds_left > 0 for s in steps[:-1])
    assert stages == [("neutral", 1, 1)] * 5


def test_what_is_there_stays_and_is_not_made_again(empty, notes):
    build(empty, captures_of(*NAMES[:3], notes=notes))
    before = contents(empty)
    steps = []
    report = build(empty, captures_of(*NAMES, notes=notes), on_step=steps.append)
    assert report.already_there == NAMES[:3] and report.built == NAMES[3:]
    assert [attempts(notes, name) for name in NAMES] == [1] * 5
    assert {name: contents(empty)[name] for name in NAMES[:3]} == before
    assert [s.outcome.status for s in steps] == ["already there"] * 3 + ["built"] * 2


def test_the_order_and_the_workers_make_no_difference(empty, tmp_path, two_workers):
    build(empty, captures_of(*NAMES))
    other = Warehouse.create(tmp_path / "other.zarr", tiny_topology())
    report = build(other, captures_of(*NAMES[::-1]), two_workers)
    assert report.built == NAMES and contents(other) == contents(empty)


FAULTS = (
    ("refused-1", "DegenerateError", "got a wall.", 1),
    ("broken-1", "IndexError", r"mistake in facewright (IndexError at fake_process.py:", 3),
    ("unreadable-1", "OSError", "Input/output error (tried 3 times).", 3),
    ("missing-1", "StoreError", "cannot be read: it is gone.", 3),
    ("hungry-1", "MemoryError", "not enough memory (tried 3 times).", 3),
)


def test_a_failure_is_recorded_with_its_reason_and_stops_nobody_else(empty, notes, cluster):
    names = [*(name for name, *_ in FAULTS), "flaky-1", "anna", "ben"]
    captures = captures_of(*names, "zoe", "no good", notes=notes, zoe="zoe must have a name of its own, got Zoe.")
    steps = []
    report = build(empty, captures, cluster, on_step=steps.append)
    assert report.built == ("anna", "ben", "flaky-1")  # which failed once
    assert attempts(notes, "flaky-1") == 2
    failures = Warehouse.open(empty.url).failures()
    assert set(failures) == set(report.failed) == {name for name, *_ in FAULTS} | {"zoe", "no good"}
    for name, kind, reason, tries in FAULTS:
        assert failures[name].kind == kind and reason in failures[name].reason, failures[name]
        assert attempts(notes, name) == tries, name
    assert "name of its own" in failures["zoe"].reason and attempts(notes, "zoe") == 0
    assert "128 letters" in failures["no good"].reason and attempts(notes, "no good") == 0
    assert steps[-1].done == steps[-1].total == len(captures) and steps[-1].failed == 7


def test_what_was_unusual_about_a_subject_is_told(empty, cluster):
    steps = []
    report = build(empty, captures_of("anna", "noted-1", "refused-1"), cluster, on_step=steps.append)
    assert report.built == ("anna", "noted-1") and list(report.notes) == ["noted-1"]
    assert report.notes["noted-1"] == (
        "grin is left out: /nowhere/noted-1/grin/depth/0.1.png must be a whole picture.",
        "neutral, smile: Depths of the recording look like metres, not millimetres: multiplied by 1000.",
        "smile: Frames differ by 1.5 mm: the expression was not held.",
    )
    told = {step.outcome.name: step.outcome.notes for step in steps}
    assert told == {"anna": (), "noted-1": report.notes["noted-1"], "refused-1": ()}
    assert build(empty, captures_of("noted-1"), cluster).notes == {}  # it was there already


def test_a_failure_goes_when_the_subject_is_mended(empty, notes):
    captures = captures_of("refused-1", "anna", notes=notes)
    build(empty, captures)
    assert set(empty.failures()) == {"refused-1"}
    report = build(empty, captures, skip=empty.failures())
    assert report.failed == {} and attempts(notes, "refused-1") == 1
    good = fake_process.subject_of("refused-1")
    with open_cluster() as cluster:
        report = build_warehouse(empty, captures_of("refused-1"), OPTIONS, cluster, process=lambda *_: good)
    assert report.built == ("refused-1",) and empty.failures() == {}


def test_a_worker_that_dies_fails_its_own_subject_only(empty, notes, two_workers):
    names = ("anna", "ben", "carla", "dying-1", "emil", "frida", "gustav")
    report = build(empty, captures_of(*names, notes=notes), two_workers, retries=1)
    # One whose result was lost with the worker is found already there.
    assert set(report.built) | set(report.already_there) == set(contents(empty)) == set(names) - {"dying-1"}
    assert attempts(notes, "dying-1") == 2
    failure = empty.failures()["dying-1"]
    assert failure.kind == "WorkerDied" and "died" in failure.reason and "2 times" in failure.reason


def test_what_every_subject_would_fail_for_ends_the_build(empty, notes, cluster):
    with pytest.raises(MissingExtraError, match=r"facewright\[capture\]"):
        names = ("anna", "uninstalled-1", "uninstalled-2", "uninstalled-3")
        build(empty, captures_of(*names, notes=notes), cluster)
    assert empty.failures() == {} and set(contents(empty)) <= {"anna"}
    assert len(list(notes.glob("uninstalled-*"))) <= 2


def test_a_subject_of_another_face_ends_the_build(tmp_path):
    store = Warehouse.create(tmp_path / "other.zarr", tiny_topology("other", 100))
    with pytest.raises(TopologyError, match="must have the"):
        build(store, captures_of("anna", "ben"))
    assert contents(store) == {} == store.failures()


def test_a_store_that_cannot_be_written_ends_the_build(empty, monkeypatch):
    def refuse(self, subject):
        raise StoreError("faces.zarr cannot be written: no space left on the disk; nothing was changed.")

    monkeypatch.setattr(Warehouse, "write_subject", refuse)
    with pytest.raises(StoreError, match="no space left"):
        build(empty, captures_of("anna", "ben"))
    monkeypatch.undo()
    assert build(empty, captures_of("anna", "ben")).built == ("anna", "ben")


def test_a_database_in_memory(rng):
    store = Warehouse.create(f"memory://build-{rng.integers(1 << 40)}", tiny_topology())
    assert build(store, captures_of("anna", "refused-1")).built == ("anna",)
    assert list(store.failures()) == ["refused-1"]


# --- builds that are killed, and several at once -----------------------------------------------------------------


def build_here(url, names, workers=0):
    """Build in a process of its own."""
    warehouse = Warehouse.create(url, tiny_topology(), exist_ok=True)
    with open_cluster(workers) as cluster:
        build(warehouse, captures_of(*names), cluster)


@pytest.fixture(scope="module")
def processes():
    """Starts processes that have everything imported."""
    context = multiprocessing.get_context("forkserver")
    context.set_forkserver_preload(["fake_process", "build_fixtures", "facewright.warehouse.build"])
    return context


MANY = tuple(f"person-{k:02d}" for k in range(12))


@pytest.fixture(scope="module")
def undisturbed(tmp_path_factory):
    url = tmp_path_factory.mktemp("undisturbed") / "faces.zarr"
    start = time.perf_counter()
    build_here(url, MANY)
    return contents(url), time.perf_counter() - start


def start(processes, *args):
    process = processes.Process(target=build_here, args=args)
    process.start()
    return process


def test_killed_at_ten_random_moments_and_resumed(tmp_path, undisturbed, processes, rng):
    """kill -9 while it writes, computes, or makes the store; in the end the contents are the same."""
    expected, seconds = undisturbed
    url = tmp_path / "faces.zarr"
    there, cut = [], 0
    for _ in range(10):
        process = start(processes, url, MANY)
        begun = time.perf_counter()
        while not url.exists() and process.is_alive() and time.perf_counter() - begun < 30:
            time.sleep(0.002)
        time.sleep(rng.uniform(0, 0.25 * seconds))
        cut += process.is_alive()
        process.kill()
        process.join()
        try:
            found = contents(url)
        except (StoreError, FileFormatError):  # killed before the store was made
            found = {}
        assert found.items() <= expected.items()
        assert not there or set(there) <= set(found)  # nothing is lost
        there = list(found)
    assert cut >= 3
    build_here(url, MANY)
    assert contents(url) == expected
    assert set(read_everything(url)) == set(MANY)


@pytest.mark.slow
def test_killed_with_workers_leaves_no_process_behind_and_resumes(tmp_path, undisturbed, rng):
    import subprocess

    expected, _ = undisturbed
    url = tmp_path / "faces.zarr"
    script = (
        f"import sys; sys.path.insert(0, {str(Path(__file__).parent)!r}); "
        "from test_build import build_here, MANY\n"
        f"if __name__ == '__main__': build_here({str(url)!r}, MANY, 2)"
    )
    program = tmp_path / "program.py"
    program.write_text(script)
    environment = {**os.environ, "FAKE_PROCESS_SECONDS": "0.5"}
    for _ in range(3):
        process = subprocess.Popen([sys.executable, str(program)], env=environment, start_new_session=True)
        time.sleep(rng.uniform(6, 9))
        children = _descendants(process.pid)
        process.kill()
        process.wait()
        deadline = time.time() + 20
        while time.time() < deadline and any(_alive(pid) for pid in children):
            time.sleep(0.2)
        assert not [pid for pid in children if _alive(pid)]
        found = contents(url) if url.exists() else {}
        assert found.items() <= expected.items()
    build_here(url, MANY)
    assert contents(url) == expected


def _descendants(pid):
    import psutil

    return [child.pid for child in psutil.Process(pid).children(recursive=True)]


def _alive(pid):
    import psutil

    return psutil.pid_exists(pid) and psutil.Process(pid).status() != psutil.STATUS_ZOMBIE


def test_two_builds_at_once_end_with_the_same_contents(tmp_path, undisturbed, processes):
    expected, _ = undisturbed
    url = tmp_path / "faces.zarr"
    both = [start(processes, url, MANY), start(processes, url, MANY[::-1])]
    for process in both:
        process.join(120)
        assert process.exitcode == 0
    assert contents(url) == expected and Warehouse.open(url).failures() == {}
    assert set(read_everything(url)) == set(MANY)


def test_ctrl_c_is_no_failure_and_the_rest_follows_later(empty):
    before = signal.signal(signal.SIGINT, signal.default_int_handler)  # a shell's background jobs ignore it
    try:
        with pytest.raises(KeyboardInterrupt):
            build(empty, captures_of("anna", "interrupted-1", "zoe"))
        assert signal.getsignal(signal.SIGINT) is signal.default_int_handler
    finally:
        signal.signal(signal.SIGINT, before)
    assert set(contents(empty)) == {"anna"} and empty.failures() == {}
    assert build(empty, captures_of("anna", "zoe")).built == ("zoe",)
