import json

import numpy as np
import pytest

from facewright.errors import FileFormatError
from facewright.landmarks.files import read_landmarks, write_landmarks
from facewright.landmarks.points import Landmarks


def test_json_round_trip_keeps_scheme_confidence_and_missing(tmp_path, rng):
    confidence = rng.uniform(0.1, 1, 74).round(3)
    confidence[4] = 0
    landmarks = Landmarks("fw74", rng.uniform(0, 500, (74, 2)).round(4), confidence)
    write_landmarks(tmp_path / "a.json", landmarks)
    back = read_landmarks(tmp_path / "a.json")
    assert back.scheme == "fw74"
    np.testing.assert_allclose(back.points, landmarks.points)
    np.testing.assert_allclose(back.confidence, confidence)


@pytest.mark.parametrize(("count", "scheme"), [(68, "ibug68"), (74, "fw74"), (478, "mediapipe478")])
def test_pts_tell_their_scheme_by_the_count(tmp_path, rng, count, scheme):
    points = rng.uniform(0, 500, (count, 2)).round(4)
    write_landmarks(tmp_path / "a.pts", Landmarks(scheme, points))
    back = read_landmarks(tmp_path / "a.pts")
    assert back.scheme == scheme
    np.testing.assert_allclose(back.points, points, atol=1e-6)


def test_refuses_wrong_counts_and_schemes(tmp_path):
    (tmp_path / "a.pts").write_text("version: 1\nn_points: 2\n{\n1 2\n3 4\n}\n")
    with pytest.raises(FileFormatError, match="68"):
        read_landmarks(tmp_path / "a.pts")
    content = {"format": "facewright landmarks", "version": 1, "scheme": "wflw98", "points": [[1, 2]]}
    (tmp_path / "b.json").write_text(json.dumps(content))
    with pytest.raises(FileFormatError, match="wflw98"):
        read_landmarks(tmp_path / "b.json")
    (tmp_path / "b.json").write_text(json.dumps(content | {"scheme": "fw74"}))
    with pytest.raises(FileFormatError, match="74"):
        read_landmarks(tmp_path / "b.json")


def test_refuses_3d_landmarks(test_data):
    with pytest.raises(FileFormatError, match="2 coordinates"):
        read_landmarks(test_data / "scans" / "james.ljson")
