"""What all recordings share: kinds, frames one after the other, turning, one grid."""

import threading

import numpy as np
import pytest

from facewright.camera.pinhole import Intrinsics
from facewright.capture import recording as module
from facewright.capture.camera_file import save_quarter_turns
from facewright.capture.frame import RGBDFrame
from facewright.capture.quarter_turns import turn_intrinsics
from facewright.capture.recording import clean_depth, on_grid, open_recording, recording_kind
from facewright.capture.tum_writer import write_tum_recording
from facewright.errors import FileFormatError, StoreError, ValueRangeError

SIZE = (30, 40)
K = Intrinsics(40.0, 41.0, 18.5, 14.0)


@pytest.fixture
def folder(rng, tmp_path):
    """Six frames of noise."""

    def frames():
        for i in range(6):
            depth = rng.uniform(500, 700, SIZE).astype(np.float32)
            yield RGBDFrame(rng.integers(0, 256, (*SIZE, 3)).astype(np.uint8), depth, K, i / 30)

    write_tum_recording(tmp_path / "smile", frames(), color_format="png")
    return tmp_path / "smile"


@pytest.mark.parametrize("turns", range(4))
def test_turned_frames(folder, turns):
    plain, turned = open_recording(folder), open_recording(folder, quarter_turns=turns)
    assert turned.intrinsics == turn_intrinsics(K, SIZE, turns)
    for a, b in zip(plain.frames(), turned.frames(), strict=True):
        np.testing.assert_array_equal(b.color, np.rot90(a.color, turns))
        np.testing.assert_array_equal(b.depth, np.rot90(a.depth, turns))
        assert b.intrinsics == turned.intrinsics and b.size == turned.size
        assert b.color.flags.c_contiguous and b.depth.flags.c_contiguous


def test_noted_turn_holds_unless_another_is_given(folder):
    save_quarter_turns(folder, 3)
    assert open_recording(folder).quarter_turns == 3 and open_recording(folder).size == SIZE[::-1]
    assert open_recording(folder, quarter_turns=0).size == SIZE
    with pytest.raises(ValueRangeError, match="quarter_turns"):
        open_recording(folder, quarter_turns=4)


def test_given_intrinsics_are_of_the_stored_pictures(folder):
    given = Intrinsics(50.0, 51.0, 20.0, 15.0)
    turned = open_recording(folder, intrinsics=given, quarter_turns=1)
    assert turned.frame(2).intrinsics == turned.intrinsics == turn_intrinsics(given, SIZE, 1)


@pytest.mark.parametrize("i", [-1, 6, 100])
def test_frames_that_are_not_there(folder, i):
    with pytest.raises(ValueRangeError, match=r"must be in \[0, 6\)"):
        open_recording(folder).frame(i)


def test_one_frame_is_a_recording(folder):
    for name in ("rgb.txt", "depth.txt"):
        lines = (folder / name).read_text().splitlines()
        (folder / name).write_text("\n".join(lines[:2]))
    recording = open_recording(folder)
    assert recording.n_frames == 1 and len(list(recording.frames())) == 1


def test_frames_stream(folder, monkeypatch):
    """At most the next two frames are read ahead, in order; leaving early leaves no thread behind."""
    recording = open_recording(folder)
    read = []
    frame = module.Recording.frame
    monkeypatch.setattr(module.Recording, "frame", lambda self, i: (read.append(i), frame(self, i))[1])
    before = threading.active_count()
    frames = recording.frames()
    for i in range(3):
        next(frames)
        assert max(read) <= i + 3
    frames.close()
    assert read == sorted(read) and threading.active_count() == before
    assert len(list(recording.frames())) == 6


def test_error_of_a_frame_comes_when_it_is_reached(folder):
    pictures = sorted((folder / "depth").iterdir())
    pictures[4].write_bytes(pictures[4].read_bytes()[:100])
    seen = []
    with pytest.raises(FileFormatError, match="truncated or corrupt"):
        for frame in open_recording(folder).frames():
            seen.append(frame.time)
    assert len(seen) == 4


def test_kinds_by_name(tmp_path):
    for name, kind in (("a.r3d", "record3d"), ("a.BAG", "realsense"), ("a.mkv", "azure"), ("a.txt", None)):
        assert recording_kind(tmp_path / name) == kind
    for entry, kind in (("depth.txt", "tum"), ("rgb", "tum"), ("x.ply", "truedepth"), ("x.txt", None)):
        folder = tmp_path / f"with {entry}"
        folder.mkdir()
        (folder / entry).touch()
        assert recording_kind(folder) == kind


def test_what_is_no_recording(tmp_path):
    with pytest.raises(StoreError, match="does not exist"):
        open_recording(tmp_path / "missing")
    with pytest.raises(FileFormatError, match="must be a recording of a depth camera"):
        open_recording(tmp_path)
    (tmp_path / "a.txt").touch()
    with pytest.raises(FileFormatError, match="must be a recording of a depth camera"):
        open_recording(tmp_path / "a.txt")


def test_clean_depth():
    cleaned = clean_depth(np.array([[np.nan, np.inf, -np.inf], [-5.0, 0.0, 600.0]]))
    assert cleaned.dtype == np.float32
    np.testing.assert_array_equal(cleaned, [[0, 0, 0], [0, 0, 600]])


def test_colour_on_the_grid_of_the_depth():
    """Halves by the mean of four pixels: the places of things stay."""
    fine = np.arange(8 * 12 * 3).reshape(8, 12, 3).astype(np.uint8)
    coarse = on_grid(fine, (4, 6), "a")
    mean = fine.reshape(4, 2, 6, 2, 3).mean(axis=(1, 3))
    assert np.abs(coarse - mean).max() <= 1
    assert on_grid(fine, (16, 24), "a").shape == (16, 24, 3)
    assert on_grid(fine, (8, 12), "a") is fine
    with pytest.raises(FileFormatError, match="same ratio, got 12 x 8"):
        on_grid(fine, (8, 8), "colour of a")
