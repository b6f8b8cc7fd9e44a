"""Folders of TrueDepth frames: the real recording of a mannequin, and frames made here."""

import json

import numpy as np
import pytest
from scipy.spatial import cKDTree

from facewright.camera.depth_map import back_project
from facewright.capture.recording import open_recording
from facewright.errors import FileFormatError, StoreError
from facewright.io.ply import read_ply
from facewright.numeric.rotation import matrix_from_rotation_vector

SIZE = (12, 16)


def _header(**changes):
    camera = {
        "intrinsic_matrix": [150.0, 0, 0, 0, 150.0, 0, 80.0, 60.0, 1],
        "intrinsic_matrix_reference_dimensions_width": 160.0,
        "intrinsic_matrix_reference_dimensions_height": 120.0,
        **changes,
    }
    return {"camera_intrinsics": camera, "width": SIZE[1], "height": SIZE[0], "timestamp": 3.5}


def _write(path, header=None, metres=None, n_color=SIZE[0] * SIZE[1], text=None):
    text = (json.dumps(_header() if header is None else header) if text is None else text).encode() + b"\0\0\0"
    if metres is None:
        metres = np.full(SIZE, 0.45, np.float32) + 0.001 * np.arange(SIZE[1], dtype=np.float32)
    rgb = np.full((n_color, 3), 0.5, np.float32)
    head = (
        f"ply\nformat binary_little_endian 1.0\nelement metadata {len(text)}\nproperty uchar char\n"
        f"element color {n_color}\nproperty float r\nproperty float g\nproperty float b\n"
        f"element depth {metres.size}\nproperty float d\nend_header\n"
    )
    path.parent.mkdir(exist_ok=True)
    path.write_bytes(head.encode() + text + rgb.tobytes() + metres.astype("<f4").tobytes())
    return path


@pytest.fixture
def folder(tmp_path):
    for i in range(3):
        _write(tmp_path / "scan" / f"frame-{i:03}.ply")
    return tmp_path / "scan"


def test_made_frames(folder):
    metres = np.full(SIZE, 0.45)
    metres[2, 3:7] = 9999.0, np.nan, -1.0, np.inf
    _write(folder / "frame-001.ply", metres=metres)
    recording = open_recording(folder)
    assert (recording.kind, recording.n_frames, recording.size) == ("truedepth", 3, SIZE)
    k = recording.intrinsics  # a tenth of the reference picture's
    np.testing.assert_allclose([k.focal_x, k.focal_y, k.centre_x, k.centre_y], [15, 15, 8, 6])
    frame = recording.frame(1)
    assert (frame.depth[2, 3:7] == 0).all() and np.isclose(frame.depth[0, 0], 450.0)
    assert (frame.color == 128).all() and frame.time == 3.5


def test_only_frames_are_frames(folder):
    (folder / "Expected.ply").write_text("ply\nformat ascii 1.0\nelement vertex 0\nproperty float x\nend_header\n")
    assert open_recording(folder).n_frames == 3


def test_lens_distortion_is_undone(folder):
    """Points of the border lie where the pinhole camera sees them; those near the centre hardly move."""
    y, x = np.mgrid[: SIZE[0], : SIZE[1]]
    metres = 0.4 + 0.005 * np.hypot(x - 8, y - 6)
    table = (0.05 * np.linspace(0, 1, 42)).tolist()
    lens = {
        "inverse_lens_distortion_lookup_table": table,
        "lens_distortion_center_x": 80.0,
        "lens_distortion_center_y": 60.0,
    }
    plain = _write(folder / "frame-001.ply", metres=metres)
    before = open_recording(folder).frame(1).depth
    _write(plain, _header(**lens), metres)
    after = open_recording(folder).frame(1).depth
    # looked up farther out by 5 % of r^2 / r_max: depth grows with radius by 5 mm a pixel
    expected = 5.0 * 0.05 * np.hypot(x - 8, y - 6) ** 2 / 10.0
    core = (slice(2, -2), slice(2, -2))
    assert np.abs((after - before) - expected)[core].max() < 0.6
    assert expected[core].max() > 0.9
    _write(plain, _header(**{**lens, "lens_distortion_center_x": None}), metres)
    with pytest.raises(FileFormatError, match="lens distortion"):
        open_recording(folder)


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"header": {"width": 16}}, "JSON with width and height"),
        ({"header": {**_header(), "width": 17}}, "17 x 12 colours and depths"),
        ({"text": "{broken"}, "JSON with width and height"),
        ({"n_color": 10}, "got 10 and 192"),
        ({"header": _header(intrinsic_matrix=[1, 2])}, "must say its camera_intrinsics"),
        ({"header": _header(intrinsic_matrix_reference_dimensions_width=0)}, "must say its camera_intrinsics"),
        ({"header": {"width": 16, "height": 12}}, "must say its camera_intrinsics"),
        ({"header": _header(inverse_lens_distortion_lookup_table=[0.0, 7.0])}, "lens distortion"),
    ],
)
def test_damaged_frames(folder, changes, message):
    _write(folder / "frame-000.ply", **changes)
    with pytest.raises(FileFormatError, match=message):
        open_recording(folder)


def test_truncated_frame(folder):
    file = folder / "frame-001.ply"
    file.write_bytes(file.read_bytes()[:-100])
    with pytest.raises(FileFormatError, match=r"frame-001\.ply must .*truncated"):
        open_recording(folder)


def test_folder_of_meshes_is_no_recording(tmp_path):
    (tmp_path / "a.ply").write_text("ply\nformat ascii 1.0\nelement vertex 0\nproperty float x\nend_header\n")
    with pytest.raises(FileFormatError, match="must be a TrueDepth frame"):
        open_recording(tmp_path)


def test_all_zero_depth(tmp_path):
    _write(tmp_path / "scan" / "frame-0.ply", metres=np.full(SIZE, 9999.0))
    with pytest.raises(FileFormatError, match="must have depth"):
        open_recording(tmp_path / "scan")


def test_frame_that_vanishes(folder):
    recording = open_recording(folder)
    for file in folder.iterdir():
        file.unlink()
    with pytest.raises(StoreError):
        recording._source._read.cache_clear()
        recording.frame(1)


def test_real_mannequin(test_data):
    """30 frames, sideways; the intrinsics as the data's notes give them; colours and times make sense."""
    recording = open_recording(test_data / "truedepth_mannequin")
    assert (recording.kind, recording.n_frames, recording.size) == ("truedepth", 30, (240, 320))
    k = recording.intrinsics
    np.testing.assert_allclose([k.focal_x, k.centre_x, k.centre_y], [298.57, 159.23, 119.10], atol=0.01)
    assert recording.warnings == ()
    upright = open_recording(test_data / "truedepth_mannequin", quarter_turns=3)
    frame = upright.frame(16)
    assert frame.size == (320, 240)
    # the skin fills the middle of the upright picture: red before blue, about 30 cm away
    face = frame.color[150:250, 90:160].reshape(-1, 3).mean(axis=0)
    assert face[0] > 1.5 * face[2]
    assert 250 < np.median(frame.depth[150:250, 90:160]) < 450


def test_real_frames_lie_on_the_cloud_that_came_with_them(test_data, monkeypatch):
    """A frame of the mannequin lies on the fused cloud of another program; the undone distortion makes it better."""
    from facewright.capture import truedepth

    rms = _rms_to_cloud(test_data / "truedepth_mannequin")
    monkeypatch.setattr(truedepth, "_lens", lambda *_: None)
    distorted = _rms_to_cloud(test_data / "truedepth_mannequin")
    assert rms < 0.36 and rms < 0.95 * distorted  # 0.31 against 0.35 mm


def _rms_to_cloud(folder):
    """Point-to-plane distance, mm, of the nearest 80 % of a frame's points after rigid alignment."""
    cloud = read_ply(folder / "Expected.ply")
    vertices, normals = 1000.0 * cloud.vertices.astype(float), cloud.normals.astype(float)
    tree = cKDTree(vertices)
    frame = open_recording(folder).frame(8)
    points = back_project(frame.depth, frame.intrinsics)[(frame.depth > 200) & (frame.depth < 480)][::5]
    R = np.array([[0.0, 0, 1], [0, -1, 0], [1, 0, 0]])  # how the cloud lies, roughly
    t = vertices.mean(axis=0) - R @ points.mean(axis=0)
    for _ in range(100):
        moved = points @ R.T + t
        distance, j = tree.query(moved)
        near = distance < np.quantile(distance, 0.8)
        n, arm = normals[j[near]], moved[near]
        rest = ((vertices[j[near]] - arm) * n).sum(axis=1)
        step = np.linalg.lstsq(np.hstack([np.cross(arm, n), n]), rest, rcond=None)[0]
        turn = matrix_from_rotation_vector(step[:3])
        R, t = turn @ R, turn @ t + step[3:]
    return float(np.sqrt((rest**2).mean()))
