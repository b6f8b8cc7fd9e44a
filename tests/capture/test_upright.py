"""Which way is up, told by a detector that also sees faces where there are none, and by the depth."""

import numpy as np
import pytest
from scipy.interpolate import griddata

from facewright.camera.pinhole import Intrinsics, RigidMotion
from facewright.capture.frame import RGBDFrame
from facewright.capture.quarter_turns import turn_points
from facewright.capture.recording import open_recording
from facewright.capture.tum_writer import write_tum_recording
from facewright.capture.upright import MAX_OFF_MM, find_quarter_turns, how_far_off, turned_frame, upright_turns
from facewright.landmarks.points import Landmarks
from facewright.landmarks.scheme import load_scheme

SIZE = (120, 160)
K = Intrinsics(290.0, 290.0, 79.5, 59.5)


@pytest.fixture(scope="module")
def face_frame(builtin_face):
    """An upright frame of the built-in face's landmarks, 600 mm away, and their pixels; its first pixel is white."""
    internal = np.setdiff1d(np.arange(74), load_scheme("fw74").sliding)
    model = np.asarray(builtin_face.mean_shape, dtype=float)[builtin_face.topology.landmarks["fw74"][internal]]
    R = np.diag([1.0, -1.0, -1.0])
    points = RigidMotion(R, [0, 0, 600] - R @ model.mean(axis=0)).apply(model)
    pixels = np.full((74, 2), np.nan)
    pixels[internal] = K.project(points)
    y, x = np.mgrid[: SIZE[0], : SIZE[1]]
    depth = griddata(pixels[internal], points[:, 2], (x, y))
    near = griddata(pixels[internal], points[:, 2], (x, y), method="nearest")
    depth = np.where(np.isfinite(depth), depth, near).astype(np.float32)
    color = np.zeros((*SIZE, 3), np.uint8)
    color[:4, :4] = 255
    return RGBDFrame(color, depth, K), pixels


class _Detector:
    """Finds the face in upright pictures, and its mirror of eyes upon the mouth in those upside down."""

    def __init__(self, pixels, blind=False):
        self.pixels, self.blind, self.calls = pixels, blind, 0

    def detect(self, image):
        self.calls += 1
        upright = image[0, 0, 0] > 128
        upside_down = image[-1, -1, 0] > 128
        if self.blind or not (upright or upside_down):
            return []
        points = self.pixels
        if upside_down:  # looks like an upright face to it
            middle = np.nanmean(turn_points(points, SIZE, 2), axis=0)
            points = points - np.nanmean(points, axis=0) + middle
        return [Landmarks("fw74", points, np.isfinite(points).all(axis=1).astype(float))]


@pytest.mark.parametrize("turns", range(4))
def test_turns_that_make_a_frame_upright(face_frame, turns):
    frame, pixels = face_frame
    assert upright_turns(turned_frame(frame, -turns % 4), _Detector(pixels)) == turns


def test_true_faces_fit_the_depth_and_others_do_not(face_frame):
    frame, pixels = face_frame
    assert how_far_off(frame, _Detector(pixels)) < 2.0
    upside_down = how_far_off(turned_frame(frame, 2), _Detector(pixels))
    assert upside_down > 2 * how_far_off(frame, _Detector(pixels)) + 2.0


def test_faces_of_another_size_are_none(face_frame):
    """A picture of a face on a poster, or depth in a wrong unit: its points are not as far apart as a face's."""
    frame, pixels = face_frame
    far = RGBDFrame(frame.color, 2.0 * frame.depth, frame.intrinsics)
    assert how_far_off(far, _Detector(pixels)) > MAX_OFF_MM
    assert upright_turns(far, _Detector(pixels)) is None


def test_faces_on_their_side_do_not_count(face_frame):
    """A detector may find the true points in any turn of the picture; only the upright ones count."""
    frame, pixels = face_frame
    side = turned_frame(frame, 1)

    class Sees:
        def detect(self, image):
            points = turn_points(pixels, SIZE, 1)
            return [Landmarks("fw74", points, np.isfinite(points).all(axis=1).astype(float))]

    assert how_far_off(side, Sees()) == np.inf


def test_without_depth_nothing_can_be_told(face_frame):
    frame, pixels = face_frame
    empty = RGBDFrame(frame.color, np.zeros(SIZE, np.float32), K)
    assert upright_turns(empty, _Detector(pixels)) is None


def test_other_frames_are_looked_at_where_the_middle_one_shows_nothing(face_frame, tmp_path):
    frame, pixels = face_frame
    shown = turned_frame(frame, 2)
    frames = []
    for i in range(4):
        color = shown.color if i == 1 else np.zeros_like(shown.color)
        frames.append(RGBDFrame(color, shown.depth, shown.intrinsics, i / 30))
    write_tum_recording(tmp_path / "a", frames, color_format="png")
    assert find_quarter_turns(open_recording(tmp_path / "a"), _Detector(pixels)) == 2
    assert find_quarter_turns(open_recording(tmp_path / "a", quarter_turns=2), _Detector(pixels)) == 0
    blind = _Detector(pixels, blind=True)
    assert find_quarter_turns(open_recording(tmp_path / "a"), blind) is None
    assert blind.calls == 12


@pytest.mark.slow
@pytest.mark.landmarks
@pytest.mark.parametrize("turns", range(4))
def test_real_mannequin(test_data, turns):
    """It lies on its side; from whichever turn one starts, the same way is up."""
    pytest.importorskip("mediapipe")
    from facewright.landmarks.detector import open_detector

    with open_detector(thorough=False) as detector:
        recording = open_recording(test_data / "truedepth_mannequin", quarter_turns=turns)
        for i in (12, 15, 20):
            more = upright_turns(recording.frame(i), detector)
            assert more is not None and (turns + more) % 4 == 3
        assert (turns + find_quarter_turns(recording, detector)) % 4 == 3
