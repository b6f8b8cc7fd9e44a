"""Performances as JSON: what is written reads back, what contradicts itself is refused with one sentence."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from facewright.apps.performance_files import read_performance, write_performance_csv
from facewright.apps.performance_json import read_performance_json, write_performance_json
from facewright.camera.rotation import rotation_from_head_angles
from facewright.errors import FileFormatError, StoreError
from facewright.faces.blendshape_names import BLENDSHAPE_NAMES
from facewright.models.performance import Performance


@pytest.fixture
def acted(rng: np.random.Generator) -> Performance:
    T = 7
    rotations = np.array([rotation_from_head_angles(*rng.uniform(-25, 25, 3)) for _ in range(T)])
    tracked = np.arange(T) != 3
    times = 1.4 + np.cumsum(rng.uniform(0.02, 0.06, T))
    gaze, places = rng.uniform(-0.3, 0.3, (T, 2, 2)), rng.normal(0, 100, (T, 3))
    return Performance(times, BLENDSHAPE_NAMES, rng.uniform(0, 1, (T, 46)), rotations, places, gaze, tracked)


def test_written_json_reads_the_same(tmp_path: Path, acted: Performance) -> None:
    cuts = np.array([0, 0, 1, 0, 0, 1, 0], bool)
    write_performance_json(tmp_path / "a.json", acted, cuts, {"residuals_iod": [None] * 7})
    again, notes, shots = read_performance(tmp_path / "a.json")
    assert again.names == acted.names and notes == ("1 of 7 frames is untracked.",)
    np.testing.assert_array_equal(shots, cuts)
    np.testing.assert_array_equal(again.tracked, acted.tracked)
    np.testing.assert_array_equal(again.times, acted.times)
    np.testing.assert_allclose(again.weights, acted.weights, atol=5.1e-7)
    np.testing.assert_allclose(again.rotations, acted.rotations, atol=2e-8)
    np.testing.assert_allclose(again.translations, acted.translations, atol=5.1e-5)
    np.testing.assert_allclose(again.gaze, acted.gaze, atol=5.1e-7)
    write_performance_json(tmp_path / "b.json", again, shots)
    twice = read_performance(tmp_path / "b.json").performance
    for name in ("times", "weights", "rotations", "translations", "gaze", "tracked"):
        np.testing.assert_array_equal(getattr(twice, name), getattr(again, name))


def test_json_and_csv_say_the_same(tmp_path: Path, acted: Performance) -> None:
    write_performance_json(tmp_path / "a.json", acted)
    write_performance_csv(tmp_path / "a.csv", acted)
    ours, theirs = (read_performance(tmp_path / name).performance for name in ("a.json", "a.csv"))
    seen = acted.tracked
    # the 52 shapes have one column for both inner brows, for both cheeks, and for the look down of lids and eyes
    same = [k for k, name in enumerate(BLENDSHAPE_NAMES) if not name.startswith(("browInner", "cheekPuff", "eyesLook"))]
    np.testing.assert_allclose(ours.weights[seen][:, same], theirs.weights[seen][:, same], atol=1e-6)
    np.testing.assert_allclose(ours.rotations[seen], theirs.rotations[seen], atol=1e-6)
    np.testing.assert_allclose(ours.gaze[seen], theirs.gaze[seen], atol=1e-6)
    np.testing.assert_allclose(np.diff(ours.times), np.diff(theirs.times), atol=2e-4)


def test_what_may_be_absent_and_what_is_odd(tmp_path: Path, acted: Performance) -> None:
    path = tmp_path / "a.json"
    write_performance_json(path, acted)
    content = json.loads(path.read_text())
    for key in ("translations", "gaze", "tracked", "cuts", "head_angles", "units"):
        del content[key]
    content["names"][0] = "grin"
    content["weights"][2][5] = 1.5
    path.write_text(json.dumps(content))
    again, cuts, notes = read_performance_json(path)
    assert again.names == BLENDSHAPE_NAMES[1:] and again.tracked.all() and not cuts.any() and not again.gaze.any()
    assert again.weights[2, 4] == 1.0
    assert len(notes) == 2 and "'grin' is unknown" in notes[0] and "1 value outside [0, 1] clipped" in notes[1]


def changed(key: str, value: Any) -> Callable[[dict[str, Any]], None]:
    def change(content: dict[str, Any]) -> None:
        content[key] = value

    return change


def without(key: str) -> Callable[[dict[str, Any]], None]:
    def change(content: dict[str, Any]) -> None:
        del content[key]

    return change


@pytest.mark.parametrize(
    "change, sentence",
    [
        (changed("format", "facewright photo fit"), "got the format 'facewright photo fit'"),
        (without("format"), "got other JSON"),
        (changed("version", 9), "must be of version 1"),
        (without("weights"), "must hold 7 x 46 finite numbers as 'weights'"),
        (changed("weights", [[0.0] * 46] * 6), "must hold 7 x 46 finite numbers as 'weights'"),
        (changed("weights", [[0.0] * 45 + ["a"]] * 7), "finite numbers as 'weights'"),
        (changed("weights", [[0.0] * 45 + [float("nan")]] * 7), "finite numbers as 'weights'"),
        (changed("gaze", 3), "must hold 7 x 2 x 2 finite numbers as 'gaze'"),
        (changed("times", [0.0] * 7), "times must increase"),
        (changed("times", []), "at least one frame"),
        (changed("names", ["jawOpen"] * 46), "name every shape once"),
        (changed("names", [f"x{k}" for k in range(46)]), "must name shapes of facewright's"),
        (changed("rotations", [np.diag([1.0, 1.0, -1.0]).tolist()] * 7), "another in frame 0"),
        (changed("rotations", [(2 * np.eye(3)).tolist()] * 7), "must hold rotation matrices"),
        (changed("tracked", [1] * 7), "7 times true or false"),
        (changed("cuts", [7]), "numbers of its 7 frames"),
    ],
)
def test_contradictions_are_one_sentence(
    tmp_path: Path, acted: Performance, change: Callable[[dict[str, Any]], None], sentence: str
) -> None:
    path = tmp_path / "a.json"
    write_performance_json(path, acted)
    content = json.loads(path.read_text())
    change(content)
    path.write_text(json.dumps(content))
    with pytest.raises(FileFormatError) as caught:
        read_performance(path)
    said = str(caught.value)
    assert sentence in said and said.startswith(str(path)) and said.endswith(".") and "\n" not in said


@pytest.mark.parametrize("text", ["", "{", "[1, 2]", "no json", "\x00", "[" * 100_000])
def test_other_files_are_refused(tmp_path: Path, text: str) -> None:
    (tmp_path / "a.json").write_text(text)
    with pytest.raises(FileFormatError, match=r"a\.json must be"):
        read_performance(tmp_path / "a.json")
    with pytest.raises(StoreError, match="readable file"):
        read_performance(tmp_path / "none.json")
