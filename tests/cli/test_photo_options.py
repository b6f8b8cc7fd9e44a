import numpy as np
import pytest

from facewright.cli import photo_options
from facewright.errors import FileFormatError, StoreError
from facewright.landmarks.files import write_landmarks
from facewright.landmarks.points import Landmarks


def test_a_model_is_read_or_the_default_one_is_taken(tmp_path, monkeypatch):
    calls = []
    monkeypatch.setattr("facewright.apps.default_model.default_model", lambda progress: calls.append(progress) or "it")
    assert photo_options.load_model(None) == "it" and calls == [None]
    with pytest.raises(StoreError):
        photo_options.load_model(tmp_path / "absent.fwbm")
    (tmp_path / "bad.fwbm").write_bytes(b"no model")
    with pytest.raises(FileFormatError):
        photo_options.load_model(tmp_path / "bad.fwbm")


def test_options_reach_the_subject_and_remarks_are_said_aside(tmp_path, monkeypatch, capsys):
    points = Landmarks("fw74", np.arange(148.0).reshape(74, 2))
    write_landmarks(tmp_path / "points.json", points)
    seen = {}

    class Subject:
        remarks = ("2 faces were found.",)

    def opened(photo, model, **options):
        seen.update(options, photo=photo, model=model)
        return Subject()

    monkeypatch.setattr("facewright.apps.photo_subject.open_photo_subject", opened)
    photo_options.open_subject(tmp_path / "a.png", "model", face=1, landmarks=tmp_path / "points.json", focal=900.0)
    assert seen["face_index"] == 1 and seen["focal_length"] == 900.0 and seen["photo"] == tmp_path / "a.png"
    np.testing.assert_allclose(seen["landmarks"].points, points.points)
    out, err = capsys.readouterr()
    assert out == "" and "2 faces were found." in err
