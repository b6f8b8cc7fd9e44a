import numpy as np
import pytest

from facewright.errors import ShapeError, ValueRangeError

pytest.importorskip("mediapipe")
data = pytest.importorskip("skimage.data")
pytestmark = pytest.mark.landmarks


@pytest.fixture(scope="module")
def astronaut():
    return np.ascontiguousarray(data.astronaut())


def shifted(picture, dx, dy):
    return np.ascontiguousarray(np.roll(picture, (dy, dx), axis=(0, 1)))


def test_follows_a_moving_face_to_the_pixel(astronaut):
    from facewright.landmarks.video_detector import VideoDetector

    with VideoDetector() as detector:
        first = detector.detect(astronaut)
        assert first.points is not None and not first.cut and first.points.shape == (478, 2)
        for k in range(1, 12):
            found = detector.detect(shifted(astronaut, 6 * k, 3 * k))
            assert found.points is not None and not found.cut
            moved = np.median(found.points - first.points, axis=0)
            np.testing.assert_allclose(moved, [6 * k, 3 * k], atol=1.5)


def test_finds_the_face_again_after_losses_and_cuts(astronaut):
    from facewright.landmarks.video_detector import VideoDetector

    blank = np.full_like(astronaut, 128)
    with VideoDetector() as detector:
        for _ in range(3):
            assert detector.detect(astronaut).points is not None
        gone = detector.detect(blank)
        assert gone.points is None and gone.cut
        for _ in range(6):
            assert detector.detect(blank).points is None
        back = [detector.detect(shifted(astronaut, 120, 40)) for _ in range(6)]
        assert back[0].cut and back[-1].points is not None
        mirrored = np.ascontiguousarray(astronaut[:, ::-1])
        there = detector.detect(mirrored)
        assert there.cut and there.points is not None


def test_follows_the_face_that_was_asked_for(astronaut):
    from PIL import Image

    from facewright.landmarks.video_detector import VideoDetector

    small = np.asarray(Image.fromarray(astronaut).resize((330, 330)))
    both = np.full((512, 900, 3), 90, np.uint8)
    both[:, :512] = astronaut
    both[100:430, 540:870] = small
    for index, left in ((0, 0), (1, 540)):
        with VideoDetector(face_index=index) as detector:
            points = [detector.detect(both).points for _ in range(4)][-1]
            assert detector.n_faces == 2
            assert left < points[:, 0].mean() < left + 400
    with VideoDetector(face_index=5) as detector:
        assert detector.detect(both).points is None


def test_refuses_what_is_no_picture():
    from facewright.landmarks.video_detector import VideoDetector

    with pytest.raises(ValueRangeError, match="face_index"):
        VideoDetector(face_index=-1)
    with VideoDetector() as detector, pytest.raises(ShapeError, match="image"):
        detector.detect(np.zeros((4, 4), np.uint8))
