"""What is written comes back; nothing is half-written."""

import json
import subprocess
import sys
import time

import numpy as np
import pytest

from facewright.camera.pinhole import Intrinsics
from facewright.capture.captures import list_captures
from facewright.capture.frame import RGBDFrame
from facewright.capture.recording import open_recording
from facewright.capture.tum_writer import write_tum_recording
from facewright.errors import ShapeError, StoreError, ValueRangeError

K = Intrinsics(40.0, 41.0, 19.5, 14.5)
SIZE = (30, 40)


def _frames(rng, n=5, k=K, size=SIZE, far=900.0):
    for i in range(n):
        depth = rng.uniform(far / 2, far, size).astype(np.float32)
        depth[:3] = 0
        color = rng.integers(0, 256, (*size, 3)).astype(np.uint8)
        yield RGBDFrame(color, depth, k, 5.0 + i / 30)


def test_round_trip(rng, tmp_path):
    frames = list(_frames(rng))
    assert write_tum_recording(tmp_path / "a" / "smile", iter(frames), color_format="png") == 5
    recording = open_recording(tmp_path / "a" / "smile")
    assert recording.intrinsics == K and recording.warnings == ()
    for frame, back in zip(frames, recording.frames(), strict=True):
        np.testing.assert_array_equal(back.color, frame.color)
        assert np.abs(back.depth - frame.depth).max() <= 0.1001  # half a step of 0.2 mm
        assert back.time == pytest.approx(frame.time, abs=1e-6)
    camera = json.loads((tmp_path / "a" / "smile" / "camera.json").read_text())
    assert camera == {"width": 40, "height": 30, "fx": 40, "fy": 41, "cx": 19.5, "cy": 14.5, "depth_per_metre": 5000}


def test_jpeg_is_the_default(rng, tmp_path):
    smooth = [RGBDFrame(np.full((*SIZE, 3), 90, np.uint8), f.depth, K, f.time) for f in _frames(rng, 2)]
    write_tum_recording(tmp_path / "smile", smooth)
    assert sorted(p.suffix for p in (tmp_path / "smile" / "rgb").iterdir()) == [".jpg", ".jpg"]
    assert np.abs(open_recording(tmp_path / "smile").frame(1).color.astype(int) - 90).max() <= 2


def test_finer_steps(rng, tmp_path):
    frames = list(_frames(rng, 1))
    write_tum_recording(tmp_path / "smile", frames, depth_per_metre=20000)
    assert np.abs(open_recording(tmp_path / "smile").frame(0).depth - frames[0].depth).max() <= 0.0251


def test_depth_beyond_the_range_is_none(tmp_path):
    depth = np.full(SIZE, 600.0, np.float32) + np.arange(40, dtype=np.float32)
    depth[4, 4] = 14000.0
    write_tum_recording(tmp_path / "smile", [RGBDFrame(np.zeros((*SIZE, 3), np.uint8), depth, K)])
    assert open_recording(tmp_path / "smile").frame(0).depth[4, 4] == 0


def _one(time=0.0, k=K, size=SIZE, depth=600.0):
    return RGBDFrame(np.zeros((*size, 3), np.uint8), np.full(size, depth, np.float32), k, time)


@pytest.mark.parametrize(
    ("frames", "error", "message"),
    [
        ([], ValueRangeError, "must be at least one"),
        ([_one(0.0), _one(0.0)], ValueRangeError, "times of frames must increase"),
        ([_one(1.0), _one(0.5)], ValueRangeError, "times of frames must increase"),
        ([_one(0.0), _one(1.0, size=(20, 40))], ShapeError, "one size"),
        ([_one(0.0), _one(1.0, Intrinsics(50, 41, 19.5, 14.5))], ValueRangeError, "different intrinsics"),
        ([_one(0.0, depth=0.6)], ValueRangeError, "in millimetres, got at most 0.6: are these metres"),
    ],
)
def test_refused_frames_leave_nothing(tmp_path, frames, error, message):
    with pytest.raises(error, match=message):
        write_tum_recording(tmp_path / "smile", frames)
    assert list(tmp_path.iterdir()) == []


def test_error_of_the_source_leaves_nothing(rng, tmp_path):
    def broken():
        yield from _frames(rng, 2)
        raise RuntimeError("the sensor is gone")

    with pytest.raises(RuntimeError, match="the sensor"):
        write_tum_recording(tmp_path / "smile", broken())
    assert list(tmp_path.iterdir()) == []


def test_full_disk_leaves_nothing(rng, tmp_path, monkeypatch):
    import errno

    from facewright.capture import tum_writer

    left = iter(range(3))

    def encode(counts):
        if next(left, None) is None:
            raise OSError(errno.ENOSPC, "No space left on device")
        return b"png"

    monkeypatch.setattr(tum_writer, "encode_depth", encode)
    with pytest.raises(StoreError, match="no space left on the disk; nothing was changed"):
        write_tum_recording(tmp_path / "smile", _frames(rng))
    assert list(tmp_path.iterdir()) == []


def test_what_is_there_is_not_replaced_unasked(rng, tmp_path):
    write_tum_recording(tmp_path / "smile", _frames(rng, 3))
    with pytest.raises(StoreError, match="holds something"):
        write_tum_recording(tmp_path / "smile", _frames(rng, 2))
    assert open_recording(tmp_path / "smile").n_frames == 3
    write_tum_recording(tmp_path / "smile", _frames(rng, 2), overwrite=True)
    assert open_recording(tmp_path / "smile").n_frames == 2


def test_factor_must_be_positive(tmp_path):
    with pytest.raises(ValueRangeError, match="depth_per_metre must be positive"):
        write_tum_recording(tmp_path / "smile", [_one()], depth_per_metre=0)


def test_frames_are_read_one_after_the_other(rng, tmp_path):
    """A generator of frames is not run ahead far: memory stays flat."""
    waiting = []

    def counted():
        for frame in _frames(rng, 30):
            waiting.append(len(list((tmp_path).glob(".smile*.part/depth/*.png"))))
            yield frame

    write_tum_recording(tmp_path / "smile", counted())
    assert max(i - done for i, done in enumerate(waiting)) <= 7


def test_killed_in_the_middle_leaves_no_recording(tmp_path):
    """kill -9: what was begun has a hidden name that no reader looks at."""
    code = (
        "import sys, itertools, numpy as np\n"
        "from facewright.camera.pinhole import Intrinsics\n"
        "from facewright.capture.frame import RGBDFrame\n"
        "from facewright.capture.tum_writer import write_tum_recording\n"
        "depth, color = np.full((30, 40), 600, np.float32), np.zeros((30, 40, 3), np.uint8)\n"
        "frames = (RGBDFrame(color, depth, Intrinsics(40, 40, 20, 15), i / 30) for i in itertools.count())\n"
        "write_tum_recording(sys.argv[1], frames)\n"
    )
    root = tmp_path / "captures"
    write_tum_recording(root / "anna" / "neutral", [_one()])
    writer = subprocess.Popen([sys.executable, "-c", code, str(root / "anna" / "smile")])
    try:
        until = time.monotonic() + 60
        while not list(root.glob("anna/.smile*.part/depth/*.png")) and time.monotonic() < until:
            assert writer.poll() is None
            time.sleep(0.02)
    finally:
        writer.kill()
        writer.wait()
    assert list(root.glob("anna/.smile*.part/depth/*.png"))  # it was in the middle
    (anna,) = list_captures(root)
    assert list(anna.recordings) == ["neutral"] and anna.problems == ()
    write_tum_recording(root / "anna" / "smile", [_one()])
    assert open_recording(root / "anna" / "smile").n_frames == 1
