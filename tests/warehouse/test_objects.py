"""Places: a local folder and fsspec file systems keep the same promises."""

import pickle
import threading

import pytest

from facewright.errors import MissingExtraError, StoreError
from facewright.warehouse.local_objects import LocalObjects
from facewright.warehouse.objects import open_objects
from facewright.warehouse.remote_objects import RemoteObjects


@pytest.fixture(params=["local", "memory", "fsspec with real folders"])
def objects(request, tmp_path):
    if request.param == "local":
        return open_objects(tmp_path / "store")
    fsspec = pytest.importorskip("fsspec")
    if request.param == "memory":
        fsspec.filesystem("memory").store.clear()
        return open_objects("memory://bucket/store")
    return RemoteObjects(f"file://{tmp_path}/store")


def test_objects_come_back(objects):
    objects.put_all({"a/b/one": b"1", "a/b/two": b"22", "a/three": bytearray(b"333")})
    objects.put("a/zarr.json", b"old")
    objects.put("a/zarr.json", b"new")
    assert objects.get(["a/b/one", "a/zarr.json", "absent", "a/b", "a/three"]) == [b"1", b"new", None, None, b"333"]
    assert objects.get([]) == [] and objects.get(["a/b/two"]) == [b"22"] and objects.get(["x/y"]) == [None]
    assert objects.names_in("a") == ["b", "three", "zarr.json"] and objects.names_in("absent") == []
    assert objects.names_in("") == ["a"]
    facts = objects.facts("")
    assert {key: fact.n_bytes for key, fact in facts.items()} == {
        "a/b/one": 1,
        "a/b/two": 2,
        "a/three": 3,
        "a/zarr.json": 3,
    }
    assert all(fact.modified is not None for fact in facts.values())
    assert set(objects.facts("a/b")) == {"a/b/one", "a/b/two"} and objects.facts("absent") == {}
    objects.delete("a/b")
    objects.delete("a/b")
    objects.delete("a/three")
    assert set(objects.facts("")) == {"a/zarr.json"}


def test_parts_of_objects(objects):
    objects.put_all({"x/data": bytes(range(100))})
    assert objects.get_ranges([("x/data", 3, 6), ("x/data", -4, 0), ("absent", 0, 4), ("x/data", 95, 120)]) == [
        bytes([3, 4, 5]),
        bytes([96, 97, 98, 99]),
        None,
        bytes(range(95, 100)),
    ]
    assert objects.get_ranges([]) == []
    assert objects.get_ranges([("x/data", -200, 0)]) == [bytes(range(100))]  # longer than the object


def test_only_one_creates(objects):
    assert objects.create("a/zarr.json", b"first") is True
    assert objects.create("a/zarr.json", b"second") is False
    assert objects.get(["a/zarr.json"]) == [b"first"]
    made = []
    threads = [threading.Thread(target=lambda k=k: made.append(objects.create("b", bytes([k])))) for k in range(8)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    if isinstance(objects, LocalObjects):  # what fsspec systems promise differs from one to the other
        assert sum(made) == 1
    assert objects.facts("").keys() == {"a/zarr.json", "b"}


def test_they_travel_to_workers(objects):
    objects.put("a", b"1")
    assert pickle.loads(pickle.dumps(objects)).get(["a"]) == [b"1"]


def test_places_are_told_apart(tmp_path, monkeypatch):
    assert open_objects(f"file://{tmp_path}/x").url == str(tmp_path / "x")
    monkeypatch.setenv("HOME", str(tmp_path))
    assert open_objects("~/x").url == str(tmp_path / "x")
    monkeypatch.chdir(tmp_path)
    assert open_objects("x").url == str(tmp_path / "x")  # stays right where the folder is changed
    with pytest.raises(StoreError, match="nosuch://x must be a folder or a URL that fsspec knows"):
        open_objects("nosuch://x")


def test_a_package_that_is_not_installed(monkeypatch):
    import builtins

    real = builtins.__import__

    def without(name, *args, **kwargs):
        if name.startswith(("s3fs", "fsspec.core")):
            raise ImportError(f"no {name}")
        return real(name, *args, **kwargs)

    monkeypatch.setattr(builtins, "__import__", without)
    with pytest.raises(MissingExtraError, match=r"facewright\[warehouse\]"):
        open_objects("s3://bucket/x")


def test_errors_of_a_service_become_one_sentence(monkeypatch):
    pytest.importorskip("fsspec")
    objects = open_objects("memory://bucket/errors")

    def fail(*args, **kwargs):
        raise RuntimeError("An error occurred (403)\nwhen calling GetObject: Forbidden.")

    for method in ("cat", "pipe_file", "pipe", "find", "ls", "rm", "cat_ranges"):
        monkeypatch.setattr(objects._opened[0], method, fail)
    for call in (
        lambda: objects.get(["a"]),
        lambda: objects.get_ranges([("a", 0, 1)]),
        lambda: objects.put("a", b""),
        lambda: objects.create("a", b""),
        lambda: objects.put_all({"a": b""}),
        lambda: objects.names_in(""),
        lambda: objects.facts(""),
        lambda: objects.delete("a"),
    ):
        with pytest.raises(StoreError, match=r"memory://bucket/errors cannot be reached: .* GetObject: Forbidden\.$"):
            call()
