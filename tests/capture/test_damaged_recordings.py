"""Whatever bytes are damaged, a recording is read or refused in one sentence: no other error comes out."""

import io
import json
import zipfile

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from PIL import Image

from facewright.camera.pinhole import Intrinsics
from facewright.capture.frame import RGBDFrame
from facewright.capture.recording import open_recording
from facewright.capture.tum_writer import write_tum_recording
from facewright.errors import FacewrightError

SIZE = (12, 16)
K = Intrinsics(15.0, 15.0, 8.0, 6.0)
DEPTH = np.linspace(500, 700, SIZE[0] * SIZE[1], dtype=np.float32).reshape(SIZE)
COLOR = np.arange(SIZE[0] * SIZE[1] * 3, dtype=np.uint8).reshape(*SIZE, 3)

changes = st.lists(st.tuples(st.floats(0, 1, exclude_max=True), st.integers(0, 255)), min_size=1, max_size=4)
many = settings(max_examples=30, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])


def _damage(data, places, cut):
    """Change bytes at places (shares of the length) and cut the end off."""
    damaged = bytearray(data)
    for place, value in places:
        damaged[int(place * len(damaged))] = value
    return bytes(damaged[: int(cut * len(damaged))])


def _read_or_refuse(path):
    try:
        frames = list(open_recording(path).frames())
    except FacewrightError as error:
        sentence = str(error)
        assert sentence.endswith(".") and "\n" not in sentence and "Traceback" not in sentence
        return
    assert all(f.depth.shape == f.color.shape[:2] for f in frames)


@pytest.fixture
def tum(tmp_path):
    write_tum_recording(tmp_path / "smile", [RGBDFrame(COLOR, DEPTH, K, i / 30) for i in range(3)])
    return tmp_path / "smile"


@many
@given(
    file=st.sampled_from(["rgb.txt", "depth.txt", "camera.json", "rgb/0.033333.jpg", "depth/0.033333.png"]),
    places=changes,
    cut=st.sampled_from([1.0, 1.0, 0.9, 0.5, 0.0]),
)
def test_tum(tum, file, places, cut):
    data = (tum / file).read_bytes()
    try:
        (tum / file).write_bytes(_damage(data, places, cut))
        _read_or_refuse(tum)
    finally:
        (tum / file).write_bytes(data)


def _r3d():
    jpeg, packed = io.BytesIO(), io.BytesIO()
    Image.fromarray(COLOR).save(jpeg, format="jpeg")
    meta = {"w": 16, "h": 12, "dw": 16, "dh": 12, "fps": 30, "K": [15, 0, 0, 0, 15, 0, 8, 6, 1]}
    lzfse = pytest.importorskip("imagecodecs").lzfse_encode
    with zipfile.ZipFile(packed, "w") as archive:
        archive.writestr("metadata", json.dumps(meta))
        archive.writestr("rgbd/0.jpg", jpeg.getvalue())
        archive.writestr("rgbd/0.depth", lzfse((DEPTH / 1000).tobytes()))
    return packed.getvalue()


def _ply():
    camera = {"intrinsic_matrix": [15, 0, 0, 0, 15, 0, 8, 6, 1], "intrinsic_matrix_reference_dimensions_width": 16}
    lens = {
        "inverse_lens_distortion_lookup_table": [0, 0.01, 0.02],
        "lens_distortion_center_x": 8,
        "lens_distortion_center_y": 6,
    }
    text = json.dumps({"camera_intrinsics": {**camera, **lens}, "width": 16, "height": 12, "timestamp": 1.5}).encode()
    head = (
        f"ply\nformat binary_little_endian 1.0\nelement metadata {len(text)}\nproperty uchar char\n"
        "element color 192\nproperty float r\nproperty float g\nproperty float b\n"
        "element depth 192\nproperty float d\nend_header\n"
    )
    return head.encode() + text + (COLOR / np.float32(255)).tobytes() + (DEPTH / np.float32(1000)).tobytes()


@many
@given(places=changes, cut=st.sampled_from([1.0, 1.0, 0.9, 0.5, 0.0]))
@pytest.mark.parametrize(("name", "make"), [("smile.r3d", _r3d), ("scan/frame-0.ply", _ply)])
def test_files(tmp_path, name, make, places, cut):
    file = tmp_path / name
    file.parent.mkdir(exist_ok=True)
    file.write_bytes(make())
    assert open_recording(file if file.suffix == ".r3d" else file.parent).n_frames == 1
    file.write_bytes(_damage(make(), places, cut))
    _read_or_refuse(file if file.suffix == ".r3d" else file.parent)


JSON = st.recursive(
    st.none() | st.booleans() | st.floats() | st.integers() | st.just(10**400) | st.text(max_size=3),
    lambda inner: st.lists(inner, max_size=10) | st.dictionaries(st.text(max_size=3), inner, max_size=3),
    max_leaves=12,
)


@many
@given(
    key=st.sampled_from(["width", "height", "fx", "cx", "depth_per_metre", "quarter_turns", "intrinsic_matrix"]),
    value=JSON,
)
def test_camera_files(tum, key, value):
    camera = json.loads((tum / "camera.json").read_text())
    try:
        (tum / "camera.json").write_text(json.dumps({**camera, key: value}))
        _read_or_refuse(tum)
    finally:
        (tum / "camera.json").write_text(json.dumps(camera))


@many
@given(
    key=st.sampled_from(["w", "h", "dw", "dh", "fps", "K", "perFrameIntrinsicCoeffs", "frameTimestamps"]), value=JSON
)
def test_record3d_metadata(tmp_path, key, value):
    old = zipfile.ZipFile(io.BytesIO(_r3d()))
    with zipfile.ZipFile(tmp_path / "a.r3d", "w") as archive:
        for name in old.namelist():
            meta = json.dumps({**json.loads(old.read("metadata")), key: value})
            archive.writestr(name, meta if name == "metadata" else old.read(name))
    _read_or_refuse(tmp_path / "a.r3d")


@many
@given(key=st.sampled_from(["width", "height", "timestamp", "camera_intrinsics"]), value=JSON)
def test_truedepth_metadata(tmp_path, key, value):
    head, _, rest = _ply().partition(b"end_header\n")
    end = rest.index(b"}" + (COLOR / np.float32(255)).tobytes()[:4]) + 1
    text = json.dumps({**json.loads(rest[:end]), key: value}).encode()
    old = f"metadata {end}\n".encode()
    assert old in head
    file = tmp_path / "frame-0.ply"
    file.write_bytes(head.replace(old, f"metadata {len(text)}\n".encode()) + b"end_header\n" + text + rest[end:])
    _read_or_refuse(tmp_path)
