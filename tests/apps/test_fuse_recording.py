"""A recording fused on its own: the files against the simulated truth, and every way it can be refused."""

import json
import shutil

import numpy as np
import pytest
from PIL import Image

from facewright.apps.fuse_recording import FuseRecordingRequest, fuse_recording
from facewright.apps.simulated_recording import simulate_recording
from facewright.apps.simulated_subject import simulate_capture_subject
from facewright.camera.depth_map import back_project
from facewright.capture.camera_file import read_camera_file
from facewright.capture.tum_writer import write_tum_recording
from facewright.errors import DegenerateError, FacewrightError, FileFormatError, NoFaceError, ValueRangeError
from facewright.io.obj import read_obj
from facewright.io.ply import read_ply
from facewright.landmarks.files import write_landmarks
from facewright.landmarks.points import Landmarks
from facewright.mesh.closest_point import closest_points

N_FRAMES = 7


@pytest.fixture(scope="module")
def simulated(builtin_face):
    """A simulated Kinect's recording of a neutral face."""
    rng = np.random.default_rng(5)
    subject = simulate_capture_subject(builtin_face, rng, glasses=False)
    return simulate_recording(subject, np.zeros(46), rng, n_frames=N_FRAMES, turn_degrees=8.0)


@pytest.fixture(scope="module")
def recording(simulated, tmp_path_factory):
    """The same on disk, without landmarks."""
    folder = tmp_path_factory.mktemp("captures") / "neutral"
    write_tum_recording(folder, simulated.frames())
    return folder


@pytest.fixture(scope="module")
def marked(simulated, recording, tmp_path_factory):
    """The same with true landmarks of frame 2 beside it."""
    folder = tmp_path_factory.mktemp("marked") / "neutral"
    shutil.copytree(recording, folder)
    write_landmarks(folder / "landmarks-2.json", simulated.true_landmarks(2))
    return folder


@pytest.fixture(scope="module")
def fitted(marked, tmp_path_factory):
    """The marked recording with a mesh, and the stages of its progress."""
    out, stages = tmp_path_factory.mktemp("out") / "a" / "fused", []
    result = fuse_recording(FuseRecordingRequest(marked, out, mesh=True), lambda *step: stages.append(step))
    return result, out, stages


def test_depth_and_camera_read_back_as_the_truth(fitted, simulated):
    result, out, _ = fitted
    camera = read_camera_file(out)
    depth = np.asarray(Image.open(out / "depth.png")).astype(float) * 1000.0 / camera.depth_per_metre
    assert Image.open(out / "depth.png").mode.startswith("I") and depth.shape == camera.size == (480, 640)
    assert np.abs(depth - result.fused.depth).max() <= 0.11  # mm: steps of 0.2
    truth = simulated.true_depth(2)
    k = camera.intrinsics
    assert (k.focal_x, k.focal_y, k.centre_x, k.centre_y) == (575.8, 575.8, 319.5, 239.5)
    points = simulated.true_landmarks(2).points
    low, high = points.min(axis=0).astype(int), points.max(axis=0).astype(int)
    face = np.s_[low[1] : high[1], low[0] : high[0]]
    seen = (depth[face] > 0) & (truth[face] > 0)
    assert seen.mean() > 0.7
    assert np.median(np.abs(depth - truth)[face][seen]) < 1.5  # mm
    raw = simulated.frame(2).depth[face]
    both = seen & (raw > 0)
    assert np.abs(depth - truth)[face][both].mean() < 0.8 * np.abs(raw - truth[face])[both].mean()
    assert np.array_equal(np.asarray(Image.open(out / "color.png")), result.fused.color)


def test_the_report_says_all(fitted, marked):
    result, out, _ = fitted
    facts = json.loads((out / "report.json").read_text())
    assert facts == result.facts
    assert facts["recording"] == str(marked) and facts["kind"] == "tum" and facts["engine"] == "numba"
    assert facts["reference_frame"] == 2 and facts["quarter_turns"] == 0
    report = facts["fusion"]
    assert report["n_frames"] == report["n_fused"] == N_FRAMES and report["lost"] == []
    assert report["raw_noise_mm"] > 0.3 and report["coverage"] > 0.8 and 5 < report["turn_degrees"] < 20
    assert facts["landmarks"]["from"] == "sidecar" and facts["landmarks"]["found"] == 74
    assert np.shape(facts["landmarks"]["points"]) == (74, 2)
    left, top, right, bottom = facts["rectangle"]
    assert 0 <= left < right <= 640 and 0 <= top < bottom <= 480
    assert facts["mesh"]["face"] == "builtin" and facts["mesh"]["residuals"]["stage2_rms_mm"] < 1.5


def test_points_lie_on_the_depth_with_normals_towards_the_camera(fitted):
    result, out, _ = fitted
    cloud = read_ply(out / "points.ply")
    assert len(cloud.faces) == 0 and len(cloud.vertices) > 5000
    pixels = np.rint(result.fused.intrinsics.project(cloud.vertices.astype(float))).astype(int)
    assert np.allclose(result.fused.depth[pixels[:, 1], pixels[:, 0]], cloud.vertices[:, 2])
    assert np.array_equal(result.fused.color[pixels[:, 1], pixels[:, 0]], cloud.vertex_colors)
    assert np.allclose(np.linalg.norm(cloud.normals, axis=1), 1.0, atol=1e-5)
    assert ((cloud.normals * cloud.vertices).sum(axis=1) < 0).mean() > 0.99


def test_the_mesh_lies_on_the_points_and_on_the_truth(fitted, simulated, builtin_face, tmp_path):
    result, out, _ = fitted
    mesh = read_obj(out / "face.obj")
    assert len(mesh.vertices) == builtin_face.topology.n_vertices and mesh.uv is not None
    assert np.abs(mesh.vertices - result.fit.target_from_model.apply(result.vertices)).max() < 1e-3
    region = builtin_face.topology.masks["face_region"]
    true = simulated.camera_from_model[2].apply(simulated.vertices)[: builtin_face.n_skin]
    distances = closest_points(true, builtin_face.skin().topology.faces, mesh.vertices[region]).distances
    assert np.sqrt((distances**2).mean()) < 1.6  # mm
    points = back_project(result.fused.depth, result.fused.intrinsics)
    assert abs(np.median(mesh.vertices[:, 2]) - np.nanmedian(points[..., 2])) < 80


def test_pictures_and_progress(fitted):
    result, out, stages = fitted
    sheet, errors = (np.asarray(Image.open(out / name)) for name in ("fusion.png", "fit.png"))
    assert sheet.shape[0] > 500 and sheet.shape[1] > sheet.shape[0] and sheet.std() > 20
    assert errors.shape[0] > 400 and errors.std() > 20
    assert {"opening", "reading frames", "writing"} < {stage for stage, _, _ in stages}
    assert all(0 <= done <= total for _, done, total in stages)
    assert sorted(p.name for p in out.iterdir()) == sorted(p.name for p in result.paths.values())
    assert set(result.paths) == {"depth", "camera", "color", "report", "points", "picture", "mesh", "errors"}


def test_without_detector_the_depth_tells_the_face(recording, tmp_path):
    result = fuse_recording(FuseRecordingRequest(recording, tmp_path / "o", detect=False))
    assert result.landmarks is None and result.fit is None and "mesh" not in result.paths
    facts = json.loads((tmp_path / "o" / "report.json").read_text())
    assert facts["landmarks"] == {"from": "none", "scheme": "fw74", "found": 0, "points": None}
    assert "by the depth alone" in facts["warnings"][0] and facts["fusion"]["coverage"] > 0.8
    assert not (tmp_path / "o" / "face.obj").exists()


def test_an_absent_detector_is_told_and_the_mesh_needs_it(recording, tmp_path, monkeypatch):
    from facewright.errors import MissingExtraError
    from facewright.landmarks import detector

    def absent(*args, **options):
        raise MissingExtraError('landmarks need MediaPipe: pip install "facewright[landmarks]".')

    monkeypatch.setattr(detector, "open_detector", absent)
    result = fuse_recording(FuseRecordingRequest(recording, tmp_path / "o"))
    assert "facewright[landmarks]" in result.facts["warnings"][0]
    with pytest.raises(NoFaceError, match=r"facewright\[landmarks\]"):
        fuse_recording(FuseRecordingRequest(recording, tmp_path / "mesh", mesh=True))
    assert not (tmp_path / "mesh").exists()


class _Detector:
    """Finds one face, or none."""

    def __init__(self, found):
        self.found = found

    def detect(self, image):
        return self.found


def test_detected_landmarks_choose_the_face(recording, simulated, tmp_path):
    detector = _Detector([simulated.true_landmarks(0)])
    result = fuse_recording(FuseRecordingRequest(recording, tmp_path / "o"), detector=detector)
    assert result.facts["landmarks"]["from"] == "detector" and result.facts["landmarks"]["found"] == 74


def test_no_face(recording, tmp_path):
    with pytest.raises(NoFaceError, match="detector found none"):
        fuse_recording(FuseRecordingRequest(recording, tmp_path / "o"), detector=_Detector([]))
    assert not (tmp_path / "o").exists()


def test_landmarks_that_are_all_missing_are_none(recording, tmp_path):
    folder = tmp_path / "neutral"
    shutil.copytree(recording, folder)
    write_landmarks(folder / "landmarks-1.json", Landmarks("fw74", np.full((74, 2), np.nan), np.zeros(74)))
    request = FuseRecordingRequest(folder, tmp_path / "o", detect=False, mesh=True)
    with pytest.raises(NoFaceError, match="a mesh needs landmarks"):
        fuse_recording(request)
    assert not (tmp_path / "o").exists()


def test_model_space_is_upright(fitted, marked, builtin_face, tmp_path, monkeypatch):
    from facewright.apps import fuse_recording as module
    from facewright.apps import scan_pictures

    result, _, _ = fitted
    monkeypatch.setattr(module, "_fit", lambda *args: (result.fit, result.vertices))
    monkeypatch.setattr(scan_pictures, "fit_pictures", lambda *args, **options: [result.fused.color] * 7)
    fuse_recording(FuseRecordingRequest(marked, tmp_path / "o", mesh=True, frame="model"))
    mesh = read_obj(tmp_path / "o" / "face.obj")
    assert np.abs(mesh.vertices - result.vertices).max() < 1e-3
    assert np.abs(mesh.vertices - builtin_face.mean_shape).mean() < 10.0  # mm


def test_the_turn_must_be_that_of_the_landmarks(marked, tmp_path):
    with pytest.raises(ValueRangeError, match="quarter_turns must be 0 or left out, got 1"):
        fuse_recording(FuseRecordingRequest(marked, tmp_path / "o", quarter_turns=1))


def test_a_recording_is_not_written_over(recording, marked):
    before = sorted(p.name for p in recording.iterdir())
    for out in (recording, marked):
        with pytest.raises(ValueRangeError, match="folder of its own"):
            fuse_recording(FuseRecordingRequest(recording, out, detect=False))
    assert sorted(p.name for p in recording.iterdir()) == before


@pytest.mark.parametrize("options", [{"engine": "nonsense"}, {"frame": "nonsense"}, {"quarter_turns": 4}])
def test_requests_that_cannot_be(options, tmp_path):
    with pytest.raises(FacewrightError, match=next(iter(options))):
        FuseRecordingRequest(tmp_path, tmp_path / "o", **options)


def test_depth_of_nothing_is_refused(recording, tmp_path):
    from facewright.io.frame_image import encode_depth

    folder = tmp_path / "neutral"
    shutil.copytree(recording, folder)
    for file in (folder / "depth").iterdir():
        file.write_bytes(encode_depth(np.zeros((480, 640), np.uint16)))
    with pytest.raises((FileFormatError, NoFaceError), match="depth"):
        fuse_recording(FuseRecordingRequest(folder, tmp_path / "o", detect=False))
    assert not (tmp_path / "o").exists()


def test_frames_of_different_things_are_refused(simulated, tmp_path, rng):
    frames = list(simulated.frames())
    for frame in frames[:2] + frames[3:]:
        frame.depth[:] = rng.uniform(400, 1500, frame.depth.shape)
    write_tum_recording(tmp_path / "neutral", frames)
    write_landmarks(tmp_path / "neutral" / "landmarks-2.json", simulated.true_landmarks(2))
    with pytest.raises(DegenerateError, match="held expression"):
        fuse_recording(FuseRecordingRequest(tmp_path / "neutral", tmp_path / "o"))
    assert not (tmp_path / "o").exists()


@pytest.mark.slow
def test_open3d_fuses_the_same_surface(fitted, marked, tmp_path):
    pytest.importorskip("open3d", reason="needs the capture extra")
    other = fuse_recording(FuseRecordingRequest(marked, tmp_path / "o", engine="open3d"))
    assert other.facts["engine"] == "open3d"
    a, b = fitted[0].fused.depth, other.fused.depth
    both = (a > 0) & (b > 0)
    assert both.sum() > 0.8 * (a > 0).sum() and np.median(np.abs(a - b)[both]) < 0.5


@pytest.mark.landmarks
def test_the_real_mannequin_becomes_a_mesh(test_data, tmp_path):
    """A phone's recording on its side: turned, fused and fitted by one call."""
    pytest.importorskip("mediapipe", reason="needs the landmarks extra")
    pytest.importorskip("skimage", reason="needs the landmarks extra")
    request = FuseRecordingRequest(test_data / "truedepth_mannequin", tmp_path / "o", mesh=True)
    result = fuse_recording(request)
    report = result.fused.report
    assert result.facts["quarter_turns"] == 3 and result.facts["landmarks"]["from"] == "detector"
    assert report.n_fused == 30 and report.coverage > 0.95 and report.drift_mm < 1.0
    assert result.fit.report["matched_share"] > 0.6 and result.fit.report["stage2_rms_mm"] < 0.4
    assert Image.open(tmp_path / "o" / "color.png").size == (240, 320)
    assert len(read_ply(tmp_path / "o" / "points.ply").vertices) > 15_000
