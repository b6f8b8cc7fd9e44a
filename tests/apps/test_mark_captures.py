"""Landmarks of captures: written beside each recording, kept where somebody refined them."""

import numpy as np
import pytest
from PIL import Image

from facewright.apps.mark_captures import MarkCapturesRequest, mark_captures
from facewright.camera.pinhole import Intrinsics
from facewright.capture.camera_file import read_camera_file
from facewright.capture.captures import find_sidecar
from facewright.capture.frame import RGBDFrame
from facewright.capture.tum_writer import write_tum_recording
from facewright.errors import ValueRangeError
from facewright.landmarks.files import read_landmarks, write_landmarks
from facewright.landmarks.points import Landmarks
from facewright.landmarks.scheme import load_scheme

SIZE = (60, 80)
K = Intrinsics(80.0, 80.0, 39.5, 29.5)


class _Detector:
    """Finds a face in upright pictures (their corner is white) at a place that the picture's colour tells.

    The face looks to the side, but in frames whose green channel is 0.
    """

    def detect(self, image):
        corners = image[[0, 0, -1, -1], [0, -1, 0, -1], 0]
        if corners.max() < 128 or corners.argmax() != 0:
            return []
        groups = load_scheme("fw74").groups
        points = np.full((74, 2), 30.0)
        points[groups["right_eye"], 0] -= 8
        points[groups["left_eye"], 0] += 8
        points[groups["nose"]] += [0.02 * float(image[-1, -1, 1]), 8]
        points[groups["outer_mouth"], 1] += 16
        return [Landmarks("fw74", points)]


def _write(folder, frontal, n=5, turns=0, face=True):
    """Frames of which number `frontal` is frontal, stored so that `turns` quarter turns make them upright."""

    def frames():
        for i in range(n):
            color = np.zeros((*SIZE, 3), np.uint8)
            color[-1, -1, 1] = 0 if i == frontal else 100
            if face:
                color[:10, :10, 0] = 255
            color = np.ascontiguousarray(np.rot90(color, -turns))
            depth = np.full(color.shape[:2], 600.0, np.float32)
            k = K if turns % 2 == 0 else Intrinsics(80.0, 80.0, 29.5, 39.5)
            yield RGBDFrame(color, depth, k, i / 30)

    write_tum_recording(folder, frames(), color_format="png")


@pytest.fixture
def captures(tmp_path):
    root = tmp_path / "captures"
    _write(root / "anna" / "neutral", 3)
    _write(root / "anna" / "smile", 1)
    _write(root / "berta" / "neutral", 2)
    return root


def test_landmarks_of_the_most_frontal_frame(captures, tmp_path):
    seen = []
    request = MarkCapturesRequest(captures, pictures=tmp_path / "sheets")
    result = mark_captures(request, lambda *step: seen.append(step), _Detector())
    assert [p.name for p in result.written] == ["landmarks-3.json", "landmarks-1.json", "landmarks-2.json"]
    assert result.failed == {} and result.turned == {} and seen[-1] == ("marking recordings", 3, 3)
    number, file = find_sidecar(captures / "anna" / "neutral")
    assert number == 3
    points = read_landmarks(file)
    assert points.scheme == "fw74" and points.present.all()
    np.testing.assert_allclose(points.points[points.definition.groups["nose"][0]], [30.0, 38.0])
    assert [p.name for p in result.pictures] == ["anna.png", "berta.png"]
    assert Image.open(tmp_path / "sheets" / "anna.png").size == (2 * 486 + 6, 480 + 6 + 22 + 6)


def test_refined_landmarks_stay(captures):
    mark_captures(MarkCapturesRequest(captures), None, _Detector())
    file = find_sidecar(captures / "anna" / "smile")[1]
    refined = Landmarks("fw74", np.full((74, 2), 11.0))
    write_landmarks(file, refined)
    result = mark_captures(MarkCapturesRequest(captures), None, _Detector())
    assert result.written == [] and len(result.kept) == 3
    assert (read_landmarks(file).points == 11.0).all()


def test_overwriting_leaves_one_file(captures):
    """Also where the new reference frame is another one."""
    folder = captures / "anna" / "smile"
    write_landmarks(folder / "landmarks-4.json", Landmarks("fw74", np.full((74, 2), 11.0)))
    result = mark_captures(MarkCapturesRequest(captures, overwrite=True, only=("anna",)), None, _Detector())
    assert len(result.written) == 2
    assert find_sidecar(folder) == (1, folder / "landmarks-1.json")


def test_heads_on_their_side_are_turned_and_that_is_noted(captures, monkeypatch):
    def by_corner(recording, detector):
        picture = recording.frame(0).color
        return next(t for t in range(4) if detector.detect(np.ascontiguousarray(np.rot90(picture, t))))

    monkeypatch.setattr("facewright.capture.upright.find_quarter_turns", by_corner)
    folder = captures / "berta" / "smile"
    _write(folder, 2, turns=3)
    result = mark_captures(MarkCapturesRequest(captures), None, _Detector())
    assert result.turned == {"berta/smile": 3} and read_camera_file(folder).quarter_turns == 3
    np.testing.assert_allclose(
        read_landmarks(find_sidecar(folder)[1]).points[load_scheme("fw74").groups["nose"][0]], [30, 38]
    )
    again = mark_captures(MarkCapturesRequest(captures, overwrite=True), None, _Detector())
    assert again.turned == {} and read_camera_file(folder).quarter_turns == 3


def test_failures_stop_nothing_else(captures):
    _write(captures / "anna" / "grin", 0, face=False)
    _write(captures / "anna" / "anger", 0)
    picture = next((captures / "anna" / "anger" / "depth").iterdir())
    picture.write_bytes(b"")
    write_landmarks(captures / "berta" / "neutral" / "landmarks-99.json", Landmarks("fw74", np.full((74, 2), 11.0)))
    (captures / "carl" / "wink" / "depth").mkdir(parents=True)
    result = mark_captures(MarkCapturesRequest(captures), None, _Detector())
    assert len(result.written) == 2
    assert sorted(result.failed) == ["anna/anger", "anna/grin", "berta/neutral", "carl"]
    assert "face" in result.failed["anna/grin"] and "empty file" in result.failed["anna/anger"]
    assert "must name a frame in [0, 5), got 99" in result.failed["berta/neutral"]
    assert "named after an expression" in result.failed["carl"]
    assert find_sidecar(captures / "anna" / "grin") is None


def test_only_some_subjects(captures):
    result = mark_captures(MarkCapturesRequest(captures, only=("berta",)), None, _Detector())
    assert len(result.written) == 1
    with pytest.raises(ValueRangeError, match=r"only must name subjects .* got dora"):
        mark_captures(MarkCapturesRequest(captures, only=("dora",)), None, _Detector())
