import json
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from facewright.apps.fit_photo import FitPhotoRequest, fit_photo
from facewright.errors import DegenerateError, FileFormatError, NoFaceError, StoreError, ValueRangeError
from facewright.io.image import read_image, write_image
from facewright.landmarks.files import write_landmarks
from facewright.landmarks.points import Landmarks


@pytest.fixture(scope="module")
def files(tmp_path_factory, builtin_face):
    """A small model's file, a rendered person's photo and its landmarks' file."""
    from facewright.evaluation.photo import render_photo
    from facewright.evaluation.simulated_photo import simulate_photo
    from facewright.models.bilinear import fit_bilinear
    from facewright.models.bilinear_store import save_bilinear

    folder = tmp_path_factory.mktemp("fit")
    face, rng = builtin_face.skin(), np.random.default_rng(3)
    people = face.mean_shape + np.tensordot(rng.normal(size=(10, len(face.identity_basis))), face.identity_basis, 1)
    shapes = np.concatenate([np.zeros((1, *face.mean_shape.shape)), face.blendshape_deltas])
    tensor = (people[:, None] + rng.uniform(0.8, 1.2, (10, 47, 1, 1)) * shapes).astype(np.float32)
    model = fit_bilinear(
        tensor, 8, 20, topology=face.topology, expression_names=("neutral", *face.blendshape_names),
        provenance={"face": "builtin", "licence": face.licence},
    )  # fmt: skip
    save_bilinear(model, folder / "model.fwbm")
    photo = simulate_photo(builtin_face, rng)
    write_image(folder / "photo.png", render_photo(builtin_face, photo, rng))
    write_landmarks(folder / "points.json", photo.landmarks)
    return SimpleNamespace(
        folder=folder,
        model=folder / "model.fwbm",
        photo=folder / "photo.png",
        points=folder / "points.json",
        landmarks=photo.landmarks,
    )


def request(files, out, **changes):
    options = {"landmarks": files.points, "detect": False, "texture_size": 64} | changes
    return FitPhotoRequest(files.photo, files.model, out, **options)


def test_writes_all_results(files, tmp_path):
    stages = []
    result = fit_photo(request(files, tmp_path / "new" / "out"), lambda *a: stages.append(a))
    assert {p.name for p in (tmp_path / "new" / "out").iterdir()} >= {
        "fit.json", "landmarks.json", "face.obj", "face.glb", "texture.png", "overlay.png",
    }  # fmt: skip
    assert all(path.stat().st_size > 0 for path in result.paths.values())
    assert stages[-1][1] == stages[-1][2] and [s[1] for s in stages] == sorted(s[1] for s in stages)
    content = json.loads(result.paths["parameters"].read_text())
    beta = content["blendshapes"]
    assert tuple(beta) == result.fit.rig.names and "neutral" not in beta
    assert all(0 <= weight <= 1 for weight in beta.values())
    np.testing.assert_allclose(content["identity_weights"], result.fit.identity_weights)
    assert content["reprojection_iod"] < 0.06
    from facewright.io.obj import read_obj

    mesh = read_obj(result.paths["obj"])
    np.testing.assert_allclose(mesh.vertices, result.fit.vertices, atol=1e-4)
    assert read_image(result.paths["texture"]).shape == (64, 64, 3)
    from facewright.io.gltf import read_gltf

    (rig,) = read_gltf(result.paths["glb"]).meshes
    np.testing.assert_allclose(rig.weights, result.fit.blendshape_weights, atol=1e-6)  # opens as in the photo


def test_written_landmarks_can_be_corrected_and_given_again(files, tmp_path):
    result = fit_photo(request(files, tmp_path))
    again = fit_photo(request(files, tmp_path, landmarks=result.paths["landmarks"]))
    np.testing.assert_allclose(again.fit.identity_weights, result.fit.identity_weights, atol=1e-4)
    content = json.loads(again.paths["landmarks"].read_text())
    content["points"][45][0] += 3.0
    again.paths["landmarks"].write_text(json.dumps(content))
    moved = fit_photo(request(files, tmp_path, landmarks=again.paths["landmarks"]))
    assert moved.fit.landmarks.points[45, 0] - again.fit.landmarks.points[45, 0] == pytest.approx(3.0)


def test_a_failure_late_keeps_the_old_results(files, tmp_path, monkeypatch):
    fit_photo(request(files, tmp_path / "out"))
    (tmp_path / "out" / "notes.txt").write_text("mine")
    before = {path.name: path.read_bytes() for path in (tmp_path / "out").iterdir()}

    def interrupted(*_):
        raise KeyboardInterrupt

    monkeypatch.setattr("facewright.apps.fit_photo.overlay_picture", interrupted)
    for out in ("out", "new/er"):
        with pytest.raises(KeyboardInterrupt):
            fit_photo(request(files, tmp_path / out, perspective=False))
    assert {path.name: path.read_bytes() for path in (tmp_path / "out").iterdir()} == before
    assert [path.name for path in tmp_path.iterdir()] == ["out"]


def test_fit_exports_as_a_person(files, tmp_path):
    from facewright.apps.export_person import ExportPersonRequest, export_person

    result = fit_photo(request(files, tmp_path))
    exported = export_person(
        ExportPersonRequest(tmp_path / "person.glb", model=files.model, fit=result.paths["parameters"])
    )
    assert exported.n_bytes > 10_000


def test_a_fit_with_another_model_of_equal_size_is_refused(files, tmp_path):
    from facewright.apps.build_model import BuildModelRequest, build_model
    from facewright.apps.export_person import ExportPersonRequest, export_person

    paths = [tmp_path / f"{seed}.fwbm" for seed in (1, 2)]
    models = [
        build_model(BuildModelRequest(path, "builtin", 3, 3, 4, seed, skin_only=True, n_unseen=0)).model
        for seed, path in enumerate(paths)
    ]
    assert models[0].topology.fingerprint == models[1].topology.fingerprint
    fit = fit_photo(replace(request(files, tmp_path / "fit"), model=paths[0])).paths["parameters"]
    export_person(ExportPersonRequest(tmp_path / "a.glb", model=paths[0], fit=fit))
    with pytest.raises(FileFormatError) as error:
        export_person(ExportPersonRequest(tmp_path / "b.glb", model=paths[1], fit=fit))
    assert all(word in str(error.value) for word in (models[0].model_id, models[1].model_id, "fit.json", "2.fwbm"))
    assert not (tmp_path / "b.glb").exists()


def test_weak_perspective_writes_no_pinhole(files, tmp_path):
    result = fit_photo(request(files, tmp_path, perspective=False))
    assert json.loads(result.paths["parameters"].read_text())["pinhole"] is None


@pytest.mark.landmarks
def test_points_of_a_file_win_over_detected_ones(files, tmp_path):
    pytest.importorskip("mediapipe")
    points, confidence = np.full((74, 2), np.nan), np.zeros(74)
    points[45], confidence[45] = files.landmarks.points[45], 1.0
    write_landmarks(tmp_path / "one.json", Landmarks("fw74", points, confidence))
    result = fit_photo(request(files, tmp_path / "out", landmarks=tmp_path / "one.json", detect=True))
    np.testing.assert_allclose(result.fit.landmarks.points[45], points[45], atol=1e-5)
    assert result.n_faces == 1 and result.fit.landmarks.present.all()


@pytest.mark.landmarks
def test_no_face_and_too_few_faces(files, tmp_path):
    pytest.importorskip("mediapipe")
    write_image(tmp_path / "grey.png", np.full((640, 640, 3), 128, np.uint8))
    with pytest.raises(NoFaceError, match=r"grey\.png"):
        fit_photo(FitPhotoRequest(tmp_path / "grey.png", files.model, tmp_path / "out"))
    with pytest.raises(NoFaceError, match="at least 4"):
        fit_photo(FitPhotoRequest(files.photo, files.model, tmp_path / "out", face_index=3))
    assert not (tmp_path / "out").exists()
    # points alone are enough where the detector sees nothing
    result = fit_photo(
        FitPhotoRequest(tmp_path / "grey.png", files.model, tmp_path / "out", landmarks=files.points, texture_size=32)
    )
    assert result.n_faces == 0


def test_refuses_bad_input_and_leaves_nothing(files, tmp_path):
    out = tmp_path / "out"
    with pytest.raises(StoreError, match=r"none\.png"):
        fit_photo(FitPhotoRequest(tmp_path / "none.png", files.model, out))
    (tmp_path / "cut.png").write_bytes(files.photo.read_bytes()[:400])
    with pytest.raises(FileFormatError, match=r"cut\.png"):
        fit_photo(FitPhotoRequest(tmp_path / "cut.png", files.model, out))
    with pytest.raises(FileFormatError, match=r"photo\.png"):
        fit_photo(FitPhotoRequest(files.photo, files.photo, out, landmarks=files.points, detect=False))
    (tmp_path / "bad.pts").write_text("version: 1\nn_points: 1\n{\nnan nan\n}\n")
    with pytest.raises(FileFormatError, match=r"bad\.pts"):
        fit_photo(request(files, out, landmarks=tmp_path / "bad.pts"))
    assert not out.exists()
    blocked = tmp_path / "file"
    blocked.write_text("")
    with pytest.raises(StoreError, match="folder"):
        fit_photo(request(files, blocked / "out"))
    few = np.zeros(74)
    few[:20] = 1
    write_landmarks(tmp_path / "few.json", Landmarks("fw74", files.landmarks.points, few))
    with pytest.raises(DegenerateError, match="10 landmarks"):
        fit_photo(request(files, out, landmarks=tmp_path / "few.json"))
    assert not out.exists()


@pytest.mark.parametrize(
    "options", [{"detect": False}, {"face_index": -1}, {"texture_size": 4}, {"texture_size": 100_000}]
)
def test_requests_are_checked(tmp_path, options):
    with pytest.raises(ValueRangeError):
        FitPhotoRequest(tmp_path / "a.png", tmp_path / "m.fwbm", tmp_path, **options)
