from concurrent.futures import Future

import numpy as np
import pytest

from facewright.landmarks.files import write_landmarks
from facewright.landmarks.points import Landmarks
from facewright.warehouse.expression_record import StageClock, needs_detector, padded


def test_pictures_of_several_sizes_keep_their_pixels():
    small, large = np.ones((2, 3), np.float32), np.full((4, 2), 7.0, np.float32)
    stack = padded([small, large])
    assert stack.shape == (2, 4, 3)
    assert np.array_equal(stack[0, :2], small)
    assert not stack[0, 2:].any()
    assert np.array_equal(stack[1, :, :2], large)
    colour = padded([np.full((2, 2, 3), 5, np.uint8), np.zeros((2, 5, 3), np.uint8)])
    assert colour.shape == (2, 2, 5, 3)
    assert colour.dtype == np.uint8


@pytest.mark.parametrize("missing", [0, 3])
def test_a_sidecar_without_all_points_needs_a_detector_beside_it(tmp_path, rng, missing):
    (tmp_path / "smile").mkdir()
    confidence = np.ones(74)
    confidence[:missing] = 0.0
    write_landmarks(tmp_path / "smile" / "landmarks-2.json", Landmarks("fw74", rng.random((74, 2)), confidence))
    assert needs_detector({"smile": tmp_path / "smile"}) is bool(missing)
    (tmp_path / "neutral").mkdir()
    assert needs_detector({"smile": tmp_path / "smile", "neutral": tmp_path / "neutral"})


def test_the_clock_counts_failures_too():
    clock = StageClock()
    with pytest.raises(KeyError), clock.time("fuse"):
        raise KeyError
    assert clock.seconds["fuse"] > 0
    clock.add("fuse", 1.0)
    assert clock.seconds["fuse"] > 1


@pytest.mark.landmarks
def test_a_head_that_lies_on_its_side_is_turned_upright(test_data):
    pytest.importorskip("mediapipe", reason="needs the landmarks extra")
    pytest.importorskip("skimage", reason="needs the landmarks extra")
    from facewright.landmarks.detector import open_detector
    from facewright.warehouse.expression_record import LoadedRecording, read_record

    path = test_data / "truedepth_mannequin"
    loaded = Future()
    loaded.set_result(LoadedRecording(path))
    with open_detector() as detector:
        record = read_record("neutral", path, detector, StageClock(), loaded)
    assert record.facts["quarter_turns"] == 3
    assert record.fused.depth.shape == (320, 240)
    points, groups = record.landmarks.points, record.landmarks.definition.groups
    eyes, mouth = (points[np.concatenate(ids)].mean(axis=0) for ids in (
        [groups["right_eye"], groups["left_eye"]], [groups["outer_mouth"]]
    ))  # fmt: skip
    assert mouth[1] - eyes[1] > 2 * abs(mouth[0] - eyes[0])  # eyes above the mouth
