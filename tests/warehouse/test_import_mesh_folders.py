"""Folders of meshes: what is exported comes back bit by bit; other topologies, units and layouts are told."""

import json

import numpy as np
import pytest

from facewright.apps.warehouse_import import ImportRequest, import_people
from facewright.errors import FileFormatError, StoreError, TopologyError, ValueRangeError
from facewright.io.obj import read_obj, write_obj
from facewright.io.ply import write_ply
from facewright.warehouse.export import export_mesh_folders
from facewright.warehouse.store import Warehouse

pytest.importorskip("zarr")


@pytest.fixture
def exported(store, make_subject, tmp_path):
    """Two people in a store and their folders; the second has no blendshapes."""
    subjects = {
        "anna": make_subject("anna", raw=True, age=34, sex="f"),
        "bert": make_subject("bert", seed=1, blendshapes=False),
    }
    for subject in subjects.values():
        store.write_subject(subject)
    export_mesh_folders(store, tmp_path / "meshes", list(subjects))
    return tmp_path / "meshes", subjects


@pytest.mark.parametrize("mesh_format", ["obj", "ply"])
def test_what_is_exported_comes_back(store, make_subject, tmp_path, grid_topology, mesh_format):
    subject = make_subject("anna", raw=True, age=34, sex="f")
    store.write_subject(subject)
    (folder,) = export_mesh_folders(store, tmp_path / "out", ["anna"], mesh_format=mesh_format)
    assert (folder / "smile.png").is_file() and json.loads((folder / "subject.json").read_text()) == {
        "age": 34,
        "sex": "f",
    }
    report = import_people(ImportRequest(tmp_path / "out", str(tmp_path / "again.zarr")))
    assert report.layout == "meshes" and report.imported == ("anna",) and not report.failed
    again = Warehouse.open(tmp_path / "again.zarr")
    found = again.read_subject("anna")
    assert found.expressions == subject.expressions and found.attributes == {"age": 34, "sex": "f"}
    np.testing.assert_array_equal(found.meshes, subject.meshes)
    np.testing.assert_array_equal(found.blendshapes, subject.blendshapes)
    assert found.provenance["unit"] == "mm" and found.landmarks is None
    if mesh_format == "obj":  # PLY files carry no texture coordinates and give polygons in any case
        np.testing.assert_array_equal(again.topology.uv, grid_topology.uv)
    np.testing.assert_array_equal(again.topology.quads, grid_topology.quads)


def test_an_import_is_continued(exported, tmp_path):
    folder, _ = exported
    url = str(tmp_path / "new.zarr")
    assert import_people(ImportRequest(folder, url)).imported == ("anna", "bert")
    assert import_people(ImportRequest(folder, url)).already_there == ("anna", "bert")
    assert import_people(ImportRequest(folder, url, overwrite=True)).imported == ("anna", "bert")
    assert Warehouse.open(url).read_subject("bert").blendshapes is None


@pytest.mark.parametrize(("unit", "scale"), [("m", 1000.0), ("cm", 10.0), ("dm", 100.0)])
def test_units_are_found_by_size(exported, tmp_path, unit, scale):
    folder, subjects = exported
    for path in (folder / "bert").glob("*.obj"):
        mesh = read_obj(path)
        write_obj(path, mesh.vertices / scale, mesh.polygons)
    for chosen in ("auto", unit):
        url = str(tmp_path / f"{chosen}.zarr")
        import_people(ImportRequest(folder, url, unit=chosen))
        if chosen == "auto":
            found = Warehouse.open(url).read_subject("bert")
            assert found.provenance["unit"] == unit
            np.testing.assert_allclose(found.meshes, subjects["bert"].meshes, atol=2e-4)
        else:  # anna is in mm: as metres she would be a giant
            reason = Warehouse.open(url).failures()["anna"].reason
            assert "between 80 and 800 mm large" in reason


def _one_quad_turned(path):
    mesh = read_obj(path)
    polygons = mesh.polygons.copy()
    polygons[5] = polygons[5][[0, 2, 1, 3]]
    write_obj(path, mesh.vertices, polygons)


def _one_vertex_less(path):
    mesh = read_obj(path)
    write_obj(path, mesh.vertices[:-1], mesh.polygons[(mesh.polygons < 299).all(axis=1)])


def _huge(path):
    mesh = read_obj(path)
    write_obj(path, mesh.vertices * 1e6, mesh.polygons)


@pytest.mark.parametrize(
    ("spoil", "reason"),
    [
        (lambda f: (f / "neutral.obj").unlink(), "must hold neutral.obj"),
        (lambda f: _one_quad_turned(f / "smile.obj"), "other triangles between them"),
        (lambda f: _one_vertex_less(f / "smile.obj"), "300 vertices and 532 triangles, got 299"),
        (lambda f: (f / "smile.obj").write_text("v 1 2\n"), "3 finite numbers"),
        (lambda f: (f / "blendshapes" / "jawOpen.obj").unlink(), "got 45, without jawOpen"),
        (lambda f: (f / "blendshapes" / "x.obj").write_bytes((f / "smile.obj").read_bytes()), "with x beside them"),
        (lambda f: (f / "subject.json").write_text("[1]"), "one JSON object"),
        (lambda f: (f / "subject.json").write_text("{"), "must be a JSON file"),
        (lambda f: write_ply(f / "smile.ply", np.zeros((3, 3)), [[0, 1, 2]]), "got smile.obj and smile.ply"),
        (lambda f: _huge(f / "neutral.obj"), "between 80 and 800 mm"),
    ],
)
def test_a_person_that_cannot_be_read_is_recorded_and_stops_nobody(exported, store, spoil, reason):
    folder, _ = exported
    spoil(folder / "anna")
    for name in ("anna", "bert"):
        store.remove_subject(name)
    report = import_people(ImportRequest(folder, store.url))
    assert report.imported == ("bert",) and list(report.failed) == ["anna"]
    assert reason in report.failed["anna"] and reason in store.failures()["anna"].reason


def test_a_folder_name_that_cannot_be_a_subject(exported, store):
    folder, _ = exported
    (folder / "anna").rename(folder / "Anna Müller")
    report = import_people(ImportRequest(folder, store.url))
    assert "letters, digits" in report.failed["Anna Müller"]
    assert "Anna Müller" in store.failures()


def test_a_database_of_another_topology_refuses_everybody(exported, tmp_path, grid_topology):
    from facewright.mesh.topology import Topology

    other = Topology("other", 300, grid_topology.faces, quads=grid_topology.quads[:-1])
    Warehouse.create(tmp_path / "other.zarr", other)
    report = import_people(ImportRequest(exported[0], str(tmp_path / "other.zarr")))
    assert set(report.failed) == {"anna", "bert"} and "topology 'other'" in report.failed["bert"]


def test_what_is_no_folder_of_people_is_refused(exported, tmp_path):
    folder, _ = exported
    new = str(tmp_path / "x.zarr")
    with pytest.raises(FileFormatError, match=f"looks like one person, give {folder}"):
        import_people(ImportRequest(folder / "bert", new))
    (tmp_path / "empty").mkdir()
    with pytest.raises(FileFormatError, match="got none"):
        import_people(ImportRequest(tmp_path / "empty", new))
    with pytest.raises(StoreError, match="absent"):
        import_people(ImportRequest(tmp_path / "absent", new))
    with pytest.raises(ValueRangeError, match="layout"):
        ImportRequest(folder, new, layout="zip")
    with pytest.raises(TopologyError, match="the face's topology 'builtin'"):
        import_people(ImportRequest(folder, new, face="builtin"))
    with pytest.raises(ValueRangeError, match="unit"):
        raise ValueRangeError(import_people(ImportRequest(folder, new, unit="inch")).failed["anna"])
    (folder / "anna" / "neutral.obj").unlink()
    (folder / "bert" / "neutral.obj").write_text("x")
    with pytest.raises(FileFormatError):
        import_people(ImportRequest(folder, str(tmp_path / "y.zarr")))


def test_an_export_is_whole_or_not_there(store, make_subject, tmp_path, monkeypatch):
    store.write_subject(make_subject("anna"))
    out = tmp_path / "out"
    export_mesh_folders(store, out, ["anna"])
    with pytest.raises(StoreError, match="must not be there yet"):
        export_mesh_folders(store, out, ["anna"])
    store.write_subject(make_subject("bert"))

    def fail(*args):
        raise StoreError("no space left on the disk.")

    monkeypatch.setattr("facewright.warehouse.export._write_json", fail)
    with pytest.raises(StoreError):
        export_mesh_folders(store, out, ["bert"])
    assert [path.name for path in out.iterdir()] == ["anna"]
    with pytest.raises(ValueRangeError, match="mesh_format"):
        export_mesh_folders(store, out, ["bert"], mesh_format="stl")


def test_meshes_of_a_known_face_bring_its_annotations(builtin_face, tmp_path):
    folder = tmp_path / "people" / "carl"
    folder.mkdir(parents=True)
    topology = builtin_face.topology
    faces = topology.faces if topology.quads is None else topology.quads
    write_obj(folder / "neutral.obj", builtin_face.mean_shape, faces)
    write_obj(folder / "smile.obj", builtin_face.mean_shape + 1, faces)
    report = import_people(ImportRequest(tmp_path / "people", str(tmp_path / "new.zarr")))
    assert report.imported == ("carl",)
    store = Warehouse.open(tmp_path / "new.zarr")
    assert store.face_name == "builtin" and set(store.topology.masks) == set(topology.masks)
    np.testing.assert_array_equal(store.read_subject("carl").meshes[0], builtin_face.mean_shape)
    skin = builtin_face.skin()
    (tmp_path / "skins" / "carl").mkdir(parents=True)
    write_ply(tmp_path / "skins" / "carl" / "neutral.ply", skin.mean_shape, skin.topology.faces)
    import_people(ImportRequest(tmp_path / "skins", str(tmp_path / "skin.zarr"), face="builtin"))
    assert Warehouse.open(tmp_path / "skin.zarr").n_vertices == builtin_face.n_skin
