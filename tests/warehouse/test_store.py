"""The database: what is written comes back, queries read attributes alone, everything foreign is refused."""

import json
import pickle
import threading

import numpy as np
import pytest

from facewright.errors import FileFormatError, StoreError, TopologyError, ValueRangeError
from facewright.faces.blendshape_names import BLENDSHAPE_NAMES
from facewright.mesh.topology import Topology
from facewright.warehouse.store import Warehouse

pytest.importorskip("zarr")

PLACES = ["folder", "file url", "memory"]


@pytest.fixture
def place(request, tmp_path):
    """A path, a file:// URL, and a memory:// URL as any object store."""
    if request.param == "memory":
        fsspec = pytest.importorskip("fsspec")
        url = f"memory://{tmp_path.name}-{abs(hash(str(tmp_path)))}/faces.zarr"
        yield url
        fsspec.filesystem("memory").rm(url.partition("://")[2].partition("/")[0], recursive=True)
    else:
        yield tmp_path / "faces.zarr" if request.param == "folder" else f"file://{tmp_path}/faces.zarr"


@pytest.mark.parametrize("place", PLACES, indirect=True)
def test_a_subject_comes_back_bit_by_bit(place, grid_topology, make_subject, same_subject):
    store = Warehouse.create(place, grid_topology)
    subject = make_subject("anna", raw=True, age=34, sex="f", glasses=True, height=1.7)
    entry = store.write_subject(subject)
    again = Warehouse.open(place)
    found = again.read_subject("anna")
    same_subject(found, subject)
    assert found.provenance == {"seed": 0, "rms_mm": 0.25, "warnings": ["one"], "nothing": None}
    assert again.digest("anna") == entry.digest
    few = again.read_subject("anna", fields=["landmarks"])
    assert few.depth is None and few.blendshapes is None and few.landmarks.tobytes() == subject.landmarks.tobytes()
    assert again.read_array("anna", "depth").tobytes() == subject.depth.tobytes()
    assert again.read_array("anna", "color").tobytes() == subject.color.tobytes()
    store.write_subject(make_subject("bert", seed=1, blendshapes=False))
    assert again.subject_names() == ["anna", "bert"] and again.read_array("bert", "blendshapes") is None
    assert "anna" in again and "carl" not in again
    store.remove_subject("anna")
    assert again.subject_names() == ["bert"]


def test_the_store_stands_alone(store, grid_topology):
    found = Warehouse.open(store.url)
    topology = found.topology
    assert topology.fingerprint == grid_topology.fingerprint and topology.parts == dict(grid_topology.parts)
    for name in ("faces", "quads", "uv", "uv_faces", "mirror"):
        np.testing.assert_array_equal(getattr(topology, name), getattr(grid_topology, name))
    assert set(topology.masks) == {"face", "none"} and len(topology.masks["none"]) == 0
    np.testing.assert_array_equal(topology.landmarks["fw74"], grid_topology.landmarks["fw74"])
    assert found.version == 1 and found.face_name == "grid" and found.n_vertices == 300
    assert found.blendshape_names == ("neutral", *BLENDSHAPE_NAMES) and found.expression_names[0] == "neutral"


def test_any_zarr_library_can_read_it(store, make_subject):
    import zarr

    subject = make_subject("anna", raw=True)
    entry = store.write_subject(subject)
    root = zarr.open_group(store.url, mode="r")
    assert root.attrs["facewright"]["kind"] == "facewright warehouse"
    group = root[f"subjects/anna/{entry.token}"]
    assert sorted(name for name, _ in group.arrays()) == sorted(entry.arrays)
    np.testing.assert_array_equal(group["meshes"][3], subject.meshes[3])
    np.testing.assert_array_equal(group["blendshapes"][:, 100:140], subject.blendshapes[:, 100:140])
    np.testing.assert_array_equal(group["depth"][:], subject.depth)


def test_equal_contents_have_equal_digests(tmp_path, grid_topology, make_subject):
    one, two = (Warehouse.create(tmp_path / name, grid_topology) for name in ("one", "two"))
    one.write_subject(make_subject("anna", age=30, sex="f"))
    two.write_subject(make_subject("other", sex="f", age=30))  # name and order of attributes do not count
    two.write_subject(make_subject("later", age=31, sex="f"))
    two.write_subject(make_subject("another", seed=1, age=30, sex="f"))
    assert one.digest("anna") == two.digest("other")
    assert len({two.digest(name) for name in two.subject_names()}) == 3
    one.set_labels("anna", {"age": 99})
    assert one.digest("anna") == two.digest("other")


def test_queries_read_attributes_alone(store, make_subject, monkeypatch):
    for k, (age, sex) in enumerate([(20, "f"), (31, "m"), (45, "f"), (60, "m")]):
        store.write_subject(make_subject(f"p{k}", seed=k, age=age, sex=sex))
    store.write_subject(make_subject("nobody", seed=9))
    found = Warehouse.open(store.url)
    monkeypatch.setattr("facewright.warehouse.arrays.decode_array", None)  # reading an array would fail
    assert found.subject_names("age > 30") == ["p1", "p2", "p3"]
    assert found.subject_names("age>30 and sex == 'f'") == ["p2"]
    assert found.subject_names(["age>30", "sex=f"]) == ["p2"]
    assert found.subject_names(sex="m") == ["p1", "p3"] and found.subject_names("age<=45", sex="f") == ["p0", "p2"]
    assert found.subject_names("sex != f") == ["p1", "p3"]
    with pytest.raises(ValueRangeError, match=r"\(age, sex\), got 'agee'"):
        found.subject_names("agee > 3")


def test_labels_win_and_stay(store, make_subject):
    store.write_subject(make_subject("anna", age=30, sex="f"))
    assert store.set_labels("anna", {"age": 34, "hair colour": "brown"}) == {
        "age": 34,
        "sex": "f",
        "hair colour": "brown",
    }
    store.write_subject(make_subject("anna", seed=2, age=31, sex="f"), overwrite=True)
    assert store.read_subject("anna").attributes["age"] == 34
    assert store.subject_names("hair colour = brown") == ["anna"]
    assert store.set_labels("anna", {"age": None, "sex": None}) == {"hair colour": "brown"}
    with pytest.raises(StoreError, match="no subject 'bert'"):
        store.set_labels("bert", {"age": 3})
    with pytest.raises(ValueRangeError, match="< > = !"):
        store.set_labels("anna", {"a<b": 3})
    with pytest.raises(ValueRangeError, match="text, a finite number"):
        store.set_labels("anna", {"age": float("nan")})


def test_a_subject_is_not_overwritten_unasked(store, make_subject, same_subject):
    first, second = make_subject("anna"), make_subject("anna", seed=1)
    store.write_subject(first)
    with pytest.raises(StoreError, match="has subject 'anna' already"):
        store.write_subject(second)
    same_subject(store.read_subject("anna"), first)
    before = store.entry("anna").token
    store.write_subject(second, overwrite=True)
    same_subject(store.read_subject("anna"), second)
    assert not store.objects.facts(f"subjects/anna/{before}")  # the older arrays are gone


def test_failures_are_kept_until_the_subject_is_there(store, make_subject):
    store.record_failure("anna", "no face\nwas found", "NoFaceError")
    store.record_failure("Bärbel/../x", "name of a subject must be ...", "ValueRangeError")
    store.record_failure("", "no name")
    found = Warehouse.open(store.url).failures()
    assert list(found) == ["", "Bärbel/../x", "anna"]
    assert (found["anna"].reason, found["anna"].kind) == ("no face was found", "NoFaceError")
    store.write_subject(make_subject("anna"))
    assert "anna" not in store.failures()
    store.record_failure("anna", "worse the second time")  # an older subject stays beside it
    assert "anna" in store.failures() and store.subject_names() == ["anna"]
    store.write_subject(make_subject("anna", seed=1), overwrite=True)
    assert "anna" not in store.failures()


def test_a_failure_left_by_a_killed_writer_does_not_hold(store, make_subject, monkeypatch):
    store.record_failure("anna", "no face was found")
    monkeypatch.setattr(store.objects, "delete", lambda key: None)  # killed right after the commit
    store.write_subject(make_subject("anna"))
    assert store.failures() == {}


def test_two_writers_of_one_subject(store, make_subject, same_subject):
    subjects = [make_subject("anna", seed=k) for k in range(6)]
    errors = []

    def write(subject, overwrite):
        try:
            Warehouse.open(store.url, "a").write_subject(subject, overwrite=overwrite)
        except StoreError as error:
            errors.append(str(error))

    for overwrite in (False, True):
        threads = [threading.Thread(target=write, args=(subject, overwrite)) for subject in subjects]
        for thread in threads:
            thread.start()
        for thread in threads:
            thread.join()
        found = store.read_subject("anna")
        same_subject(found, subjects[found.provenance["seed"]])
    assert len(errors) == 5 and all("already" in error for error in errors)  # without overwriting, one wins


def test_two_processes_create_at_once(tmp_path, grid_topology):
    stores = []

    def create():
        stores.append(Warehouse.create(tmp_path / "faces.zarr", grid_topology, exist_ok=True))

    threads = [threading.Thread(target=create) for _ in range(6)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert len(stores) == 6
    assert len({store.document["topology"]["token"] for store in stores}) == 1
    assert len(stores[0].objects.names_in("topology")) == 2  # zarr.json and one token


def test_reading_goes_on_while_it_is_overwritten(store, make_subject):
    store.write_subject(make_subject("anna", raw=True))
    stop = threading.Event()

    def overwrite():
        seed = 1
        while not stop.is_set():
            Warehouse.open(store.url, "a").write_subject(make_subject("anna", seed=seed, raw=True), overwrite=True)
            seed += 1

    thread = threading.Thread(target=overwrite)
    thread.start()
    try:
        reader, seeds = Warehouse.open(store.url), set()
        for _ in range(8):
            found = reader.read_subject("anna")
            expected = make_subject("anna", seed=found.provenance["seed"], raw=True)
            assert found.meshes.tobytes() == expected.meshes.tobytes()
            seeds.add(found.provenance["seed"])
    finally:
        stop.set()
        thread.join()
    assert len(seeds) > 1


def test_a_store_travels_to_workers(store, make_subject):
    copy = pickle.loads(pickle.dumps(store))
    copy.write_subject(make_subject("anna"))
    assert store.subject_names() == ["anna"]


# --- what must be refused ------------------------------------------------------------------------------------------


def test_wrong_meshes_and_names_are_refused(store, make_subject, tmp_path):
    from dataclasses import replace

    subject = make_subject("anna")
    with pytest.raises(TopologyError, match="300 vertices of 'grid', got 299"):
        store.write_subject(replace(subject, meshes=subject.meshes[:, :299], blendshapes=None))
    with pytest.raises(ValueRangeError, match=r"zarr\.json"):
        store.write_subject(replace(subject, name="zarr.json"))
    with pytest.raises(ValueRangeError, match=r"provenance\.x"):
        store.write_subject(replace(subject, provenance={"x": object()}))
    with pytest.raises(ValueRangeError, match="attribute"):
        store.write_subject(replace(subject, attributes={"age": [1]}))
    with pytest.raises(ValueRangeError, match="uint8"):
        store.write_subject(replace(make_subject("anna", raw=True), color=np.zeros((20, 48, 64, 3))))
    assert store.subject_names() == [] and store.objects.names_in("subjects") == ["zarr.json"]
    with pytest.raises(StoreError, match="reading only"):
        Warehouse.open(store.url).write_subject(subject)
    with pytest.raises(StoreError, match="no subject 'anna'"):
        store.read_subject("anna")
    with pytest.raises(ValueRangeError, match="field must be one of"):
        store.read_subject("anna", fields=["mesh"])


def test_places_that_hold_something_else_are_refused(tmp_path, grid_topology, store):
    import zarr

    with pytest.raises(StoreError, match="got nothing there"):
        Warehouse.open(tmp_path / "absent")
    (tmp_path / "full").mkdir()
    (tmp_path / "full" / "letter.txt").write_text("x")
    with pytest.raises(FileFormatError, match="got something else"):
        Warehouse.open(tmp_path / "full")
    with pytest.raises(StoreError, match=r"new or empty place for a database, got one with 'letter.txt'"):
        Warehouse.create(tmp_path / "full", grid_topology)
    zarr.create_group(tmp_path / "two", zarr_format=2)
    with pytest.raises(FileFormatError, match="got Zarr version 2"):
        Warehouse.open(tmp_path / "two")
    zarr.create_group(tmp_path / "three", zarr_format=3)
    with pytest.raises(FileFormatError, match="got another Zarr group"):
        Warehouse.open(tmp_path / "three")
    with pytest.raises(StoreError, match="holds a Zarr store already"):
        Warehouse.create(tmp_path / "three", grid_topology)
    (tmp_path / "file").write_text("x")
    with pytest.raises(StoreError):
        Warehouse.create(tmp_path / "file", grid_topology)
    with pytest.raises(StoreError, match="holds a Zarr store already"):
        Warehouse.create(store.url, grid_topology)
    with pytest.raises(StoreError, match="URL that fsspec knows"):
        Warehouse.open("nosuchscheme://bucket/x")


def test_another_topology_or_other_shapes_are_refused(store, grid_topology):
    other = Topology("other", 300, np.ascontiguousarray(grid_topology.faces[:-1]))
    with pytest.raises(TopologyError, match="database of 'other'"):
        Warehouse.create(store.url, other, exist_ok=True)
    with pytest.raises(TopologyError, match="blendshapes"):
        Warehouse.create(store.url, grid_topology, blendshape_names=BLENDSHAPE_NAMES[::-1], exist_ok=True)
    with pytest.raises(ValueRangeError, match="46 unique names"):
        Warehouse.create(store.url + "2", grid_topology, blendshape_names=BLENDSHAPE_NAMES[:-1])
    assert Warehouse.create(store.url, grid_topology, exist_ok=True).mode == "a"


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda d: d["attributes"]["facewright"].update(version=2), "version 2, .* upgrade facewright"),
        (lambda d: d["attributes"]["facewright"].update(version=0), "version 0, .* build it again"),
        (lambda d: d["attributes"]["facewright"].pop("topology"), "does not tell names and topology"),
        (lambda d: d["attributes"]["facewright"]["topology"].pop("n_vertices"), "number of vertices"),
        (lambda d: d["attributes"].clear(), "another Zarr group"),
        (lambda d: d.clear(), "damaged zarr.json"),
    ],
)
def test_a_changed_root_is_told(store, change, message):
    path = store.objects.root / "zarr.json"
    document = json.loads(path.read_text())
    change(document)
    path.write_text(json.dumps(document))
    with pytest.raises(FileFormatError, match=message):
        Warehouse.open(store.url)


@pytest.mark.parametrize(
    "damage", ["truncated shard", "flipped bit", "missing shard", "missing metadata", "other shape"]
)
@pytest.mark.parametrize("field", ["meshes", "blendshapes", "landmarks"])
def test_damage_is_told_with_the_subjects_name(store, make_subject, field, damage):
    entry = store.write_subject(make_subject("anna", raw=True))
    folder = store.objects.root / entry.folder / field
    shard = next(path for path in folder.iterdir() if path.name.startswith("c."))
    data = bytearray(shard.read_bytes())
    if damage == "truncated shard":
        shard.write_bytes(data[: len(data) // 2])
    elif damage == "flipped bit":
        data[len(data) // 3] ^= 4
        shard.write_bytes(data)
    elif damage == "missing shard":
        shard.unlink()
    elif damage == "missing metadata":
        (folder / "zarr.json").unlink()
    else:
        text = (folder / "zarr.json").read_text()
        (folder / "zarr.json").write_text(text.replace("20", "21").replace("47", "48"))
    with pytest.raises(FileFormatError, match=f"{field} of subject 'anna' is (corrupt|missing)"):
        store.read_subject("anna")
    if field != "meshes":
        assert store.read_subject("anna", fields=["intrinsics"]).intrinsics is not None


def test_a_changed_document_is_told(store, make_subject):
    store.write_subject(make_subject("anna", age=30))
    path = store.objects.root / "subjects" / "anna" / "zarr.json"
    text = path.read_text()
    path.write_text(text.replace('"age": 30', '"age": 31'))
    with pytest.raises(FileFormatError, match="document of subject 'anna' does not match its checksum"):
        store.subject_names()
    path.write_text(text[:100])
    with pytest.raises(FileFormatError, match="subject 'anna' must be a document"):
        store.entry("anna")
