"""The shipped description of the detector's points is what the tool makes, and says how it was made."""

import importlib.util
from pathlib import Path

import numpy as np
import pytest

from facewright.landmarks.dense import MEASURED_FACES

ROOT = Path(__file__).parents[2]


def load_tool():
    spec = importlib.util.spec_from_file_location("measure_dense_landmarks", ROOT / "tools/measure_dense_landmarks.py")
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def load(path):
    with np.load(path, allow_pickle=False) as data:
        return dict(data)


@pytest.mark.parametrize("name", MEASURED_FACES)
def test_shipped_data_say_how_they_were_made(name):
    tool = load_tool()
    data = load(tool.DATA / f"dense478_{name}.npz")
    assert {key: data[key].item() for key in tool.SETTINGS} == tool.SETTINGS
    assert data["detector"].item() == "mediapipe 0.10.21"
    pyproject = (ROOT / "pyproject.toml").read_text(encoding="utf-8")
    assert data["detector"].item().replace(" ", "==") in pyproject  # the one that is installed with the extra
    np.testing.assert_array_equal(data["people"], np.arange(tool.N_PEOPLE))
    frames = len(tool.expressions(np.random.default_rng(0)))
    assert 0.95 * tool.N_PEOPLE * frames < data["n_frames"] <= tool.N_PEOPLE * frames
    assert data["n_people"] == tool.N_PEOPLE
    assert data["whitening"].shape == (tool.N_DIRECTIONS, 956)
    assert data["person_modes"].shape == (tool.N_MODES, 478, 2)


@pytest.mark.landmarks
def test_a_small_run_makes_the_same_kind_of_file(builtin_face, tmp_path, monkeypatch):
    pytest.importorskip("mediapipe")
    tool = load_tool()
    every = tool.expressions
    monkeypatch.setattr(tool, "expressions", lambda rng: every(rng)[::2])
    made = tmp_path / "small.npz"
    arguments = ["builtin", "--people", "2", "--jobs", "1", "--folder", str(tmp_path), "--out", str(made)]
    tool.main(arguments)
    small, shipped = load(made), load(tool.DATA / "dense478_builtin.npz")
    assert set(small) == set(shipped)
    for key in set(shipped) - {"people", "person_modes"}:
        assert small[key].shape == shipped[key].shape and small[key].dtype == shipped[key].dtype
    for key in (*tool.SETTINGS, "detector", "blendshape_names", "fingerprints"):
        np.testing.assert_array_equal(small[key], shipped[key])
    # two people tell the same of the detector, roughly
    at = builtin_face.mean_shape
    apart = np.linalg.norm(at[small["vertices"]] - at[shipped["vertices"]], axis=1)
    assert np.median(apart) < 4.0
    responses = [data["pose_response"].astype(float).ravel() for data in (small, shipped)]
    assert np.corrcoef(*responses)[0, 1] > 0.6
    # a second call draws nobody again, and makes the same file
    before = made.read_bytes()
    monkeypatch.setattr(tool, "gather", lambda *_: pytest.fail("drawn again"))
    tool.main(arguments)
    assert made.read_bytes() == before
    # one person is too few, and what was drawn otherwise is refused
    with pytest.raises(SystemExit, match="more people"):
        tool.main([*arguments, "--people", "1"])
    monkeypatch.setitem(tool.SETTINGS, "size", 100)
    with pytest.raises(SystemExit, match="remove it"):
        tool.main(arguments)
