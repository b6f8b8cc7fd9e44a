"""Record3D files: written here as the app writes them, read back, damaged in every way."""

import io
import json
import sys
import zipfile

import numpy as np
import pytest
from PIL import Image

from facewright.camera.pinhole import Intrinsics
from facewright.capture.recording import open_recording
from facewright.errors import FileFormatError, MissingExtraError, StoreError

DEPTH_SIZE, COLOR_SIZE = (32, 24), (64, 48)
K = Intrinsics(60.0, 61.0, 23.5, 31.5)  # of the colour picture


def _metres(i):
    y, x = np.mgrid[: DEPTH_SIZE[0], : DEPTH_SIZE[1]]
    metres = (0.4 + 0.01 * i + 0.002 * x + 0.001 * y).astype(np.float32)
    metres[0] = np.nan
    return metres


def _jpeg(i):
    buffer = io.BytesIO()
    Image.fromarray(np.full((*COLOR_SIZE, 3), 60 + 20 * i, np.uint8)).save(buffer, format="jpeg", quality=95)
    return buffer.getvalue()


def _meta(**changes):
    return {
        "w": COLOR_SIZE[1],
        "h": COLOR_SIZE[0],
        "dw": DEPTH_SIZE[1],
        "dh": DEPTH_SIZE[0],
        "fps": 60,
        "K": [K.focal_x, 0, 0, 0, K.focal_y, 0, K.centre_x, K.centre_y, 1],  # column after column
        "frameTimestamps": [0.0, 0.017, 0.033],
        **changes,
    }


def _write(path, meta=None, *, pack=None, leave_out=(), confidence=None, extra=()):
    """Write three frames; `pack` compresses depth, as LZFSE where absent."""
    if pack is None:
        pack = pytest.importorskip("imagecodecs").lzfse_encode
    with zipfile.ZipFile(path, "w") as archive:
        members = {"metadata": json.dumps(_meta() if meta is None else meta)}
        for i in range(3):
            members[f"rgbd/{i}.jpg"] = _jpeg(i)
            members[f"rgbd/{i}.depth"] = pack(_metres(i).tobytes())
            if confidence is not None:
                members[f"rgbd/{i}.conf"] = pack(confidence.tobytes())
        for name, data in {**members, **dict(extra)}.items():
            if name not in leave_out:
                archive.writestr(name, data)
    return path


def test_frames_on_the_grid_of_the_depth(tmp_path):
    recording = open_recording(_write(tmp_path / "smile.r3d"))
    assert (recording.kind, recording.n_frames, recording.size) == ("record3d", 3, DEPTH_SIZE)
    assert recording.warnings == ()
    # half the pixels: focal lengths halve, and the picture's middle stays its middle
    k = recording.intrinsics
    np.testing.assert_allclose([k.focal_x, k.focal_y, k.centre_x, k.centre_y], [30.0, 30.5, 11.5, 15.5])
    for i, frame in enumerate(recording.frames()):
        np.testing.assert_allclose(frame.depth[1:], 1000 * _metres(i)[1:], rtol=1e-6)
        assert (frame.depth[0] == 0).all()
        assert np.abs(frame.color.astype(int) - (60 + 20 * i)).max() <= 2
        assert frame.time == [0.0, 0.017, 0.033][i]


def test_cameras_per_frame_win(tmp_path):
    per_frame = [[60.0 + i, 61.0, 23.5, 31.5] for i in range(3)]
    recording = open_recording(_write(tmp_path / "a.r3d", _meta(perFrameIntrinsicCoeffs=per_frame)))
    assert [f.intrinsics.focal_x for f in recording.frames()] == [30.0, 30.5, 31.0]


def test_low_confidence_is_no_depth(tmp_path):
    confidence = np.full(DEPTH_SIZE, 2, np.uint8)
    confidence[10, 10:12] = 0, 1
    depth = open_recording(_write(tmp_path / "a.r3d", confidence=confidence)).frame(1).depth
    assert depth[10, 10] == 0 and depth[10, 11] > 0


def test_depth_that_is_not_compressed(tmp_path):
    recording = open_recording(_write(tmp_path / "a.r3d", pack=bytes))
    np.testing.assert_allclose(recording.frame(2).depth[1:], 1000 * _metres(2)[1:], rtol=1e-6)


def test_times_from_the_rate_and_sizes_without_dw(tmp_path):
    meta = _meta(w=DEPTH_SIZE[1], h=DEPTH_SIZE[0])
    for key in ("dw", "dh", "frameTimestamps"):
        meta.pop(key)
    meta["K"] = [30, 0, 0, 0, 30, 0, 12, 16, 1]
    recording = open_recording(_write(tmp_path / "a.r3d", meta, pack=bytes))
    assert recording.size == DEPTH_SIZE
    assert [f.time for f in recording.frames()] == pytest.approx([0, 1 / 60, 2 / 60])


def test_millimetres_where_metres_should_be(tmp_path):
    pack = lambda data: (np.frombuffer(data, np.float32) * 1000).tobytes()  # noqa: E731
    recording = open_recording(_write(tmp_path / "a.r3d", pack=pack))
    assert "multiplied by 0.001" in recording.warnings[0]
    np.testing.assert_allclose(recording.frame(2).depth[1:], 1000 * _metres(2)[1:], rtol=1e-5)


def test_depth_without_colour(tmp_path):
    recording = open_recording(_write(tmp_path / "a.r3d", pack=bytes, leave_out=["rgbd/1.jpg"]))
    assert recording.n_frames == 2 and "1 of 3 depth pictures" in recording.warnings[0]
    assert [f.time for f in recording.frames()] == [0.0, 0.033]
    with pytest.raises(FileFormatError, match="must have colour with its depth, got 3"):
        open_recording(_write(tmp_path / "b.r3d", pack=bytes, leave_out=[f"rgbd/{i}.jpg" for i in range(3)]))


def test_no_frames(tmp_path):
    names = [f"rgbd/{i}.{kind}" for i in range(3) for kind in ("jpg", "depth")]
    with pytest.raises(FileFormatError, match="at least one frame"):
        open_recording(_write(tmp_path / "a.r3d", pack=bytes, leave_out=names))


@pytest.mark.parametrize("cut", [0, 10, 300, 0.5, 0.99])
def test_truncated_files(tmp_path, cut):
    path = _write(tmp_path / "a.r3d", pack=bytes)
    data = path.read_bytes()
    path.write_bytes(data[: int(cut * len(data)) if isinstance(cut, float) else cut])
    with pytest.raises(FileFormatError, match="truncated or foreign"):
        open_recording(path)


def test_damaged_bytes_inside(tmp_path):
    path = _write(tmp_path / "a.r3d", pack=bytes)
    data = bytearray(path.read_bytes())
    at = data.find(_metres(1).tobytes()) + 500
    data[at : at + 8] = b"\0" * 8
    path.write_bytes(data)
    with pytest.raises(FileFormatError, match=r"rgbd/1\.depth of .* must be whole"):
        open_recording(path)  # the middle frame is looked at


@pytest.mark.parametrize(
    ("data", "message"),
    [(b"bvx2 nonsense", "must be LZFSE data"), (b"", "must be LZFSE data"), (bytes(4), "must be LZFSE data")],
)
def test_depth_that_is_no_lzfse(tmp_path, data, message):
    pytest.importorskip("imagecodecs")
    with pytest.raises(FileFormatError, match=message):
        open_recording(_write(tmp_path / "a.r3d", pack=lambda _: data))


@pytest.mark.parametrize("size", [10, 4000])
def test_depth_of_another_size(tmp_path, size):
    encode = pytest.importorskip("imagecodecs").lzfse_encode
    with pytest.raises(FileFormatError, match=r"rgbd/0\.depth of .* must"):
        open_recording(_write(tmp_path / "a.r3d", pack=lambda _: encode(bytes(size))))


@pytest.mark.parametrize(
    ("meta", "message"),
    [
        ([], "as metadata"),
        ({"w": 1}, "as metadata"),
        (_meta(dw=-4), "must have depth of 1 to"),
        (_meta(dw=10**9), "must have depth of 1 to"),
        (_meta(K=[1, 2]), "must state its camera"),
        (_meta(K=None, perFrameIntrinsicCoeffs=5), "must state its camera"),
        (_meta(w=0), "must state its camera"),
    ],
)
def test_damaged_metadata(tmp_path, meta, message):
    with pytest.raises(FileFormatError, match=message):
        open_recording(_write(tmp_path / "a.r3d", meta, pack=bytes))


def test_missing_intrinsics_can_be_given_beside_the_file(tmp_path):
    meta = _meta()
    del meta["K"]
    path = _write(tmp_path / "smile.r3d", meta, pack=bytes)
    with pytest.raises(FileFormatError, match=r"add .*smile\.camera\.json"):
        open_recording(path)
    camera = {"width": 24, "height": 32, "fx": 30, "fy": 30, "cx": 11, "cy": 15}
    (tmp_path / "smile.camera.json").write_text(json.dumps(camera))
    assert open_recording(path).intrinsics == Intrinsics(30, 30, 11, 15)


def test_zip_of_something_else(tmp_path):
    with pytest.raises(FileFormatError, match="a ZIP without"):
        open_recording(_write(tmp_path / "a.r3d", pack=bytes, leave_out=["metadata"]))


def test_names_that_are_no_numbers_are_ignored(tmp_path):
    extra = {"rgbd/²3.depth": b"", "rgbd/x.depth": b"", "sound.m4a": b"", "icon": b""}
    assert open_recording(_write(tmp_path / "a.r3d", pack=bytes, extra=extra)).n_frames == 3


def test_without_imagecodecs_the_extra_is_named(tmp_path, monkeypatch):
    path = _write(tmp_path / "a.r3d")
    monkeypatch.setitem(sys.modules, "imagecodecs", None)
    with pytest.raises(MissingExtraError, match=r'pip install "facewright\[capture\]"'):
        open_recording(path)


def test_missing_file(tmp_path):
    with pytest.raises(StoreError, match="does not exist"):
        open_recording(tmp_path / "a.r3d")
