"""Which way is up, told by a detector that sees only upright faces."""

import numpy as np
import pytest

from facewright.camera.pinhole import Intrinsics
from facewright.capture.frame import RGBDFrame
from facewright.capture.recording import open_recording
from facewright.capture.tum_writer import write_tum_recording
from facewright.capture.upright import find_quarter_turns, is_upright, upright_turns
from facewright.landmarks.points import Landmarks
from facewright.landmarks.scheme import load_scheme

SIZE = (60, 80)


def _face(angle=0.0):
    """fw74 points whose mouth is 20 px from the eyes, `angle` degrees from straight down."""
    points = np.full((74, 2), 30.0)
    a = np.deg2rad(angle)
    points[load_scheme("fw74").groups["outer_mouth"]] += 20.0 * np.array([np.sin(a), np.cos(a)])
    return Landmarks("fw74", points)


class _Detector:
    """Finds a face where the picture's brightest corner is the upper left one, as often as `answers`."""

    def __init__(self, angle=0.0):
        self.angle, self.calls = angle, 0

    def detect(self, image):
        self.calls += 1
        corners = image[[0, 0, -1, -1], [0, -1, 0, -1], 0]
        return [_face(self.angle)] if corners.max() > 128 and corners.argmax() == 0 else []


def _picture(turns):
    """A picture that `turns` counter-clockwise quarter turns make upright."""
    upright = np.zeros((*SIZE, 3), np.uint8)
    upright[:10, :10] = 255
    return np.ascontiguousarray(np.rot90(upright, -turns))


@pytest.mark.parametrize("turns", range(4))
def test_turns_that_make_a_picture_upright(turns):
    assert upright_turns(_picture(turns), _Detector()) == turns


@pytest.mark.parametrize(
    ("angle", "upright"), [(0, True), (40, True), (-40, True), (50, False), (90, False), (180, False)]
)
def test_faces_on_their_side_do_not_count(angle, upright):
    assert is_upright(_face(angle)) is upright
    assert (upright_turns(_picture(0), _Detector(angle)) == 0) is upright


def _recording(folder, pictures):
    depth = np.full(SIZE, 600.0, np.float32)
    k = Intrinsics(80.0, 80.0, 39.5, 29.5)
    frames = (RGBDFrame(p, depth, k, i / 30) for i, p in enumerate(pictures))
    write_tum_recording(folder, frames, color_format="png")
    return folder


def test_other_frames_are_looked_at_where_the_middle_one_shows_nothing(tmp_path):
    upside_down = np.ascontiguousarray(np.rot90(_picture(0), 2))
    nothing = np.zeros((*SIZE, 3), np.uint8)
    folder = _recording(tmp_path / "a", [nothing, upside_down, nothing, nothing])
    assert find_quarter_turns(open_recording(folder), _Detector()) == 2
    assert find_quarter_turns(open_recording(folder, quarter_turns=2), _Detector()) == 0


def test_no_face_any_way_round(tmp_path):
    detector = _Detector()
    folder = _recording(tmp_path / "a", [np.zeros((*SIZE, 3), np.uint8)] * 9)
    assert find_quarter_turns(open_recording(folder), detector) is None
    assert detector.calls == 12


@pytest.mark.slow
@pytest.mark.landmarks
def test_real_mannequin_lies_on_its_side(test_data):
    pytest.importorskip("mediapipe")
    from facewright.landmarks.detector import open_detector

    with open_detector() as detector:
        recording = open_recording(test_data / "truedepth_mannequin")
        assert find_quarter_turns(recording, detector) == 3
