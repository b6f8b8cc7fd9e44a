import builtins
import subprocess
import sys

import numpy as np
import pytest

from facewright.errors import FileFormatError, MissingExtraError, ShapeError, StoreError
from facewright.landmarks.detector import open_detector

pytestmark = pytest.mark.landmarks


@pytest.fixture(scope="module")
def detector():
    pytest.importorskip("mediapipe")
    with open_detector() as found:
        yield found


@pytest.fixture(scope="module")
def astronaut():
    from skimage import data

    return np.ascontiguousarray(data.astronaut())


def test_finds_the_astronaut(detector, astronaut):
    (face,) = detector.detect(astronaut)
    assert face.scheme == "mediapipe478"
    points = face.convert("fw74").points
    assert np.isfinite(points).all()
    # seen in the picture: right pupil at (203, 101), left at (247, 103), chin at (221, 177)
    assert np.linalg.norm(points[27:35].mean(axis=0) - [203, 101]) < 4
    assert np.linalg.norm(points[35:43].mean(axis=0) - [247, 103]) < 4
    assert abs(points[7, 1] - 177) < 4


def test_strided_pictures_are_found_too(detector, astronaut):
    padded = np.zeros((512, 700, 3), np.uint8)
    padded[:, :512] = astronaut
    view = padded[:, :512]
    assert not view.flags.c_contiguous
    np.testing.assert_allclose(detector.detect(view)[0].points, detector.detect(astronaut)[0].points, atol=0.1)


def test_a_quick_look_finds_plain_faces_only(detector, astronaut):
    pytest.importorskip("mediapipe")
    with open_detector(thorough=False) as quick:
        np.testing.assert_allclose(quick.detect(astronaut)[0].points, detector.detect(astronaut)[0].points, atol=0.1)
        looks = []
        quick._look = lambda part: looks.append(part.shape) or []
        quick._finder = lambda part: []
        assert quick.detect(np.full((512, 512, 3), 120, np.uint8)) == []
        assert looks == [(512, 512, 3)]  # no border, no tiles


def test_small_cut_and_tight_faces_are_found(detector, astronaut):
    from PIL import Image

    whole = detector.detect(astronaut)[0].points
    far = np.full((1200, 1800, 3), 120, np.uint8)
    far[500:756, 900:1156] = np.asarray(Image.fromarray(astronaut).resize((256, 256), Image.Resampling.LANCZOS))
    (small,) = detector.detect(far)
    expected = (whole + 0.5) / 2 - 0.5 + [900, 500]
    assert np.linalg.norm(small.points - expected, axis=1).mean() < 1.5
    (tight,) = detector.detect(astronaut[70:185, 175:270])
    assert np.linalg.norm(tight.points + [175, 70] - whole, axis=1).mean() < 4
    assert len(detector.detect(astronaut[:130, 150:300])) == 1


def test_many_faces_come_largest_first(detector, astronaut):
    from PIL import Image

    both = np.full((512, 800, 3), 120, np.uint8)
    both[100:400, 20:320] = np.asarray(Image.fromarray(astronaut).resize((300, 300)))
    both[:400, 380:780] = np.asarray(Image.fromarray(astronaut).resize((400, 400)))
    faces = detector.detect(both)
    assert len(faces) == 2
    assert faces[0].box[0] > 380 > faces[1].box[2]


def test_no_face_is_an_empty_list(detector):
    from skimage import data

    assert detector.detect(np.ascontiguousarray(data.coffee())) == []
    assert detector.detect(np.zeros((64, 64, 3), np.uint8)) == []
    assert detector.detect(np.zeros((1, 1, 3), np.uint8)) == []


@pytest.mark.parametrize("shape", [(10, 10), (10, 10, 4), (0, 10, 3)])
def test_refuses_other_arrays(detector, shape):
    with pytest.raises(ShapeError):
        detector.detect(np.zeros(shape, np.uint8))
    with pytest.raises(ShapeError):
        detector.detect(np.zeros((10, 10, 3)))


def test_task_file_agrees_with_the_face_mesh(detector, astronaut, test_data):
    with open_detector(test_data / "models" / "face_landmarker.task") as other:
        (face,) = other.detect(astronaut)
    assert np.linalg.norm(face.points - detector.detect(astronaut)[0].points, axis=1).mean() < 2.0


def test_bad_task_files_are_refused(tmp_path):
    pytest.importorskip("mediapipe")
    with pytest.raises(StoreError, match="none"):
        open_detector(tmp_path / "none.task")
    (tmp_path / "a.task").write_text("no")
    with pytest.raises(FileFormatError, match=r"a\.task"):
        open_detector(tmp_path / "a.task")
    import zipfile

    with zipfile.ZipFile(tmp_path / "b.task", "w") as archive:
        archive.writestr("x", "y")
    with pytest.raises(FileFormatError, match=r"b\.task"):
        open_detector(tmp_path / "b.task")


def test_without_mediapipe_the_error_names_the_extra(monkeypatch):
    real = builtins.__import__

    def blocked(name, *args, **kwargs):
        if name.startswith("mediapipe"):
            raise ImportError(name)
        return real(name, *args, **kwargs)

    monkeypatch.setattr(builtins, "__import__", blocked)
    with pytest.raises(MissingExtraError, match=r"facewright\[landmarks\]"):
        open_detector()


def test_is_silent():
    pytest.importorskip("mediapipe")
    script = (
        "import numpy as np; from skimage import data; from facewright.landmarks.detector import open_detector\n"
        "with open_detector() as d: d.detect(np.ascontiguousarray(data.astronaut()))"
    )
    run = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, check=True)
    assert run.stdout == "" and run.stderr == ""
