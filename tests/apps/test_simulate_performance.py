import json

import numpy as np
import pytest

from facewright.apps.simulate_performance import SimulatePerformanceRequest, simulate_performance
from facewright.errors import StoreError, ValueRangeError
from facewright.faces.performers import simulate_performers
from facewright.io.markers import read_markers


@pytest.fixture(scope="module")
def session(tmp_path_factory):
    """Two performers' session of a few clips, with the true surfaces."""
    out = tmp_path_factory.mktemp("session") / "s"
    steps = []
    request = SimulatePerformanceRequest(
        out, seed=3, format="csv", performers=("F1", "F2"), clips=("neutral", "rage_05"), meshes=True, curves="none"
    )
    result = simulate_performance(request, lambda *step: steps.append(step))
    return out, result, steps


def test_markers_are_those_of_the_performers(builtin_face, session):
    out, result, steps = session
    assert sorted(path.name for path in out.iterdir()) == ["F1", "F2", "manifest.json"]
    (performer,) = simulate_performers(builtin_face, np.random.default_rng(3), names=("F2",))
    clip = performer.clip("rage_05")
    found = read_markers(out / "F2" / "rage_05.csv").markers
    assert found.labels == performer.layout.labels and found.positions.shape[0] == clip.n_frames
    assert np.allclose(found.times, clip.performance.times, atol=1e-4)
    error = np.abs(found.positions - clip.marker_truth())
    assert np.nanmedian(error) < 0.2 and 0.9 < found.seen.mean() < 1.0
    assert result.n_clips == 4 and result.performers["F2"] == len(performer.layout.labels)
    assert result.range_of_motion == ""
    assert steps[-1] == ("writing clips", 4, 4) and ("simulating performers", 2, 2) in steps


def test_the_manifest_says_what_is_there(session):
    out, result, _ = session
    manifest = json.loads((out / "manifest.json").read_text(encoding="utf-8"))
    assert (manifest["seed"], manifest["face"], manifest["units"]) == (3, "builtin", "mm")
    clips = manifest["performers"]["F1"]["clips"]
    assert clips["rage_05"]["set"] == "test" and clips["neutral"]["set"] == "other"
    assert clips["rage_05"]["emotion"] == "rage" and "mistakes" in clips["rage_05"]["text"]
    assert sum(c["frames"] for p in manifest["performers"].values() for c in p["clips"].values()) == result.n_frames
    assert all((out / c["file"]).is_file() for p in manifest["performers"].values() for c in p["clips"].values())


def test_surfaces_lie_under_the_markers(session):
    out, _, _ = session
    with np.load(out / "F1" / "meshes" / "rage_05.npz") as file:
        times, vertices = file["times"], file["vertices"]
    found = read_markers(out / "F1" / "rage_05.csv").markers
    assert np.allclose(np.diff(times), 1 / 15)
    rows = np.searchsorted(found.times, times - 1e-4)
    middle = np.nanmean(found.positions[rows], axis=1)
    assert np.abs(vertices.mean(axis=1) - middle).max() < 120  # one place in the laboratory, not two


def test_sessions_grow_but_never_change(session):
    out, _, _ = session
    words = {"seed": 3, "format": "csv", "clips": ("neutral",), "curves": "none"}
    with pytest.raises(StoreError, match="F2 already"):
        simulate_performance(SimulatePerformanceRequest(out, performers=("M1", "F2"), **words))
    with pytest.raises(StoreError, match="another face, seed or format"):
        simulate_performance(SimulatePerformanceRequest(out, performers=("M2",), **{**words, "seed": 4}))
    simulate_performance(SimulatePerformanceRequest(out, performers=("M2",), **words))
    manifest = json.loads((out / "manifest.json").read_text(encoding="utf-8"))
    assert list(manifest["performers"]) == ["F1", "F2", "M2"]


def test_nothing_is_left_of_a_performer_that_failed(tmp_path):
    def stop(stage, done, total):
        if stage == "writing clips" and done == 2:
            raise KeyboardInterrupt

    request = SimulatePerformanceRequest(
        tmp_path / "s", format="csv", performers=("F1",), clips=("neutral", "rage_05"), curves="none"
    )
    with pytest.raises(KeyboardInterrupt):
        simulate_performance(request, stop)
    assert list(tmp_path.iterdir()) == []


def test_mistakes_are_refused(tmp_path):
    with pytest.raises(ValueRangeError, match="seed"):
        SimulatePerformanceRequest(tmp_path, seed=-1)
    with pytest.raises(ValueRangeError, match="xml"):
        SimulatePerformanceRequest(tmp_path, format="xml")
    with pytest.raises(ValueRangeError, match="M3"):
        simulate_performance(SimulatePerformanceRequest(tmp_path / "a", performers=("M3",)))
    with pytest.raises(ValueRangeError, match="facs_01"):
        simulate_performance(
            SimulatePerformanceRequest(tmp_path / "a", performers=("F1",), clips=("facs_01",), curves="none")
        )
    (tmp_path / "file").write_text("")
    with pytest.raises(StoreError, match="got a file"):
        simulate_performance(SimulatePerformanceRequest(tmp_path / "file", curves="none"))
    (tmp_path / "m").mkdir()
    (tmp_path / "m" / "manifest.json").write_text("[]")
    with pytest.raises(StoreError, match="another file"):
        simulate_performance(SimulatePerformanceRequest(tmp_path / "m", curves="none"))
    assert not (tmp_path / "a").exists()
