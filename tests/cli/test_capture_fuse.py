"""facewright capture fuse: its table and JSON, and one sentence for mistakes."""

import json

import numpy as np
import pytest

from facewright.camera.pinhole import Intrinsics
from facewright.capture.frame import RGBDFrame
from facewright.capture.tum_writer import write_tum_recording

CAMERA = Intrinsics(440.0, 440.0, 159.5, 119.5)


def _frames(n):
    """An egg of a head's size that keeps still before a wall; it shows no face."""
    y, x = np.mgrid[:240, :320].astype(float)
    d = np.stack([(x - 159.5) / 440.0, (y - 119.5) / 440.0, np.ones_like(x)], axis=2) / (75.0, 110.0, 95.0)
    c = np.array([0.0, 0.0, 645.0 / 95.0])
    a, b = (d * d).sum(axis=2), d @ c
    root = b * b - a * (c @ c - 1.0)
    bumps = 3.0 * np.sin(x / 12.0) * np.sin(y / 14.0)
    depth = np.where(root > 0, (b - np.sqrt(np.maximum(root, 0))) / a + bumps, 1200.0).astype(np.float32)
    for i in range(n):
        yield RGBDFrame(np.full((240, 320, 3), 120, np.uint8), depth.copy(), CAMERA, i / 30)


@pytest.fixture(scope="module")
def egg(tmp_path_factory):
    """A recording of three frames."""
    folder = tmp_path_factory.mktemp("captures") / "anna" / "neutral"
    write_tum_recording(folder, _frames(3))
    return folder


def test_table_and_files(invoke, egg, tmp_path):
    result = invoke("capture", "fuse", egg, "-o", tmp_path / "o", "--no-detector")
    assert result.exit_code == 0, result.output
    text = result.stdout
    for words in ("frames fused", "of 3", "noise of one frame", "drift", "face covered", "Note: The face was found by"):
        assert words in text
    assert "mesh" not in text and "depth.png" in text
    names = {"depth.png", "camera.json", "color.png", "report.json", "points.ply", "fusion.png"}
    assert {p.name for p in (tmp_path / "o").iterdir()} == names


def test_json(invoke, egg, tmp_path):
    result = invoke("capture", "fuse", egg, "-o", tmp_path / "o", "--no-detector", "--turn", "2", "--json")
    answer = json.loads(result.stdout)
    report = json.loads((tmp_path / "o" / "report.json").read_text())
    assert {key: answer[key] for key in report} == report
    assert answer["quarter_turns"] == 2 and answer["fusion"]["n_frames"] == 3
    assert answer["paths"]["depth"] == str(tmp_path / "o" / "depth.png")


def test_a_second_run_writes_over_the_first(invoke, egg, tmp_path):
    for _ in range(2):
        assert invoke("capture", "fuse", egg, "-o", tmp_path / "o", "--no-detector").exit_code == 0


def test_mistakes_take_one_sentence(refused, egg, tmp_path):
    out = tmp_path / "o"
    assert "engine must be" in refused("capture", "fuse", egg, "-o", out, "--engine", "nonsense")
    assert "frame must be" in refused("capture", "fuse", egg, "-o", out, "--frame", "nonsense")
    assert "--turn must be" in refused("capture", "fuse", egg, "-o", out, "--turn", "4")
    assert "does not exist" in refused("capture", "fuse", tmp_path / "no.r3d", "-o", out, "--no-detector")
    assert "'nobody'" in refused("capture", "fuse", egg, "-o", out, "--mesh", "--faces", "nobody")
    assert "folder of its own" in refused("capture", "fuse", egg, "-o", egg, "--no-detector")
    mesh = refused("capture", "fuse", egg, "-o", out, "--mesh", "--no-detector")
    assert "a mesh needs landmarks" in mesh and "detector" in mesh
    (egg / "landmarks-7.json").write_text("{")
    assert "landmarks-7.json" in refused("capture", "fuse", egg, "-o", out)
    (egg / "landmarks-7.json").unlink()
    assert not out.exists()


def test_recordings_without_a_head_take_one_sentence(refused, tmp_path):
    frames = [RGBDFrame(f.color, np.zeros_like(f.depth), CAMERA, f.time) for f in _frames(2)]
    write_tum_recording(tmp_path / "dark", frames)
    assert "depth" in refused("capture", "fuse", tmp_path / "dark", "-o", tmp_path / "o", "--no-detector")
    for frame in frames:
        frame.depth[50:60, 70:80] = 600.0
    write_tum_recording(tmp_path / "speck", frames)
    assert "depth of a head" in refused("capture", "fuse", tmp_path / "speck", "-o", tmp_path / "o", "--no-detector")
    assert not (tmp_path / "o").exists()


@pytest.mark.landmarks
def test_no_face_takes_one_sentence(refused, egg, tmp_path):
    pytest.importorskip("mediapipe", reason="needs the landmarks extra")
    assert "face" in refused("capture", "fuse", egg, "-o", tmp_path / "o")
    assert not (tmp_path / "o").exists()
