import json
from pathlib import Path

import numpy as np
import pytest

from facewright.apps import simulate_captures as module
from facewright.apps.simulate_captures import SimulateCapturesRequest, simulate_captures
from facewright.capture.captures import find_sidecar, list_captures
from facewright.capture.recording import open_recording
from facewright.capture.simulated_kinect import KINECT_INTRINSICS
from facewright.errors import MissingFaceError, StoreError, ValueRangeError
from facewright.landmarks.files import read_landmarks

EXPRESSIONS = ("neutral", "smile")


@pytest.fixture(scope="module")
def written(tmp_path_factory):
    out = tmp_path_factory.mktemp("simulated") / "new" / "captures"
    calls = []
    result = simulate_captures(
        SimulateCapturesRequest(out, 2, n_frames=3, expressions=EXPRESSIONS, seed=5, landmarks="refined", truth=True),
        lambda *call: calls.append(call),
    )
    return result, calls


def test_captures_are_in_the_layout_that_build_reads(written):
    result, calls = written
    subjects = list_captures(result.out)
    assert [s.name for s in subjects] == list(result.subjects) == ["person-000", "person-001"]
    assert all(not s.problems and list(s.recordings) == list(EXPRESSIONS) for s in subjects)
    assert all("age" in s.attributes and "simulated" in s.attributes for s in subjects)
    assert [call[1:] for call in calls] == [(k, 4) for k in (1, 2, 3, 4)]
    assert (result.n_recordings, result.n_frames) == (4, 12)
    size = sum(f.stat().st_size for f in Path(result.out).rglob("*") if f.is_file())
    assert result.n_bytes == size


def test_recordings_read_back_as_a_kinects(written):
    recording = open_recording(written[0].out / "person-000" / "smile")
    assert recording.n_frames == 3 and recording.size == (480, 640)
    assert recording.intrinsics == KINECT_INTRINSICS
    assert not recording.warnings
    frame = recording.frame(1)
    assert frame.time == pytest.approx(1 / 30, abs=1e-5)
    assert 450.0 < frame.depth[frame.depth > 0].min() < 700.0
    files = list((written[0].out / "person-000" / "smile").rglob("*.*"))
    assert sum(f.stat().st_size for f in files) / 3 < 400e3  # 3 people x 20 expressions x 24 frames: about 0.4 GB


def test_truth_fits_the_recordings(written, builtin_face):
    out = written[0].out
    truth = np.load(out / "person-001" / "truth.npz")
    assert truth["expressions"].tolist() == list(EXPRESSIONS)
    V = builtin_face.topology.n_vertices
    assert truth["meshes"].shape == (2, V, 3) and truth["camera_from_model"].shape == (2, 3, 3, 4)
    posed = truth["neutral"] + np.tensordot(truth["weights"][1], truth["blendshape_deltas"], 1)
    np.testing.assert_allclose(truth["meshes"][1], posed, atol=1e-3)
    # The tip of the nose, in the camera, is where the sensor saw a surface.
    tip = truth["meshes"][1][builtin_face.topology.landmarks["fw74"][45]]
    motion = truth["camera_from_model"][1, 0]
    seen = motion[:, :3] @ tip + motion[:, 3]
    u, v = np.rint(KINECT_INTRINSICS.project(seen)).astype(int)
    depth = open_recording(out / "person-001" / "smile").frame(0).depth[v - 4 : v + 5, u - 4 : u + 5]
    assert abs(np.median(depth[depth > 0]) - seen[2]) < 6.0


def test_refined_points_are_about_a_pixel_off(written, builtin_face):
    errors = []
    for name in written[0].subjects:
        truth = np.load(written[0].out / name / "truth.npz")
        for k, expression in enumerate(EXPRESSIONS):
            frame, path = find_sidecar(written[0].out / name / expression)
            assert frame == 0
            points = read_landmarks(path)
            motion = truth["camera_from_model"][k, 0]
            ids = builtin_face.topology.landmarks["fw74"]
            inner = points.definition.fixed
            seen = truth["meshes"][k][ids[inner]] @ motion[:, :3].T + motion[:, 3]
            errors.append(points.points[inner] - KINECT_INTRINSICS.project(seen))
    assert 0.85 < np.concatenate(errors).std() < 1.15


def test_a_person_does_not_depend_on_who_else_is_asked_for(written, tmp_path):
    alone = SimulateCapturesRequest(tmp_path / "a", 1, n_frames=3, expressions=("smile",), seed=5)
    simulate_captures(alone)
    for kind in ("rgb", "depth"):
        mine, theirs = (
            sorted((root / "person-000" / "smile" / kind).iterdir()) for root in (tmp_path / "a", written[0].out)
        )
        assert [f.read_bytes() for f in mine] == [f.read_bytes() for f in theirs]
    assert not list((tmp_path / "a").rglob("landmarks-*")) and not list((tmp_path / "a").rglob("truth*"))


def test_nothing_is_overwritten(written):
    out = written[0].out
    before = (out / "person-000" / "subject.json").read_text()
    with pytest.raises(StoreError, match=r"holds person-000 already and captures are not overwritten"):
        simulate_captures(SimulateCapturesRequest(out, 1, n_frames=2, expressions=("neutral",)))
    assert (out / "person-000" / "subject.json").read_text() == before
    assert json.loads(before)["simulated"] is True


def test_a_subject_appears_whole_or_not_at_all(tmp_path, monkeypatch):
    def fail(*_):
        raise KeyboardInterrupt

    monkeypatch.setattr(module, "refined_landmarks", fail)
    out = tmp_path / "captures"
    with pytest.raises(KeyboardInterrupt):
        simulate_captures(SimulateCapturesRequest(out, 1, n_frames=1, expressions=("neutral",), landmarks="refined"))
    assert not out.exists()


def test_refuses_bad_input(tmp_path):
    for wrong, sentence in (
        ({"n_subjects": 0}, "n_subjects"),
        ({"n_frames": 0}, "n_frames"),
        ({"expressions": ()}, "expressions"),
        ({"expressions": ("smile", "smile")}, "once"),
        ({"expressions": ("grimace",)}, "grimace"),
        ({"landmarks": "perfect"}, "landmarks"),
    ):
        with pytest.raises(ValueRangeError, match=sentence):
            SimulateCapturesRequest(tmp_path, **wrong)
    (tmp_path / "file").write_text("")
    with pytest.raises(StoreError, match="must be a folder"):
        simulate_captures(SimulateCapturesRequest(tmp_path / "file"))
    with pytest.raises(MissingFaceError):
        simulate_captures(SimulateCapturesRequest(tmp_path / "x", face="nobody"))
    assert not (tmp_path / "x").exists()
