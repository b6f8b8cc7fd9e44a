import dataclasses
import json

import numpy as np
import pytest

from facewright.apps.fit_scan import FitScanRequest, check_fit, fit_scan, read_scan
from facewright.camera.rotation import rotation_from_vector
from facewright.errors import DegenerateError, FileFormatError, NoFaceError, StoreError, ValueRangeError
from facewright.io.image import read_image
from facewright.io.obj import read_obj, write_obj
from facewright.io.ply import write_ply
from facewright.mesh.closest_point import closest_points


@pytest.fixture(scope="module")
def scanned(builtin_face, tmp_path_factory):
    """A person's head in centimetres, turned and moved, with noise and vertex colours, its 68 points beside it."""
    rng = np.random.default_rng(8)
    folder = tmp_path_factory.mktemp("scan")
    face = builtin_face.skin()
    person = face.mean_shape + np.tensordot(rng.normal(size=len(face.identity_basis)), face.identity_basis, 1)
    R, t = rotation_from_vector([0.4, 2.0, -0.7]), np.array([10.0, 200.0, -35.0])
    true = 0.1 * person @ R.T + t
    front = (person[face.topology.faces][..., 2] > -40).all(axis=1)
    scan = true + 0.02 * rng.normal(size=true.shape)
    colours = np.full(true.shape, 150, np.uint8)
    colours[:, 0] = 220
    write_ply(folder / "head.ply", scan, face.topology.faces[front], vertex_colors=colours)
    points = true[face.topology.landmarks["ibug68"]]
    np.savetxt(folder / "points.csv", points, delimiter=",")
    return folder, true, R


@pytest.fixture(scope="module")
def fitted(scanned):
    folder = scanned[0]
    request = FitScanRequest(folder / "head.ply", folder / "out", landmarks=folder / "points.csv", texture_size=128)
    stages = []
    return fit_scan(request, lambda *s: stages.append(s)), stages


def test_the_mesh_lies_on_the_scan_in_its_unit(builtin_face, scanned, fitted):
    true = scanned[1]
    result, stages = fitted
    mesh = read_obj(result.paths["obj"])
    assert mesh.n_vertices == builtin_face.topology.n_vertices
    region = builtin_face.topology.masks["face_region"]
    away = closest_points(true, builtin_face.skin().topology.faces, mesh.vertices[region]).distances
    assert np.sqrt((away**2).mean()) < 0.1  # centimetres
    assert np.sqrt(((mesh.vertices[region] - true[region]) ** 2).sum(axis=1).mean()) < 0.25
    assert stages[-1] == ("done", 6, 6)


def test_the_parameters_say_how_the_frames_relate(builtin_face, scanned, fitted):
    R = scanned[2]
    result, _ = fitted
    parameters = json.loads(result.paths["parameters"].read_text())
    assert parameters["unit"] == "cm"
    assert parameters["mesh_unit"] == "cm" and parameters["mesh_frame"] == "scan"
    s = parameters["scan_from_model"]
    assert s["scale"] == pytest.approx(0.1)
    moved = s["scale"] * result.vertices @ np.transpose(s["rotation"]) + s["translation"]
    np.testing.assert_allclose(read_obj(result.paths["obj"]).vertices, moved, atol=1e-4)
    turn = np.transpose(R) @ s["rotation"]
    assert np.rad2deg(np.arccos(np.clip((np.trace(turn) - 1) / 2, -1, 1))) < 3.0
    assert parameters["residuals"]["stage2_rms_mm"] < 0.5
    assert parameters["landmarks"]["from"].endswith("points.csv")
    assert set(result.paths) == {"obj", "texture", "picture", "parameters", "landmarks"}
    colour = np.median(read_image(result.paths["texture"]).reshape(-1, 3), axis=0)
    np.testing.assert_allclose(colour, [220, 150, 150], atol=2)
    assert read_image(result.paths["picture"]).shape[1] > 1000


def test_its_landmarks_can_be_given_again(builtin_face, scanned, fitted):
    folder = scanned[0]
    first, _ = fitted
    again = fit_scan(
        FitScanRequest(
            folder / "head.ply", folder / "again", landmarks=first.paths["landmarks"], frame="model", texture_size=32
        )
    )
    region = builtin_face.topology.masks["face_region"]
    difference = (again.scan_from_model.apply(again.vertices) - first.scan_from_model.apply(first.vertices))[region]
    assert np.abs(difference).max() < 0.1  # centimetres
    np.testing.assert_allclose(read_obj(again.paths["obj"]).vertices, again.vertices, atol=1e-3)  # upright, mm


@pytest.mark.parametrize(
    ("change", "error", "message"),
    [
        ({"unit": "m"}, ValueRangeError, "size of a mean face"),
        ({"mesh": "nothing.ply"}, StoreError, "nothing.ply"),
        ({"mesh": "head.stl"}, FileFormatError, r"\.obj or \.ply"),
        ({"landmarks": "nothing.csv"}, StoreError, "nothing.csv"),
        ({"landmarks": "four.csv"}, FileFormatError, "74, 68 or 5"),
        ({"landmarks": "elsewhere.csv"}, NoFaceError, "surface around the landmarks"),
        ({"landmarks": "shuffled.csv"}, NoFaceError, "as those of a face"),
        ({"landmarks": "flat.csv"}, FileFormatError, "74, 68 or 5"),
        ({"texture": "points.csv"}, FileFormatError, "texture coordinates"),
    ],
)
def test_nonsense_is_refused_and_nothing_written(scanned, tmp_path, change, error, message):
    folder = scanned[0]
    points = np.loadtxt(folder / "points.csv", delimiter=",")
    np.savetxt(folder / "four.csv", points[:4], delimiter=",")
    np.savetxt(folder / "elsewhere.csv", points + 100.0, delimiter=",")
    np.savetxt(folder / "shuffled.csv", points[::-1], delimiter=",")
    np.savetxt(folder / "flat.csv", points[:, :2], delimiter=",")
    paths = {key: folder / value if key != "unit" else value for key, value in change.items()}
    request = FitScanRequest(folder / "head.ply", tmp_path / "out", landmarks=folder / "points.csv")
    with pytest.raises(error, match=message):
        fit_scan(dataclasses.replace(request, **paths))
    assert not (tmp_path / "out").exists()


def test_a_cloud_of_points_is_refused(tmp_path, rng):
    write_ply(tmp_path / "cloud.ply", rng.normal(size=(500, 3)))
    with pytest.raises(FileFormatError, match="without triangles"):
        read_scan(tmp_path / "cloud.ply")


def test_a_soup_of_triangles_is_refused_at_once(tmp_path, rng):
    write_obj(tmp_path / "soup.obj", 80 * rng.normal(size=(3000, 3)), rng.integers(0, 3000, (9000, 3)))
    with pytest.raises(DegenerateError, match="form a surface"):
        fit_scan(FitScanRequest(tmp_path / "soup.obj", tmp_path / "out"))


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"matched_share": 0.2}, "20 %"),
        ({"stage2_rms_mm": 3.0}, r"3\.0 mm"),
        ({"stage2_rms_mm": float("nan")}, "nan mm"),
        ({"landmark_rms_mm": 12.0}, r"12\.0 mm"),
    ],
)
def test_a_bad_fit_is_no_fit(fitted, change, message):
    fit = fitted[0].fit
    check_fit(fit)
    with pytest.raises(NoFaceError, match=message):
        check_fit(dataclasses.replace(fit, report=fit.report | change))


@pytest.mark.parametrize("change", [{"unit": "ell"}, {"frame": "world"}, {"region": "hand"}, {"texture_size": 5}])
def test_options_are_checked(tmp_path, change):
    with pytest.raises(ValueRangeError):
        FitScanRequest(tmp_path / "a.obj", tmp_path, **change)


@pytest.mark.landmarks
@pytest.mark.slow
def test_the_james_scan(test_data, tmp_path):
    """A real 3dMD scan with hand-placed points: only eyes and mouth of both schemes are at the same place."""
    pytest.importorskip("mediapipe")
    from facewright.faces import load_face
    from facewright.io.points import read_points

    result = fit_scan(FitScanRequest(test_data / "scans" / "james.obj", tmp_path / "out", texture_size=256))
    assert result.found.placement.unit == "mm"
    assert float(result.fit.report["stage2_rms_mm"]) < 0.4
    assert float(result.fit.report["matched_share"]) > 0.7
    by_hand = read_points(test_data / "scans" / "james.ljson").points
    ours = read_obj(result.paths["obj"]).vertices[load_face("builtin").topology.landmarks["ibug68"]]
    for part, most in ((slice(36, 48), 4.0), (slice(48, 68), 4.0)):
        assert np.sqrt(((ours - by_hand)[part] ** 2).sum(axis=1).mean()) < most


@pytest.mark.landmarks
@pytest.mark.slow
def test_meshmonks_demo_face_with_its_five_points(test_data, tmp_path):
    pytest.importorskip("mediapipe")
    folder = test_data / "meshmonk"
    request = FitScanRequest(
        folder / "DemoFace_10K.obj", tmp_path / "out", landmarks=folder / "DemoFaceLandmarks.csv", texture_size=256
    )
    result = fit_scan(request)
    assert float(result.fit.report["stage2_rms_mm"]) < 0.5
    assert float(result.fit.report["matched_share"]) > 0.7
    assert "texture" not in result.paths
