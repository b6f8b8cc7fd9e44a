"""Learning region-based models from performers' data, and the command for it."""

import json
from dataclasses import replace

import numpy as np
import pytest

from facewright.apps.segment_regions import SegmentOptions
from facewright.apps.train_regions import TrainOptions, TrainRequest, train_from_files, train_regions
from facewright.cli.main import app
from facewright.errors import TopologyError, ValueRangeError
from facewright.models.performer_data import PerformerClip, PerformerData
from facewright.models.region_files import write_regions
from facewright.models.region_store import load_region_model
from facewright.models.regions import Regions
from facewright.models.sequence_store import save_performer

ROWS, COLUMNS = 8, 12
N = ROWS * COLUMNS


def _faces():
    grid = np.arange(N, dtype=np.int32).reshape(ROWS, COLUMNS)
    a, b, c, d = grid[:-1, :-1].ravel(), grid[:-1, 1:].ravel(), grid[1:, 1:].ravel(), grid[1:, :-1].ravel()
    return np.concatenate([np.stack([a, b, c], 1), np.stack([a, c, d], 1)])


def _performer(name, seed, template="mesh"):
    """Left and right halves of a sheet move on their own: two waves each, another amplitude for each performer."""
    rng = np.random.default_rng(seed)
    y, x = np.mgrid[0.0:ROWS, 0.0:COLUMNS]
    neutral = np.stack([8 * (x - 5.5), -8 * y, 0.1 * x * y], -1).reshape(N, 3).astype(np.float32)
    half = (neutral[:, :1] > 0).astype(float)
    patterns = [half * np.cos(neutral / 20 + k) for k in range(2)] + [
        (1 - half) * np.cos(neutral / 20 - k) for k in range(2)
    ]
    clips = []
    for number, count in enumerate((40, 30, 20)):
        moves = np.einsum("tk,knc->tnc", rng.normal(size=(count, 4)) * rng.uniform(1, 3), patterns)
        clips.append(
            PerformerClip(
                f"clip_{number + 1}",
                np.arange(count) / 60.0,
                (neutral + moves).astype(np.float32),
                np.tile(np.eye(3), (count, 1, 1)),
                np.zeros((count, 3)),
            )
        )
    return PerformerData(name, _faces(), neutral, neutral, tuple(clips), template, np.arange(N, dtype=np.int32))


def _regions():
    grid = np.arange(N, dtype=np.int32).reshape(ROWS, COLUMNS)
    return Regions(N, (np.sort(grid[:, :7].ravel()), np.sort(grid[:, 6:].ravel())), ("right", "left"))


def test_a_model_is_learned_and_measured_on_clips_left_out():
    performers = [_performer("M1", 1), _performer("F1", 2)]
    result = train_regions(performers, _regions(), TrainOptions(components=6, left_out=("clip_3",)))
    assert result.n_frames == 140
    assert set(result.train_rms_mm) == set(result.left_out_rms_mm) == {"M1", "F1"}
    assert max(result.left_out_rms_mm.values()) < 0.05
    assert result.model.provenance["template"] == "mesh"
    assert result.model.provenance["vertex_ids"] == list(range(N))
    np.testing.assert_array_equal(result.model.neutral, performers[0].neutral)


def test_fewer_components_reconstruct_worse():
    performers = [_performer("M1", 1)]
    few, more = (train_regions(performers, _regions(), TrainOptions(components=P)).train_rms_mm["M1"] for P in (1, 2))
    assert few > 2 * more


def test_options_are_heeded():
    performers = [_performer("M1", 1), _performer("F1", 2)]
    holistic = train_regions(performers, None, TrainOptions(holistic=True, neutral="F1", centred=True))
    assert len(holistic.model.bases) == 1 and holistic.model.means[0].any()
    np.testing.assert_array_equal(holistic.model.neutral, performers[1].neutral)
    thin = train_regions(performers, _regions(), TrainOptions(frames_per_second=20.0, clips=("clip_1",)))
    assert thin.n_frames == 28
    quick = SegmentOptions(max_regions=3, restarts=2)
    found = train_regions(performers, options=TrainOptions(components=0.99), segmentation=quick)
    assert len(found.model.bases) >= 2
    assert any("fewer than 15 components" in remark for remark in holistic.remarks)


def test_blendshapes_of_the_template(builtin_face):
    ids = np.sort(builtin_face.topology.masks["nose"][:N]).astype(np.int32)
    data = replace(_performer("M1", 1, "builtin"), vertex_ids=ids)
    model = train_regions([data], _regions(), TrainOptions(basis="blendshapes")).model
    assert all((low == 0).all() and (high == 1).all() for low, high in zip(model.lower, model.upper, strict=True))
    assert "right_noseSneer_L" in model.coefficient_names[0] or "left_noseSneer_L" in model.coefficient_names[1]
    with pytest.raises(TopologyError, match="blendshapes need"):
        train_regions([_performer("M1", 1)], _regions(), TrainOptions(basis="blendshapes"))


@pytest.mark.parametrize(
    ("performers", "options", "said"),
    [
        ([], {}, "at least one performer"),
        ([_performer("M1", 1), _performer("M1", 2)], {}, "different names"),
        ([_performer("M1", 1), replace(_performer("F1", 1), vertex_ids=np.arange(N)[::-1])], {}, "one mesh"),
        ([_performer("M1", 1)], {"clips": ("rage",)}, "clip must be one of"),
        ([_performer("M1", 1)], {"left_out": ("rage",)}, "clip must be one of"),
        ([_performer("M1", 1)], {"left_out": ("clip_1", "clip_2", "clip_3")}, "left to train"),
        ([_performer("M1", 1)], {"neutral": "F1"}, "neutral must be one of M1"),
        ([_performer("M1", 1)], {"frames_per_second": -1.0}, "frames_per_second"),
        ([_performer("M1", 1)], {"basis": "wavelets"}, "basis must be"),
        ([_performer("M1", 1)], {"beta": -1.0}, "beta must be"),
    ],
)
def test_bad_input_is_refused(performers, options, said):
    with pytest.raises(ValueRangeError, match=said):
        train_regions(performers, _regions(), TrainOptions(**options))


def test_regions_of_another_mesh_are_refused():
    with pytest.raises(TopologyError, match="96 vertices"):
        train_regions([_performer("M1", 1)], Regions.holistic(7))


def test_files_in_and_out(tmp_path):
    save_performer(_performer("M1", 1), tmp_path / "m1.fwms")
    write_regions(_regions(), tmp_path / "regions.json")
    request = TrainRequest([tmp_path / "m1.fwms"], tmp_path / "a.fwrm", tmp_path / "regions.json")
    result = train_from_files(request)
    loaded = load_region_model(tmp_path / "a.fwrm")
    np.testing.assert_array_equal(loaded.bases[0], result.model.bases[0])
    with pytest.raises(ValueRangeError, match="not both"):
        train_from_files(replace(request, options=TrainOptions(holistic=True)))
    with pytest.raises(ValueRangeError, match="at least one"):
        train_from_files(replace(request, data=[]))


def test_the_command(tmp_path):
    from typer.testing import CliRunner

    save_performer(_performer("M1", 1), tmp_path / "m1.fwms")
    write_regions(_regions(), tmp_path / "regions.json")
    common = ["regions", "train", str(tmp_path / "m1.fwms"), "-o", str(tmp_path / "a.fwrm")]
    given = ["--regions", str(tmp_path / "regions.json")]
    done = CliRunner().invoke(app, [*common, *given, "--components", "2", "--leave-out", "clip_3", "--json"])
    assert done.exit_code == 0, done.output
    payload = json.loads(done.stdout)
    assert payload["components"] == {"right": 2, "left": 2}
    assert payload["left_out_rms_mm"]["M1"] < 1.0
    spoken = CliRunner().invoke(app, [*common, "--holistic", "--components", "0.9"])
    assert spoken.exit_code == 0 and "1 region with" in spoken.output
    for bad in ("0", "-3", "2.5", "many"):
        refused = CliRunner().invoke(app, [*common, *given, f"--components={bad}"])
        assert refused.exit_code == 2
