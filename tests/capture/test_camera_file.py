"""Camera files: what they say, where they lie, and the note of which way is up."""

import json

import pytest

from facewright.camera.pinhole import Intrinsics
from facewright.capture.camera_file import CameraFile, camera_path, read_camera_file, save_quarter_turns
from facewright.errors import FileFormatError, ValueRangeError

FULL = {"width": 32, "height": 24, "fx": 30, "fy": 31, "cx": 15, "cy": 11, "depth_per_metre": 5000, "quarter_turns": 3}


def test_places(tmp_path):
    assert camera_path(tmp_path) == tmp_path / "camera.json"
    assert camera_path(tmp_path / "smile.r3d") == tmp_path / "smile.camera.json"


def test_full_file(tmp_path):
    (tmp_path / "camera.json").write_text(json.dumps(FULL))
    assert read_camera_file(tmp_path) == CameraFile(Intrinsics(30, 31, 15, 11), (24, 32), 5000, 3)


def test_no_file_and_little_said(tmp_path):
    assert read_camera_file(tmp_path) == CameraFile()
    (tmp_path / "camera.json").write_text('{"note": "hello"}')
    assert read_camera_file(tmp_path) == CameraFile()


def test_note_of_the_turn_keeps_the_rest(tmp_path):
    (tmp_path / "camera.json").write_text(json.dumps({**FULL, "lens": "wide"}))
    assert save_quarter_turns(tmp_path, 1) == tmp_path / "camera.json"
    assert json.loads((tmp_path / "camera.json").read_text()) == {**FULL, "lens": "wide", "quarter_turns": 1}
    save_quarter_turns(tmp_path / "smile.r3d", 2)
    assert read_camera_file(tmp_path / "smile.r3d").quarter_turns == 2


def test_note_of_the_turn_is_refused_beside_damage(tmp_path):
    (tmp_path / "camera.json").write_text("{broken")
    with pytest.raises(FileFormatError, match=r"camera\.json must be JSON"):
        save_quarter_turns(tmp_path, 1)
    assert (tmp_path / "camera.json").read_text() == "{broken"
    (tmp_path / "camera.json").write_text("{}")
    with pytest.raises(ValueRangeError, match="quarter_turns"):
        save_quarter_turns(tmp_path, 5)


def test_deep_nesting_is_damage(tmp_path):
    (tmp_path / "camera.json").write_text("[" * 100_000)
    with pytest.raises(FileFormatError, match="must be JSON"):
        read_camera_file(tmp_path)
