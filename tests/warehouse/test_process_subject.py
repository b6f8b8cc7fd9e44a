import json
import os
import shutil
import subprocess
import sys

import numpy as np
import pytest

from facewright.capture.captures import list_captures
from facewright.errors import (
    DegenerateError,
    FileFormatError,
    MissingExtraError,
    StoreError,
    ValueRangeError,
)
from facewright.mesh.closest_point import closest_points
from facewright.numeric.similarity import estimate_similarity
from facewright.numeric.threads import thread_environment
from facewright.warehouse.process_subject import STAGES, ProcessOptions, process_subject, process_timed

ACTED = ("neutral", "mouth_stretch", "smile", "eyes_closed")
OPTIONS = ProcessOptions(face="builtin", least_expressions=2)


@pytest.fixture(scope="module")
def captures(tmp_path_factory):
    """One simulated person who acts four expressions, with landmarks refined by hand; the smile is damaged."""
    from facewright.apps.simulate_captures import SimulateCapturesRequest, simulate_captures

    root = tmp_path_factory.mktemp("captures")
    request = SimulateCapturesRequest(
        out=root, n_subjects=1, face="builtin", n_frames=3, expressions=ACTED, seed=5, landmarks="refined", truth=True
    )
    simulate_captures(request)
    picture = sorted((root / "person-000" / "smile" / "depth").glob("*.png"))[1]
    picture.write_bytes(picture.read_bytes()[:2000])
    return root


@pytest.fixture(scope="module")
def processed(captures):
    """The subject, made on a machine without MediaPipe."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setitem(sys.modules, "mediapipe", None)
        seen = []
        result = process_timed(list_captures(captures)[0], OPTIONS, lambda *step: seen.append(step))
    assert seen == [*((name, i, 4) for i, name in enumerate(ACTED)), ("blendshapes", 4, 4)]
    return result


def copied(captures, tmp_path, *kept):
    """A copy with some expressions only."""
    shutil.copytree(captures, tmp_path / "c")
    for entry in (tmp_path / "c" / "person-000").iterdir():
        if entry.is_dir() and entry.name not in kept:
            shutil.rmtree(entry)
    return list_captures(tmp_path / "c")[0]


def test_a_subject_has_all_it_should(processed, captures, builtin_face):
    subject, V = processed.subject, builtin_face.topology.n_vertices
    assert subject.name == "person-000"
    assert subject.expressions[0] == "neutral"
    assert set(subject.expressions) == set(ACTED) - {"smile"}
    assert subject.meshes.shape == (3, V, 3)
    assert subject.blendshapes.shape == (47, V, 3)
    assert np.array_equal(subject.blendshapes[0], subject.meshes[0])
    assert subject.depth.shape == (3, 480, 640)
    assert subject.color.shape == (3, 480, 640, 3)
    assert subject.attributes == list_captures(captures)[0].attributes
    assert subject.attributes["simulated"] is True
    assert np.isfinite(subject.landmarks).all()
    assert subject.expression_weights[0].max() == 0
    assert subject.expression_weights[1].max() > 0.3


def test_the_neutral_is_the_person_s(processed, captures, builtin_face):
    with np.load(captures / "person-000" / "truth.npz") as truth:
        neutral = truth["neutral"].astype(np.float64)
        pose = truth["camera_from_model"][0, 0]
    region, n = builtin_face.topology.masks["face_region"], builtin_face.n_skin
    ours = processed.subject.meshes[0].astype(np.float64)
    faces = builtin_face.skin().topology.faces

    def surface_mm(mesh):
        moved = estimate_similarity(mesh[region], neutral[region], with_scale=False).apply(mesh)
        return float(np.sqrt((closest_points(neutral[:n], faces, moved[region]).distances ** 2).mean()))

    assert surface_mm(ours) < 1.2
    assert surface_mm(ours) < 0.7 * surface_mm(builtin_face.mean_shape.astype(np.float64))
    # in the camera's frame without any alignment
    seen = processed.subject.camera_from_model[0]
    placed = ours @ seen[:3, :3].T + seen[:3, 3]
    true_placed = neutral @ pose[:, :3].T + pose[:, 3]
    assert np.linalg.norm((placed - true_placed)[region].mean(axis=0)) < 2.0


def test_provenance_is_json_without_times_and_tells_of_failures(processed):
    provenance = json.loads(json.dumps(processed.subject.provenance, allow_nan=False))
    assert provenance["failed"]["smile"]["kind"] == "FileFormatError"
    assert "png" in provenance["failed"]["smile"]["reason"]
    assert "jaw_left" in provenance["missing"]
    assert provenance["versions"]["facewright"]
    assert provenance["options"]["face"] == "builtin"
    neutral = provenance["expressions"]["neutral"]
    assert neutral["landmarks"] == "sidecar"
    assert neutral["reference_frame"] == 0
    assert neutral["fit"]["stage2_rms_mm"] < 1.0
    assert neutral["fusion"]["n_frames"] == 3
    text = json.dumps(provenance)
    assert "second" not in text
    assert str(processed.subject.name) not in text.replace("person-000/smile", "")
    assert set(processed.seconds) == set(STAGES)
    assert all(value > 0 for key, value in processed.seconds.items())


def test_equal_input_gives_an_equal_subject(processed, captures):
    again = process_subject(list_captures(captures)[0], OPTIONS)
    for key, value in vars(processed.subject).items():
        other = getattr(again, key)
        if isinstance(value, np.ndarray):
            assert np.array_equal(value, other, equal_nan=value.dtype.kind == "f"), key
        else:
            assert value == other, key


def test_without_a_neutral_a_subject_is_refused(captures, tmp_path):
    capture = copied(captures, tmp_path, "smile", "eyes_closed")
    with pytest.raises(FileFormatError, match="neutral"):
        process_subject(capture, OPTIONS)


def test_a_damaged_neutral_is_the_reason(captures, tmp_path):
    capture = copied(captures, tmp_path, "neutral", "eyes_closed")
    picture = sorted((capture.recordings["neutral"] / "depth").glob("*.png"))[0]
    picture.write_bytes(b"")
    with pytest.raises(FileFormatError, match="neutral of subject 'person-000' cannot be used"):
        process_subject(capture, OPTIONS)


def test_too_few_expressions_are_refused_with_the_reasons(captures, tmp_path):
    """A damaged picture and a sidecar of a frame that is not there fail their expressions only."""
    capture = copied(captures, tmp_path, "neutral", "smile", "eyes_closed")
    folder = capture.recordings["eyes_closed"]
    (folder / "landmarks-0.json").rename(folder / "landmarks-9.json")
    with pytest.raises(DegenerateError) as refused:
        process_subject(capture, OPTIONS)
    message = str(refused.value)
    assert "at least 2 usable expressions besides the neutral, got 0" in message
    assert "smile: " in message and ".png" in message
    assert "eyes_closed: " in message and "frame in [0, 3), got 9" in message


def test_without_a_detector_every_recording_needs_its_points(captures, tmp_path, monkeypatch):
    capture = copied(captures, tmp_path, "neutral", "eyes_closed")
    (capture.recordings["eyes_closed"] / "landmarks-0.json").unlink()
    monkeypatch.setitem(sys.modules, "mediapipe", None)
    with pytest.raises(MissingExtraError, match="landmarks"):
        process_subject(capture, OPTIONS)


def test_what_a_second_attempt_may_mend_is_not_an_expression_s_failure(captures, tmp_path, monkeypatch):
    from facewright.warehouse import process_subject as module

    def unreadable(name, *rest):
        raise StoreError(f"{name} cannot be read: Input/output error.") from OSError(5, "Input/output error")

    monkeypatch.setattr(module, "read_record", unreadable)
    with pytest.raises(StoreError, match="Input/output"):
        process_subject(list_captures(captures)[0], OPTIONS)


def test_options_are_checked():
    for bad in (0, 20):
        with pytest.raises(ValueRangeError, match=str(bad)):
            ProcessOptions(least_expressions=bad)


def test_the_engine_of_the_fusion_is_checked():
    with pytest.raises(ValueRangeError, match="engine must be one of numba, open3d"):
        ProcessOptions(fusion="kinect")
    with pytest.MonkeyPatch.context() as patch:
        patch.setitem(sys.modules, "open3d", None)
        with pytest.raises(MissingExtraError, match="needs the open3d package"):
            ProcessOptions(fusion="open3d")


def test_the_number_of_threads_makes_no_difference(captures):
    """A build that was killed may go on with another number of workers, and each has its own number of threads."""
    program = (
        "import sys; from pathlib import Path; from facewright.capture.captures import list_captures\n"
        "from facewright.warehouse.process_subject import ProcessOptions, process_subject\n"
        "options = ProcessOptions(face='builtin', least_expressions=2)\n"
        "subject = process_subject(list_captures(Path(sys.argv[1]))[0], options)\n"
        "import hashlib; digest = hashlib.sha256()\n"
        "for name in ('meshes', 'blendshapes', 'expression_weights', 'camera_from_model', 'depth'):\n"
        "    digest.update(getattr(subject, name).tobytes())\n"
        "print(digest.hexdigest())"
    )
    found = []
    for threads in (1, 2):
        environment = {**os.environ, **thread_environment(threads)}
        words = [sys.executable, "-c", program, str(captures)]
        found.append(subprocess.run(words, env=environment, capture_output=True, text=True, check=True).stdout)
    assert found[0] == found[1]
    assert len(found[0].strip()) == 64


def test_the_raw_depth_of_the_reference_frames_is_kept_on_request(captures, tmp_path):
    from facewright.capture.recording import open_recording

    capture = copied(captures, tmp_path, "neutral", "mouth_stretch")
    options = ProcessOptions(face="builtin", least_expressions=1, keep_records=False, keep_raw=True)
    subject = process_subject(capture, options)
    assert subject.depth is None and subject.color is None
    for name, raw in zip(subject.expressions, subject.raw_depth):
        reference = subject.provenance["expressions"][name]["reference_frame"]
        np.testing.assert_array_equal(raw, open_recording(capture.recordings[name]).frame(reference).depth)
