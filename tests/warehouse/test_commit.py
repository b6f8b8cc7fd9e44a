"""A subject is there as a whole or not at all: killed writers, full disks, failing writes."""

import os
import signal
import subprocess
import sys
import time

import numpy as np
import pytest

from facewright.errors import StoreError
from facewright.warehouse.check import check_warehouse
from facewright.warehouse.layout import new_token
from facewright.warehouse.store import Warehouse

pytest.importorskip("zarr")

WRITER = """
import sys
import numpy as np
from facewright.warehouse.store import Warehouse
from facewright.warehouse.subject import Subject

store = Warehouse.open(sys.argv[1], "a")
print("ready", flush=True)
for k in range(10_000):
    rng = np.random.default_rng(k)
    meshes = rng.normal(size=(2, 300, 3)).astype(np.float32)
    shapes = rng.normal(size=(47, 300, 3)).astype(np.float32)
    subject = Subject(f"p{k % 3}", ("neutral", "smile"), meshes, shapes, provenance={"seed": k})
    store.write_subject(subject, overwrite=True)
"""


def _is_whole(store):
    for name in store.subject_names():
        found = store.read_subject(name)  # every checksum is compared
        rng = np.random.default_rng(found.provenance["seed"])
        assert found.meshes.tobytes() == rng.normal(size=(2, 300, 3)).astype(np.float32).tobytes()


@pytest.mark.parametrize("n_kills", [3, pytest.param(10, marks=pytest.mark.slow)])
def test_kill_9_at_random_moments(store, rng, n_kills):
    """Writers are killed while they write; no reader ever finds half a subject, and a repair cleans up."""
    for _ in range(n_kills):
        command = [sys.executable, "-c", WRITER, store.url]
        with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as writer:
            assert writer.stdout.readline() == "ready\n"
            time.sleep(rng.uniform(0.0, 0.35))
            os.kill(writer.pid, signal.SIGKILL)
        _is_whole(store)
    report = check_warehouse(store, repair=True, seconds_until_left=0.0)
    assert not report.damaged and {finding.kind for finding in report.findings} <= {"leftover"}
    assert check_warehouse(store).findings == ()
    _is_whole(store)
    files = [key for key in store.objects.facts("subjects") if key.count("/") > 2]
    assert len({tuple(key.split("/")[1:3]) for key in files}) == len(store.subject_names())  # one token a person


@pytest.mark.parametrize("step", ["put_all", "create"])
def test_nothing_stays_of_a_write_that_fails(store, make_subject, monkeypatch, step):
    real = type(store.objects).put_all

    def fail(self, *args):
        if step == "put_all":  # half of the objects
            real(self, dict(list(args[0].items())[: len(args[0]) // 2]))
        raise KeyboardInterrupt if step == "create" else StoreError("no space left on the disk.")

    monkeypatch.setattr(type(store.objects), step, fail)
    with pytest.raises((StoreError, KeyboardInterrupt)):
        store.write_subject(make_subject("anna", raw=True))
    monkeypatch.undo()
    assert store.subject_names() == []
    assert check_warehouse(store).findings == ()


def test_removal_leaves_nothing_but_what_another_writer_began(store, make_subject):
    """Also what killed writers left of a person goes; arrays younger than an hour that nobody names yet stay."""
    old, young = "60000000-0123456789ab", new_token()
    store.write_subject(make_subject("anna", raw=True, age=30))
    store.set_labels("anna", {"age": 31})
    for token in (old, young):
        store.objects.put_all({f"subjects/anna/{token}/meshes/c.0.0.0": b"x"})
    store.remove_subject("anna")
    assert "anna" not in store and set(store.objects.facts("labels")) == {"labels/zarr.json"}
    assert set(store.objects.facts("subjects")) == {
        "subjects/zarr.json",
        f"subjects/anna/{young}/meshes/c.0.0.0",
    }
    store.write_subject(make_subject("anna", seed=1))
    assert store.read_subject("anna").attributes == {}


def test_a_failed_overwrite_leaves_the_older_subject(store, make_subject, same_subject, monkeypatch):
    first = make_subject("anna")
    store.write_subject(first)

    def fail(self, key, value):
        raise StoreError("no space left on the disk.")

    monkeypatch.setattr(type(store.objects), "put", fail)
    with pytest.raises(StoreError):
        store.write_subject(make_subject("anna", seed=1), overwrite=True)
    monkeypatch.undo()
    same_subject(store.read_subject("anna"), first)
    assert check_warehouse(store).findings == ()


@pytest.fixture
def small_disk(tmp_path):
    """A folder on a disk of 2 MB; skips where it cannot be made."""
    folder = tmp_path / "disk"
    folder.mkdir()
    try:
        mount = ["mount", "-t", "tmpfs", "-o", "size=2m", "tmpfs", str(folder)]
        subprocess.run(mount, check=True, capture_output=True, timeout=20)
    except (OSError, subprocess.SubprocessError) as error:
        pytest.skip(f"needs root and tmpfs to make a small disk: {error}")
    try:
        yield folder
    finally:
        subprocess.run(["umount", str(folder)], check=False, capture_output=True, timeout=20)


def test_a_full_disk(small_disk, grid_topology, make_subject, same_subject):
    store = Warehouse.create(small_disk / "faces.zarr", grid_topology)
    written = []
    with pytest.raises(StoreError, match="no space left on the disk"):
        for k in range(100):
            store.write_subject(make_subject(f"p{k}", seed=k))
            written.append(k)
    assert len(written) > 1
    assert store.subject_names() == sorted(f"p{k}" for k in written)
    assert check_warehouse(store).findings == ()
    same_subject(store.read_subject("p0"), make_subject("p0", seed=0))
    with pytest.raises(StoreError, match="no space left"):  # without room, an overwrite leaves what was there
        store.write_subject(make_subject("p0", seed=50, raw=True), overwrite=True)
    same_subject(store.read_subject("p0"), make_subject("p0", seed=0))
    store.remove_subject("p1")  # makes room again
    store.write_subject(make_subject("later", seed=1))


def test_a_full_disk_at_creation(tmp_path, small_disk, grid_topology):
    (small_disk / "filler").write_bytes(b"x" * (2 * 2**20 - 40_000))
    with pytest.raises(StoreError, match="no space left on the disk"):
        Warehouse.create(small_disk / "faces.zarr", grid_topology)
    with pytest.raises(StoreError, match="making was stopped"):
        Warehouse.open(small_disk / "faces.zarr")
    (small_disk / "filler").unlink()
    Warehouse.create(small_disk / "faces.zarr", grid_topology)


def test_a_place_without_permission(store, make_subject):
    if os.geteuid() == 0:
        pytest.skip("root may write everywhere")
    folder = store.objects.root / "subjects"
    folder.chmod(0o500)
    try:
        with pytest.raises(StoreError, match="Permission denied"):
            store.write_subject(make_subject("anna"))
    finally:
        folder.chmod(0o700)
