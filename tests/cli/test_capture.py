"""facewright capture: answers for people and machines, one sentence for mistakes."""

import json

import numpy as np
import pytest

from facewright.camera.pinhole import Intrinsics
from facewright.capture.frame import RGBDFrame
from facewright.capture.tum_writer import write_tum_recording


@pytest.fixture
def captures(tmp_path):
    """One subject without a face."""
    depth = np.full((30, 40), 600.0, np.float32)
    k = Intrinsics(40, 40, 19.5, 14.5)
    frames = [RGBDFrame(np.full((30, 40, 3), 90, np.uint8), depth, k, i / 30) for i in range(3)]
    write_tum_recording(tmp_path / "captures" / "anna" / "neutral", frames)
    return tmp_path / "captures"


def test_show(invoke, captures, tmp_path):
    recording = captures / "anna" / "neutral"
    facts = json.loads(invoke("capture", "show", recording, "--turn", 1, "-o", tmp_path / "a.png", "--json").stdout)
    assert facts["frames"] == 3 and facts["width"] == 30 and (tmp_path / "a.png").is_file()
    text = invoke("capture", "show", recording).stdout
    assert "40 x 30" in text and "600 mm" in text and "Wrote" not in text
    saved = invoke("capture", "show", recording, "--turn", 2, "--save-turn")
    assert saved.exit_code == 0 and f"Noted 2 quarter turns in {recording / 'camera.json'}" in saved.stdout
    assert facts["turn_noted_in"] is None
    assert json.loads((recording / "camera.json").read_text())["quarter_turns"] == 2


def test_show_says_what_was_converted(invoke, captures):
    camera = captures / "anna" / "neutral" / "camera.json"
    camera.write_text(camera.read_text().replace("5000", "5"))
    assert "Note: Depths of" in invoke("capture", "show", captures / "anna" / "neutral").stdout


def test_show_refuses(refused, captures, tmp_path):
    assert "does not exist" in refused("capture", "show", tmp_path / "no.r3d")
    assert "must be a recording" in refused("capture", "show", tmp_path)
    assert "save_turn" in refused("capture", "show", captures / "anna" / "neutral", "--save-turn")
    assert "--turn must be" in refused("capture", "show", captures / "anna" / "neutral", "--turn", "5")
    (captures / "anna" / "neutral" / "camera.json").write_text("{")
    assert "camera.json must be JSON" in refused("capture", "show", captures / "anna" / "neutral")


def test_landmarks_refuses(refused, tmp_path):
    assert "must be a folder of captures" in refused("capture", "landmarks", tmp_path / "no")
    assert "one folder for each subject" in refused("capture", "landmarks", tmp_path)


@pytest.mark.landmarks
def test_landmarks_tells_what_failed(invoke, captures):
    pytest.importorskip("mediapipe")
    result = invoke("capture", "landmarks", captures, "--json")
    answer = json.loads(result.stdout)
    assert answer["written"] == [] and list(answer["failed"]) == ["anna/neutral"]
    assert "face" in answer["failed"]["anna/neutral"]
    text = invoke("capture", "landmarks", captures).stdout
    assert "No landmarks" in text and "Wrote 0 landmark files" in text
