"""FaceWarehouse's folders, written from synthetic meshes in the layout that public readers agree on."""

import json
import shutil

import numpy as np
import pytest

from facewright.apps.warehouse_import import ImportRequest, import_people
from facewright.errors import FileFormatError, StoreError, TopologyError
from facewright.faces.blendshape_names import load_name_map
from facewright.faces.expressions import EXPRESSION_NAMES, EXPRESSION_WEIGHTS
from facewright.io.facewarehouse_bs import write_bs
from facewright.io.image import write_image
from facewright.io.obj import write_obj
from facewright.numeric.rotation import matrix_from_rotation_vector
from facewright.warehouse.export import export_facewarehouse
from facewright.warehouse.import_facewarehouse import list_testers
from facewright.warehouse.store import Warehouse

pytest.importorskip("zarr")

UNIT = 100.0  # the made-up files are in decimetres


@pytest.fixture
def write_tester(grid_topology):
    """Write ``Tester_<number>`` of a subject: quads with uv, poses with pictures and landmarks, and shape.bs."""

    def write(root, number, subject, *, obj_shapes=False):
        folder = root / f"Tester_{number}"
        (folder / "TrainingPose").mkdir(parents=True)
        (folder / "Blendshape").mkdir()
        quads = grid_topology.quads
        for k, mesh in enumerate(subject.meshes):
            write_obj(folder / "TrainingPose" / f"pose_{k}.obj", mesh / UNIT, quads, uv=grid_topology.uv)
            if subject.color is not None:
                write_image(folder / "TrainingPose" / f"pose_{k}.png", subject.color[k])
            shares = (subject.landmarks[k] + 0.5) / [64, 48] if subject.landmarks is not None else np.full((74, 2), 0.5)
            lines = [f"{x} {1 - y}" for x, y in np.nan_to_num(shares, nan=0.5)]
            (folder / "TrainingPose" / f"pose_{k}.land").write_text("\n".join(["74", *lines]))
        for k, shape in enumerate(subject.blendshapes if obj_shapes else subject.blendshapes[:1]):
            write_obj(folder / "Blendshape" / f"shape_{k}.obj", shape / UNIT, quads)
        if not obj_shapes:
            write_bs(folder / "Blendshape" / "shape.bs", subject.blendshapes / UNIT, len(quads))
        return folder

    return write


@pytest.mark.parametrize("obj_shapes", [False, True])
def test_people_come_over(tmp_path, write_tester, make_subject, grid_topology, obj_shapes):
    root, url = tmp_path / "FaceWarehouse", str(tmp_path / "fw.zarr")
    subjects = {n: make_subject(f"Tester_{n}", seed=n, raw=True) for n in (1, 2, 10)}
    for n, subject in subjects.items():
        write_tester(root, n, subject, obj_shapes=obj_shapes)
    assert [path.name for path in list_testers(root)] == ["Tester_1", "Tester_2", "Tester_10"]
    report = import_people(ImportRequest(root, url))
    assert report.layout == "facewarehouse" and report.imported == ("Tester_1", "Tester_2", "Tester_10")
    store = Warehouse.open(url)
    assert store.blendshape_names == ("neutral", *load_name_map("facewarehouse46").names)
    np.testing.assert_array_equal(store.topology.quads, grid_topology.quads)
    for n, subject in subjects.items():
        found = store.read_subject(f"Tester_{n}")
        assert found.expressions == EXPRESSION_NAMES
        np.testing.assert_allclose(found.meshes, subject.meshes, atol=2e-5)
        np.testing.assert_allclose(found.blendshapes, subject.blendshapes, atol=2e-5)
        np.testing.assert_array_equal(found.color, subject.color)
        known = np.isfinite(subject.landmarks)
        np.testing.assert_allclose(found.landmarks[known], subject.landmarks[known], atol=1e-6)
        assert found.provenance["unit"] == "dm" and found.provenance["moved_poses"] == {}
        assert found.provenance["blendshapes"] == ("shape_*.obj" if obj_shapes else "shape.bs")
    assert store.blendshape_tensor().shape == (3, 47, 300, 3)


def test_poses_in_another_frame_are_moved_onto_the_shapes(tmp_path, builtin_face, rng):
    """Poses as a sensor saw them, turned by up to 30 degrees and 700 mm away, come back onto the neutral."""
    face = builtin_face.skin()
    quads = face.topology.faces if face.topology.quads is None else face.topology.quads
    shapes = np.concatenate([face.mean_shape[None], face.mean_shape + face.blendshape_deltas])
    meshes = face.mean_shape + np.tensordot(EXPRESSION_WEIGHTS, face.blendshape_deltas, 1)
    for part in ("TrainingPose", "Blendshape"):
        (tmp_path / "Tester_1" / part).mkdir(parents=True)
    write_bs(tmp_path / "Tester_1" / "Blendshape" / "shape.bs", shapes, len(quads))
    acted = (0, 1, 2, 4, 17, 19)
    for k in acted:
        turn = matrix_from_rotation_vector(rng.uniform(-0.3, 0.3, 3)) if k in (1, 2, 4) else np.eye(3)
        shift = np.array([0.0, 0.0, 700.0]) if k in (1, 2, 4) else np.zeros(3)
        write_obj(tmp_path / "Tester_1" / "TrainingPose" / f"pose_{k}.obj", meshes[k] @ turn.T + shift, quads)
    import_people(ImportRequest(tmp_path, str(tmp_path / "fw.zarr")))
    found = Warehouse.open(tmp_path / "fw.zarr").read_subject("Tester_1")
    assert found.expressions == tuple(EXPRESSION_NAMES[k] for k in acted)
    assert set(found.provenance["moved_poses"]) == {EXPRESSION_NAMES[k] for k in (1, 2, 4)}
    assert len(found.provenance["missing_poses"]) == 14
    distance = np.linalg.norm(found.meshes - meshes[list(acted)], axis=2)
    assert distance[[0, 4, 5]].max() < 1e-4  # what lies in place is left alone
    assert distance.max() < 0.5, distance.max(axis=1)


def test_incomplete_people(tmp_path, write_tester, make_subject):
    """Nineteen poses, no pictures, no landmarks, no blendshapes: what is there is taken, what is not is told."""
    folder = write_tester(tmp_path, 1, make_subject("Tester_1"))
    (folder / "TrainingPose" / "pose_7.obj").unlink()
    for path in (folder / "TrainingPose").glob("*.land"):
        path.unlink()
    write_tester(tmp_path, 2, make_subject("Tester_2", seed=2))
    shutil.rmtree(tmp_path / "Tester_2" / "Blendshape")
    write_tester(tmp_path, 3, make_subject("Tester_3", seed=3))
    (tmp_path / "Tester_3" / "TrainingPose" / "pose_0.obj").unlink()
    report = import_people(ImportRequest(tmp_path, str(tmp_path / "fw.zarr")))
    assert not report.failed
    store = Warehouse.open(tmp_path / "fw.zarr")
    one, two, three = (store.read_subject(f"Tester_{n}") for n in (1, 2, 3))
    assert len(one.expressions) == 19 and EXPRESSION_NAMES[7] not in one.expressions and one.landmarks is None
    assert one.provenance["missing_poses"] == [EXPRESSION_NAMES[7]] and one.color is None
    assert two.blendshapes is None and len(two.expressions) == 20
    assert three.expressions[0] == "neutral"
    np.testing.assert_array_equal(three.meshes[0], three.blendshapes[0])
    assert store.blendshape_tensor().names == ("Tester_1", "Tester_3")


@pytest.mark.parametrize(
    ("spoil", "reason"),
    [
        (lambda f: (f / "Blendshape" / "shape.bs").write_bytes(b"x" * 5000), "must be a FaceWarehouse .bs file"),
        (lambda f: write_bs(f / "Blendshape" / "shape.bs", np.ones((47, 299, 3)), 1), "46 of 299 vertices"),
        (lambda f: write_bs(f / "Blendshape" / "shape.bs", np.ones((40, 300, 3)), 1), "39 of 300 vertices"),
        (lambda f: write_bs(f / "Blendshape" / "shape.bs", np.ones((47, 300, 3)), 1), "mesh of shape_0.obj"),
        (lambda f: (f / "TrainingPose" / "pose_3.land").write_text("1"), "74 points"),
        (lambda f: (f / "TrainingPose" / "pose_3.obj").write_text("v 0 0 0\nf 1 1 1\n"), "got 1 vertices"),
        (lambda f: (f / "TrainingPose" / "pose_3.png").write_bytes(b"no picture"), "pose_3.png"),
    ],
)
def test_a_damaged_person_is_recorded_and_stops_nobody(tmp_path, write_tester, make_subject, spoil, reason):
    write_tester(tmp_path, 1, make_subject("Tester_1"))
    spoil(write_tester(tmp_path, 2, make_subject("Tester_2", seed=2)))
    report = import_people(ImportRequest(tmp_path, str(tmp_path / "fw.zarr")))
    assert report.imported == ("Tester_1",) and reason in report.failed["Tester_2"]


def test_shapes_missing_among_obj_files(tmp_path, write_tester, make_subject):
    folder = write_tester(tmp_path, 1, make_subject("Tester_1"), obj_shapes=True)
    (folder / "Blendshape" / "shape_9.obj").unlink()
    report = import_people(ImportRequest(tmp_path, str(tmp_path / "fw.zarr")))
    assert "got no shape_9.obj" in report.failed["Tester_1"]


def test_shapes_of_other_meanings_are_not_mixed(tmp_path, write_tester, make_subject, store):
    write_tester(tmp_path, 1, make_subject("Tester_1"))
    with pytest.raises(TopologyError, match="whose shape 1 is browDown_L, got EyeBlink_L"):
        import_people(ImportRequest(tmp_path, store.url))


def test_folders_without_anything(tmp_path):
    (tmp_path / "Tester_1").mkdir()
    with pytest.raises(FileFormatError, match="neither"):
        import_people(ImportRequest(tmp_path, str(tmp_path / "fw.zarr"), layout="facewarehouse"))
    (tmp_path / "empty").mkdir()
    with pytest.raises(StoreError, match="Tester_1, Tester_2"):
        import_people(ImportRequest(tmp_path / "empty", str(tmp_path / "fw.zarr"), layout="facewarehouse"))


# --- the way back --------------------------------------------------------------------------------------------------


def test_an_export_like_facewarehouse_comes_back(tmp_path, store, make_subject):
    subjects = [make_subject(name, seed=k, raw=True, age=30 + k) for k, name in enumerate(("anna", "bert"))]
    for subject in subjects:
        store.write_subject(subject)
    folders = export_facewarehouse(store, tmp_path / "fw", ["anna", "bert"])
    assert [folder.name for folder in folders] == ["Tester_1", "Tester_2"]
    assert json.loads((tmp_path / "fw" / "testers.json").read_text())["testers"]["Tester_2"] == "bert"
    assert not (folders[0] / "TrainingPose" / "pose_3.land").exists()  # one of its landmarks is missing
    report = import_people(ImportRequest(tmp_path / "fw", store.url))
    assert report.layout == "facewarehouse" and report.imported == ("Tester_1", "Tester_2")
    for subject, name in zip(subjects, report.imported):
        found = store.read_subject(name)
        np.testing.assert_array_equal(found.meshes, subject.meshes)
        np.testing.assert_array_equal(found.blendshapes, subject.blendshapes)
        np.testing.assert_array_equal(found.color, subject.color)
        np.testing.assert_allclose(found.landmarks[4], subject.landmarks[4], atol=1e-6)


def test_shapes_mixed_into_their_names(tmp_path, store, make_subject):
    subject = make_subject("anna")
    store.write_subject(subject)
    export_facewarehouse(store, tmp_path / "fw", ["anna"], shape_names="facewarehouse46")
    import_people(ImportRequest(tmp_path / "fw", str(tmp_path / "fw.zarr")))
    found = Warehouse.open(tmp_path / "fw.zarr")
    shapes = found.read_subject("Tester_1").blendshapes.astype(float)
    deltas = subject.blendshapes[1:].astype(float) - subject.blendshapes[0]
    ours = store.blendshape_names[1:]
    theirs = found.blendshape_names[1:]
    blink = shapes[1 + theirs.index("EyeBlink_L")] - shapes[0]
    np.testing.assert_allclose(blink, deltas[ours.index("eyeBlink_L")], atol=1e-4)
    both = shapes[1 + theirs.index("BrowsU_C")] - shapes[0]
    inner = deltas[ours.index("browInnerUp_L")] + deltas[ours.index("browInnerUp_R")]
    np.testing.assert_allclose(both, inner, atol=1e-4)
