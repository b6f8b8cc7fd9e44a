"""A check finds what is damaged, and tells it from what killed writers and other programs left."""

import os

import pytest

from facewright.errors import StoreError
from facewright.warehouse.check import DAMAGED, FOREIGN, LEFTOVER, YOUNG, check_warehouse
from facewright.warehouse.store import Warehouse

pytest.importorskip("zarr")

OLD_TOKEN = "60000000-0123456789ab"  # drawn in 2021


@pytest.fixture
def people(store, make_subject):
    for k in range(3):
        store.write_subject(make_subject(f"p{k}", seed=k, raw=k == 0))
    store.set_labels("p0", {"age": 3})
    store.record_failure("p9", "no face", "NoFaceError")
    return store


def test_a_good_store_has_no_findings(people):
    seen = []
    report = check_warehouse(people, progress=lambda *step: seen.append(step))
    assert report.findings == () and report.removed == () and report.damaged == ()
    assert report.n_subjects == 3 and report.n_arrays == 10 + 3 + 3 and report.n_bytes > 100_000
    assert seen[-1] == ("checking subjects", 3, 3)


@pytest.mark.parametrize("what", ["array", "missing array", "document", "topology", "missing topology"])
def test_damage_is_found(people, what):
    root = people.objects.root
    if what.endswith("array"):
        path = root / people.entry("p1").folder / "blendshapes" / "c.0.0.0"
    elif what == "document":
        path = root / "subjects" / "p1" / "zarr.json"
    else:
        path = root / "topology" / people.document["topology"]["token"] / "faces" / "c.0.0"
    if what.startswith("missing"):
        path.unlink()
    else:
        data = bytearray(path.read_bytes())
        data[len(data) // 2] ^= 1
        path.write_bytes(data)
    report = check_warehouse(people)
    assert [finding.kind for finding in report.findings] == [DAMAGED]
    assert report.damaged == (() if "topology" in what else ("p1",))
    assert ("'p1'" if report.damaged else "topology") in report.findings[0].what
    if report.damaged:
        repaired = check_warehouse(people, repair=True)
        assert repaired.removed == ()  # a repair removes nothing that somebody may miss
        assert check_warehouse(people, remove_damaged=True).removed == ("subjects/p1",)
        assert people.subject_names() == ["p0", "p2"] and people.failures()["p1"].kind == "Damaged"
        assert check_warehouse(people).findings == ()


def test_leftovers_go_when_they_are_old(people, make_subject):
    root = people.objects.root
    for folder in (f"subjects/p1/{OLD_TOKEN}/meshes", f"subjects/killed/{OLD_TOKEN}/meshes", f"topology/{OLD_TOKEN}"):
        (root / folder).mkdir(parents=True)
        (root / folder / "c.0.0.0").write_bytes(b"x" * 100)
    part = root / "subjects" / "p2" / ".zarr.0123456789ab.part.json"
    part.write_text("{")
    os.utime(part, (1.6e9, 1.6e9))
    (root / "labels" / "gone").mkdir()
    (root / "labels" / "gone" / "zarr.json").write_text("{}")
    (root / "README.txt").write_text("of the user")
    report = check_warehouse(people)
    kinds = {finding.key: finding.kind for finding in report.findings}
    assert kinds == {
        f"subjects/p1/{OLD_TOKEN}": LEFTOVER,
        f"subjects/killed/{OLD_TOKEN}": LEFTOVER,
        f"topology/{OLD_TOKEN}": LEFTOVER,
        "subjects/p2/.zarr.0123456789ab.part.json": LEFTOVER,
        "labels/gone/zarr.json": YOUNG,
        "README.txt": FOREIGN,
    }
    assert report.removed == () and report.damaged == ()
    repaired = check_warehouse(people, repair=True)
    assert len(repaired.removed) == 5  # four leftovers and the empty folder of the subject that never was
    assert not (root / "subjects" / "killed").exists() and (root / "README.txt").exists()
    assert {finding.kind for finding in check_warehouse(people).findings} == {YOUNG, FOREIGN}
    assert people.subject_names() == ["p0", "p1", "p2"]


def test_a_writer_at_work_is_left_alone(people, make_subject, monkeypatch):
    """A check with repair runs between the writer's arrays and its commit: the subject still arrives."""
    create = type(people.objects).create

    def create_after_check(self, key, value):
        report = check_warehouse(Warehouse.open(people.url, "a"), repair=True)
        assert [finding.kind for finding in report.findings] == [YOUNG] and report.removed == ()
        return create(self, key, value)

    monkeypatch.setattr(type(people.objects), "create", create_after_check)
    people.write_subject(make_subject("late", seed=5))
    monkeypatch.undo()
    assert people.read_subject("late").provenance["seed"] == 5
    assert check_warehouse(people).findings == ()


def test_a_store_for_reading_is_not_changed(people):
    with pytest.raises(StoreError, match="reading only"):
        check_warehouse(Warehouse.open(people.url), repair=True)


def test_a_check_of_an_object_store(grid_topology, make_subject):
    fsspec = pytest.importorskip("fsspec")
    store = Warehouse.create("memory://check/faces.zarr", grid_topology, exist_ok=True)
    store.write_subject(make_subject("anna"), overwrite=True)
    assert check_warehouse(store).findings == ()
    memory = fsspec.filesystem("memory")
    memory.pipe_file(f"/check/faces.zarr/subjects/bert/{OLD_TOKEN}/meshes/c.0", b"x")
    memory.pipe_file(f"/check/faces.zarr/{store.entry('anna').folder}/meshes/c.0.0.0", b"x")
    report = check_warehouse(store, repair=True, remove_damaged=True)
    assert report.damaged == ("anna",) and f"subjects/bert/{OLD_TOKEN}" in report.removed
    assert store.subject_names() == [] and check_warehouse(store).findings == ()
