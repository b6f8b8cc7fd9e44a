"""RealSense and Azure Kinect recordings: no real file is at hand, so playback is acted; refusals are Open3D's own."""

import json
import sys
from types import SimpleNamespace

import numpy as np
import pytest

from facewright.camera.pinhole import Intrinsics
from facewright.capture import open3d_sensors
from facewright.capture.open3d_sensors import SensorFrame, SpooledSource
from facewright.capture.recording import open_recording
from facewright.errors import FileFormatError, MissingExtraError, StoreError

SIZE = (12, 16)
K = np.array([[15.0, 0, 8.0], [0, 15.5, 6.0], [0, 0, 1]])


def _counts(i):
    return (np.arange(SIZE[0] * SIZE[1]).reshape(SIZE) + 500 + 10 * i).astype(np.uint16)


def _color(i):
    return np.full((*SIZE, 3), 20 * i, np.uint8)


class _Image:
    def __init__(self, values):
        self.values = values

    def to_legacy(self):
        return self.values


class _Bag:
    """Plays three frames, then says that it is at the end."""

    opens = True

    def __init__(self):
        self.at = -1
        camera = SimpleNamespace(intrinsic_matrix=K)
        self.metadata = SimpleNamespace(intrinsics=camera, depth_scale=1000.0)

    def open(self, path):
        return self.opens

    def next_frame(self):
        self.at += 1
        i = min(self.at, 2)
        return SimpleNamespace(color=_Image(_color(i)), depth=_Image(_counts(i)), is_empty=lambda: self.at > 2)

    def is_eof(self):
        return self.at > 2

    def get_timestamp(self):
        return 33_333 * self.at

    def close(self):
        pass


class _Mkv(_Bag):
    def next_frame(self):
        self.at += 1
        if self.at == 1:
            return None  # a capture without depth
        return SimpleNamespace(color=_color(self.at), depth=_counts(self.at))

    def is_eof(self):
        return self.at >= 2

    def get_metadata(self):
        return K


def _acted(monkeypatch, bag=_Bag, mkv=_Mkv):
    def write_metadata(path, matrix):
        with open(path, "w") as file:  # noqa: PTH123
            json.dump({"intrinsic_matrix": matrix.T.ravel().tolist()}, file)
        return True

    from contextlib import nullcontext

    module = SimpleNamespace(
        t=SimpleNamespace(io=SimpleNamespace(RSBagReader=bag)),
        io=SimpleNamespace(AzureKinectMKVReader=mkv, write_azure_kinect_mkv_metadata=write_metadata),
        utility=SimpleNamespace(
            VerbosityContextManager=lambda level: nullcontext(), VerbosityLevel=SimpleNamespace(Error=0)
        ),
    )
    monkeypatch.setattr(open3d_sensors, "_import_open3d", lambda: module)


def _file(tmp_path, name):
    (tmp_path / name).write_bytes(b"recording")
    return tmp_path / name


def test_realsense_playback(tmp_path, monkeypatch):
    _acted(monkeypatch)
    recording = open_recording(_file(tmp_path, "smile.bag"))
    assert (recording.kind, recording.n_frames, recording.size) == ("realsense", 3, SIZE)
    assert recording.intrinsics == Intrinsics(15.0, 15.5, 8.0, 6.0)
    for i, frame in enumerate(recording.frames()):
        np.testing.assert_array_equal(frame.depth, _counts(i))
        np.testing.assert_array_equal(frame.color, _color(i))
        assert frame.time == pytest.approx(i * 0.033333)
    np.testing.assert_array_equal(recording.frame(0).depth, _counts(0))  # stepping back


def test_azure_playback_leaves_out_captures_without_depth(tmp_path, monkeypatch):
    _acted(monkeypatch)
    recording = open_recording(_file(tmp_path, "smile.mkv"))
    assert (recording.kind, recording.n_frames) == ("azure", 2)
    assert recording.intrinsics == Intrinsics(15.0, 15.5, 8.0, 6.0)
    assert [f.time for f in recording.frames()] == pytest.approx([0, 2 / 30])
    np.testing.assert_array_equal(recording.frame(1).depth, _counts(2))


def test_file_that_does_not_open(tmp_path, monkeypatch):
    class Refuses(_Bag):
        opens = False

    _acted(monkeypatch, Refuses, Refuses)
    with pytest.raises(FileFormatError, match="must be a RealSense recording"):
        open_recording(_file(tmp_path, "smile.bag"))
    with pytest.raises(FileFormatError, match="must be an Azure Kinect recording"):
        open_recording(_file(tmp_path, "smile.mkv"))


def test_build_of_open3d_without_sensors(tmp_path, monkeypatch):
    _acted(monkeypatch)
    module = open3d_sensors._import_open3d()
    del module.t.io.RSBagReader, module.io.AzureKinectMKVReader
    with pytest.raises(MissingExtraError, match="built with RealSense, this one was not"):
        open_recording(_file(tmp_path, "smile.bag"))
    with pytest.raises(MissingExtraError, match="built with Azure Kinect, this one was not"):
        open_recording(_file(tmp_path, "smile.mkv"))


def test_without_open3d_the_extra_is_named(tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "open3d", None)
    with pytest.raises(MissingExtraError, match=r'pip install "facewright\[capture\]"'):
        open_recording(_file(tmp_path, "smile.bag"))


def test_empty_file(tmp_path):
    (tmp_path / "smile.bag").touch()
    with pytest.raises(FileFormatError, match="got an empty file"):
        open_recording(tmp_path / "smile.bag")


@pytest.mark.slow  # importing Open3D takes seconds
def test_real_open3d_refuses_other_files(tmp_path):
    pytest.importorskip("open3d")
    with pytest.raises((FileFormatError, MissingExtraError), match="RealSense"):
        open_recording(_file(tmp_path, "smile.bag"))
    with pytest.raises((FileFormatError, MissingExtraError), match="Azure Kinect"):
        open_recording(_file(tmp_path, "smile.mkv"))


def test_spooled_frames_must_be_of_one_size(tmp_path):
    def source(*frames):
        return SpooledSource("azure", tmp_path / "a.mkv", frames, None, 1000.0)

    good = SensorFrame(_color(0), _counts(0), 0.0)
    with pytest.raises(FileFormatError, match="of one size"):
        source(good, SensorFrame(_color(0)[:4], _counts(0)[:4], 0.1))
    with pytest.raises(FileFormatError, match="of one size"):
        source(SensorFrame(_color(0)[:4], _counts(0), 0.1))
    with pytest.raises(FileFormatError, match="got none"):
        source()
    assert source(good).intrinsics(0) is None


def test_full_disk_of_temporary_files(tmp_path, monkeypatch):
    class Full:
        def write(self, data):
            raise OSError(28, "No space left on device")

    monkeypatch.setattr(open3d_sensors.tempfile, "TemporaryFile", lambda **_: Full())
    with pytest.raises(StoreError, match=r"cannot be unpacked in .*No space left"):
        SpooledSource("azure", tmp_path / "a.mkv", [SensorFrame(_color(0), _counts(0), 0.0)], None, 1000.0)


def test_too_long_recordings(tmp_path, monkeypatch):
    monkeypatch.setattr(open3d_sensors, "_MAX_FRAMES", 2)
    frames = [SensorFrame(_color(0), _counts(0), 0.1 * i) for i in range(3)]
    with pytest.raises(FileFormatError, match="at most 2 frames"):
        SpooledSource("azure", tmp_path / "a.mkv", frames, None, 1000.0)
