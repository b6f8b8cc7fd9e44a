"""TUM-style folders: lists of times, folders without lists, cameras, and everything that can be wrong with them."""

import json

import numpy as np
import pytest
from PIL import Image

from facewright.camera.pinhole import Intrinsics
from facewright.capture.recording import open_recording
from facewright.capture.tum import TumSource, natural_key
from facewright.errors import FileFormatError, StoreError, ValueRangeError

SIZE = (24, 32)
CAMERA = {"width": 32, "height": 24, "fx": 30.0, "fy": 31.0, "cx": 15.5, "cy": 11.5, "depth_per_metre": 5000}
K = Intrinsics(30.0, 31.0, 15.5, 11.5)


def _depth(i):
    """Depth of frame `i`, mm."""
    y, x = np.mgrid[: SIZE[0], : SIZE[1]]
    depth = 500.0 + 10 * i + 2.0 * x + y
    depth[:2] = 0
    return depth


def _write_depth(path, i, per_metre=5000, size=SIZE):
    counts = np.round(_depth(i) * per_metre / 1000).astype(np.uint16)[: size[0], : size[1]]
    path.parent.mkdir(exist_ok=True)
    Image.fromarray(counts).save(path)


def _write_color(path, i, size=SIZE):
    path.parent.mkdir(exist_ok=True)
    Image.fromarray(np.full((*size, 3), 10 * i + 5, np.uint8)).save(path)


@pytest.fixture
def folder(tmp_path):
    """Four frames as the benchmark has them: colour and depth at slightly different times, a camera of ours."""
    folder = tmp_path / "smile"
    folder.mkdir()
    rgb, depth = ["# colour"], ["# depth"]
    for i in range(4):
        rgb.append(f"{100 + i / 30:.6f} rgb/{i}.png")
        depth.append(f"{100.004 + i / 30:.6f} depth/{i}.png")
        _write_color(folder / "rgb" / f"{i}.png", i)
        _write_depth(folder / "depth" / f"{i}.png", i)
    (folder / "rgb.txt").write_text("\n".join(rgb))
    (folder / "depth.txt").write_text("\n".join(depth) + "\n")
    (folder / "camera.json").write_text(json.dumps(CAMERA))
    return folder


def test_frames_come_in_millimetres(folder):
    recording = open_recording(folder)
    assert (recording.kind, recording.n_frames, recording.size, recording.warnings) == ("tum", 4, SIZE, ())
    assert recording.intrinsics == K
    for i, frame in enumerate(recording.frames()):
        assert np.abs(frame.depth - _depth(i)).max() <= 0.1  # half of the 0.2 mm step
        assert (frame.color == 10 * i + 5).all()
        assert frame.time == pytest.approx(100.004 + i / 30)
        assert frame.intrinsics == K


def test_depth_without_colour_is_left_out_and_said(folder):
    lines = (folder / "rgb.txt").read_text().splitlines()
    (folder / "rgb.txt").write_text("\n".join(lines[:2] + lines[3:]))
    recording = open_recording(folder)
    assert recording.n_frames == 3
    assert "1 of 4 depth pictures" in recording.warnings[0] and "left out" in recording.warnings[0]
    assert [int(f.color[0, 0, 0]) for f in recording.frames()] == [5, 25, 35]


def test_a_colour_picture_serves_one_depth_picture(folder):
    """Depth at twice the rate of colour: the nearest one of each pair stays."""
    lines = (folder / "depth.txt").read_text().splitlines()[1:]
    extra = [f"{float(line.split()[0]) + 0.011:.6f} {line.split()[1]}" for line in lines]
    (folder / "depth.txt").write_text("\n".join(lines + extra))
    recording = open_recording(folder)
    assert recording.n_frames == 4
    assert [f.time for f in recording.frames()] == pytest.approx([100.004 + i / 30 for i in range(4)])


def test_lists_in_any_order(folder, rng):
    for name in ("rgb.txt", "depth.txt"):
        lines = (folder / name).read_text().splitlines()
        rng.shuffle(lines)
        (folder / name).write_text("\n".join(lines))
    assert [int(f.color[0, 0, 0]) for f in open_recording(folder).frames()] == [5, 15, 25, 35]


def test_times_that_do_not_meet(folder):
    text = (folder / "rgb.txt").read_text().replace("100.", "200.")
    (folder / "rgb.txt").write_text(text)
    with pytest.raises(FileFormatError, match="colour within 20 ms of each depth picture"):
        open_recording(folder)


@pytest.mark.parametrize("depth_first", [False, True])
def test_list_of_pairs(folder, depth_first):
    pairs = [(f"{100 + i / 30:.6f} rgb/{i}.png", f"{100 + i / 30:.6f} depth/{i}.png") for i in (2, 0)]
    (folder / "associations.txt").write_text("\n".join(" ".join(p[:: -1 if depth_first else 1]) for p in pairs))
    assert [int(f.color[0, 0, 0]) for f in open_recording(folder).frames()] == [25, 5]


def test_folders_without_lists(folder):
    (folder / "rgb.txt").unlink()
    (folder / "depth.txt").unlink()
    (folder / "rgb").rename(folder / "color")
    for i in (10, 9):
        _write_color(folder / "color" / f"{i}.png", i)
        _write_depth(folder / "depth" / f"{i}.png", i)
    frames = list(open_recording(folder).frames())
    assert [int(f.color[0, 0, 0]) for f in frames] == [5, 15, 25, 35, 95, 105]
    assert frames[4].time == pytest.approx(4 / 30)
    (folder / "depth" / "9.png").unlink()
    with pytest.raises(FileFormatError, match=r"as many colour as depth pictures.*got 6 and 5"):
        open_recording(folder)


def test_natural_order():
    assert sorted(["f10", "f9", "f1b", "f1a"], key=natural_key) == ["f1a", "f1b", "f9", "f10"]


@pytest.mark.parametrize("per_metre", [5000, 1000, 10000])
def test_unstated_factor_is_guessed_and_said(folder, per_metre):
    for i in range(4):
        _write_depth(folder / "depth" / f"{i}.png", i, per_metre)
    camera = {key: value for key, value in CAMERA.items() if key != "depth_per_metre"}
    (folder / "camera.json").write_text(json.dumps(camera))
    recording = open_recording(folder)
    assert f"depth_per_metre: {per_metre} was taken" in recording.warnings[0]
    assert np.abs(recording.frame(1).depth - _depth(1)).max() <= 0.5
    assert open_recording(folder, depth_per_metre=per_metre).warnings == ()


def test_metres_taken_for_millimetres(folder):
    """The camera file is a thousand times off: told from the distances, and said."""
    for stated, word in ((5000_000, "metres"), (5, "micrometres"), (500, "centimetres")):
        (folder / "camera.json").write_text(json.dumps({**CAMERA, "depth_per_metre": stated}))
        if stated == 500:  # ten times too far: tenths of a millimetre
            word = "tenths of a millimetre"
        recording = open_recording(folder)
        assert word in recording.warnings[0]
        assert np.abs(recording.frame(2).depth - _depth(2)).max() <= 0.11


def test_open3d_camera_files(folder):
    (folder / "camera.json").unlink()
    matrix = [30.0, 0, 0, 0, 31.0, 0, 15.5, 11.5, 1]
    contents = {"width": 32, "height": 24, "intrinsic_matrix": matrix, "depth_scale": 5000.0}
    (folder / "intrinsic.json").write_text(json.dumps(contents))
    recording = open_recording(folder)
    assert recording.intrinsics == K and recording.warnings == ()


def test_missing_intrinsics(folder):
    (folder / "camera.json").unlink()
    with pytest.raises(FileFormatError, match=r"must say its camera's intrinsics, got none: add .*camera\.json"):
        open_recording(folder, depth_per_metre=5000)
    assert open_recording(folder, intrinsics=K, depth_per_metre=5000).frame(0).intrinsics == K


@pytest.mark.parametrize(
    "contents",
    [
        "no JSON",
        "[1, 2]",
        '{"width": 32, "height": 24, "fx": 30, "fy": 31, "cx": 15}',
        '{"width": 32, "height": 24, "fx": -30, "fy": 31, "cx": 15, "cy": 11}',
        '{"width": 32, "height": 24, "fx": NaN, "fy": 31, "cx": 15, "cy": 11}',
        '{"width": null, "height": 24, "fx": 30, "fy": 31, "cx": 15, "cy": 11}',
        '{"width": 32, "height": 24, "intrinsic_matrix": [1, 2]}',
        '{"width": 32, "height": 24, "fx": 30, "fy": 31, "cx": 15, "cy": 11, "depth_per_metre": 0}',
        '{"quarter_turns": 7}',
    ],
)
def test_damaged_camera_files(folder, contents):
    (folder / "camera.json").write_text(contents)
    with pytest.raises(FileFormatError, match=r"camera\.json must be"):
        open_recording(folder)


def test_intrinsics_of_another_size(folder):
    (folder / "camera.json").write_text(json.dumps({**CAMERA, "fx": 300.0, "fy": 310.0, "cx": 155.0, "cy": 115.0}))
    with pytest.raises(FileFormatError, match="must have intrinsics of its depth pictures, 32 x 24"):
        open_recording(folder)
    (folder / "camera.json").write_text(json.dumps({**CAMERA, "width": 320, "height": 240}))
    with pytest.raises(
        FileFormatError, match=r"0\.png must be 320 x 240 as the folder's camera file says, got 32 x 24"
    ):
        open_recording(folder)


def test_frame_of_another_size(folder):
    _write_depth(folder / "depth" / "1.png", 1, size=(12, 16))
    recording = open_recording(folder)
    with pytest.raises(FileFormatError, match=r"1\.png must be 32 x 24"):
        recording.frame(1)


def test_colour_of_another_size(folder):
    _write_color(folder / "rgb" / "1.png", 1, (48, 64))  # same view, finer
    _write_color(folder / "rgb" / "2.png", 2, (32, 24))  # turned
    recording = open_recording(folder)
    assert recording.frame(1).color.shape == (*SIZE, 3) and (recording.frame(1).color == 15).all()
    with pytest.raises(FileFormatError, match=r"colour of frame 2 .* got 24 x 32"):
        recording.frame(2)


@pytest.mark.parametrize("kind", ["rgb", "depth"])
def test_truncated_picture(folder, kind):
    file = folder / kind / "1.png"
    file.write_bytes(file.read_bytes()[:60])
    recording = open_recording(folder)
    with pytest.raises(FileFormatError, match=rf"{kind}/1\.png must be a whole picture, got one that is truncated"):
        list(recording.frames())
    assert recording.frame(0).time > 0  # the others can still be read


def test_missing_picture(folder):
    (folder / "depth" / "1.png").unlink()
    with pytest.raises(StoreError, match=r"1\.png does not exist, but the recording's list names it"):
        open_recording(folder)


def test_depth_without_any_colour(folder):
    (folder / "rgb.txt").unlink()
    for file in (folder / "rgb").iterdir():
        file.unlink()
    (folder / "rgb").rmdir()
    with pytest.raises(FileFormatError, match="must have colour pictures in a folder rgb"):
        open_recording(folder)


def test_colour_without_any_depth(folder):
    (folder / "depth.txt").unlink()
    for file in (folder / "depth").iterdir():
        file.unlink()
    (folder / "depth").rmdir()
    with pytest.raises(FileFormatError, match="must have depth pictures in a folder depth"):
        open_recording(folder)


def test_all_zero_depth(folder):
    for i in range(4):
        Image.fromarray(np.zeros(SIZE, np.uint16)).save(folder / "depth" / f"{i}.png")
    with pytest.raises(FileFormatError, match="must have depth, got frames without any"):
        open_recording(folder)


def test_a_frame_without_depth_among_others(folder):
    for i in (0, 2, 3):  # the ones that are looked at first
        Image.fromarray(np.zeros(SIZE, np.uint16)).save(folder / "depth" / f"{i}.png")
    frames = list(open_recording(folder).frames())
    assert [bool(f.depth.any()) for f in frames] == [False, True, False, False]


def test_nan_depth(folder):
    """Float depth in metres, as some write TIFFs: NaN, infinite and negative are none."""
    for i in range(4):
        metres = (_depth(i) / 1000).astype(np.float32)
        metres[5, 5:8] = np.nan, np.inf, -1.0
        (folder / "depth" / f"{i}.png").unlink()
        Image.fromarray(metres).save(folder / "depth" / f"{i}.tif")
    (folder / "depth.txt").write_text((folder / "depth.txt").read_text().replace("png", "tif"))
    (folder / "camera.json").write_text(json.dumps({**CAMERA, "depth_per_metre": 1}))
    recording = open_recording(folder)
    assert recording.warnings == ()
    depth = recording.frame(1).depth
    assert (depth[5, 5:8] == 0).all()
    assert np.abs(depth - _depth(1))[6:].max() < 0.01
    for i in range(4):
        Image.fromarray(np.full(SIZE, np.nan, np.float32)).save(folder / "depth" / f"{i}.tif")
    with pytest.raises(FileFormatError, match="must have depth"):
        open_recording(folder)


def test_saturated_depth_is_none(folder):
    counts = np.round(_depth(0) * 5).astype(np.uint16)
    counts[10, 10] = 65535
    Image.fromarray(counts).save(folder / "depth" / "0.png")
    assert open_recording(folder).frame(0).depth[10, 10] == 0


@pytest.mark.parametrize(
    ("line", "message"),
    [
        ("abc rgb/0.png", "must have times in seconds, got 'abc'"),
        ("nan rgb/0.png", "must have times in seconds"),
        ("100.0", "must have 2 words a line"),
        ("100.0 ../other/0.png", "must list files inside it"),
        ("100.0 /etc/passwd", "must list files inside it"),
    ],
)
def test_damaged_lists(folder, line, message):
    (folder / "rgb.txt").write_text(line + "\n")
    with pytest.raises(FileFormatError, match=message):
        open_recording(folder)


def test_lists_that_are_no_text_or_empty(folder):
    (folder / "rgb.txt").write_bytes(b"\xff\xfe\x00\x80")
    with pytest.raises(FileFormatError, match="must be a text"):
        open_recording(folder)
    (folder / "rgb.txt").write_text("# nothing\n")
    with pytest.raises(FileFormatError, match=r"rgb\.txt must name at least one picture"):
        open_recording(folder)


@pytest.mark.parametrize("value", [0.0, -1.0, np.inf, np.nan])
def test_factor_must_be_positive(folder, value):
    with pytest.raises(ValueRangeError, match="depth_per_metre must be positive"):
        TumSource(folder, value)
