"""track, retarget and animate on the command line: every mistake is one sentence and exit code 2."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from PIL import Image
from typer.testing import CliRunner

pytest.importorskip("av")

from facewright.cli.main import app


@pytest.fixture
def files(tmp_path: Path) -> Path:
    Image.fromarray(np.full((64, 64, 3), 128, np.uint8)).save(tmp_path / "photo.png")
    (tmp_path / "empty.mp4").touch()
    (tmp_path / "noise.mp4").write_bytes(b"no video at all")
    (tmp_path / "curves.csv").write_text("time,jawOpen\n0,0\n0.04,1\n")
    (tmp_path / "other.json").write_text('{"format": "else"}')
    (tmp_path / "other.csv").write_text("a,b\n1,2\n")
    return tmp_path


@pytest.mark.parametrize(
    "words, sentence",
    [
        (["retarget", "none.mp4", "photo.png", "-o", "out.mp4"], "none.mp4 does not exist"),
        (["retarget", "empty.mp4", "photo.png", "-o", "out.mp4"], "must be a video, got an empty file"),
        (["retarget", "noise.mp4", "photo.png", "-o", "out.mp4"], "must be a video that FFmpeg can read"),
        (["retarget", "photo.png", "photo.png", "-o", "out.mp4"], "got a still picture"),
        (["retarget", "noise.mp4", "photo.png", "-o", "out.avi"], "must end in .mp4"),
        (["retarget", "noise.mp4", "photo.png", "--head", "nod"], "head must be"),
        (["retarget", "noise.mp4", "photo.png", "--head-scale", "3"], "head_scale must be in [0, 2]"),
        (["retarget", "noise.mp4", "photo.png", "--face", "-1"], "--face must be at least 0"),
        (["track", "noise.mp4", "-o", "out.txt"], "must end in .csv or .json"),
        (["track", "none.mp4", "-o", "out.csv"], "does not exist"),
        (["animate", "photo.png", "--curves", "none.csv", "-o", "out.mp4"], "none.csv must be a readable file"),
        (["animate", "photo.png", "--curves", "other.csv", "-o", "out.mp4"], "names ARKit's shapes"),
        (["animate", "photo.png", "--curves", "other.json", "-o", "out.mp4"], "must be curves of `facewright track"),
        (["animate", "photo.png", "--curves", "none.json", "-o", "out.mp4"], "none.json must be a readable file"),
        (["animate", "photo.png", "--curves", "curves.csv", "-o", "no/out.mp4"], "does not exist"),
        (["animate", "photo.png", "--curves", "curves.csv", "-o", "out.mp4", "--fps", "0"], "in [1, 240]"),
        (["animate", "none.png", "--curves", "curves.csv", "-o", "out.mp4"], "none.png does not exist"),
        (["animate", "photo.png", "--curves", "curves.csv", "-o", "out.mp4", "--size", "3"], "[64, 8192]"),
        (["animate", "photo.png", "--curves", "curves.csv", "--sound", "none.wav", "-o", "out.mp4"], "none.wav"),
    ],
)
def test_mistakes_are_one_sentence(
    files: Path, monkeypatch: pytest.MonkeyPatch, words: list[str], sentence: str
) -> None:
    monkeypatch.chdir(files)
    before = sorted(path.name for path in files.iterdir())
    result = CliRunner().invoke(app, [*words, "--json"])
    assert result.exit_code == 2, result.output
    said = json.loads(result.stdout)["error"]["message"]
    assert sentence in said and said.endswith(".") and "\n" not in said
    assert sorted(path.name for path in files.iterdir()) == before


@pytest.mark.parametrize("verb", ["track", "retarget", "animate"])
def test_help_gives_examples(verb: str) -> None:
    result = CliRunner().invoke(app, [verb, "--help"])
    assert result.exit_code == 0 and f"facewright {verb}" in result.output


@pytest.mark.parametrize(
    "words, sentence",
    [
        (
            ["transfer", "a.png", "b.png", "--component", "ear"],
            "--component must be one of mouth, eyes, brows, nose, face",
        ),
        (["transfer", "a.png", "b.png", "-c", "ear"], "got 'ear'"),
        (["transfer", "a.png", "b.png", "--reference-face", "-2"], "--reference-face must be at least 0, got -2"),
        (["retarget", "a.mp4", "b.png", "--rest", "x"], "rest must be one of clip, camera, got 'x'"),
        (["retarget", "a.mp4", "b.png", "--quality", "99"], "--quality must be at most 51, got 99"),
        (["track", "a.mp4", "--face", "x"], "--face must be a whole number, got x"),
        (["edit", "a.png", "--set", "jaw width=1", "--focal", "x"], "--focal must be a number, got x"),
    ],
)
def test_wrong_choices_name_the_right_ones(words: list[str], sentence: str) -> None:
    result = CliRunner().invoke(app, [*words, "--json"])
    assert result.exit_code == 2
    said = json.loads(result.stdout)["error"]["message"]
    assert sentence in said and "Value error" not in said and said.endswith(".") and "\n" not in said
