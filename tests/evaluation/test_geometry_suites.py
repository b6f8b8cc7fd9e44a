"""Suites `transfer` and `rigging`: their bookkeeping on the built-in face; the targets on ICT are slow tests."""

import numpy as np
import pytest

from facewright.errors import ValueRangeError
from facewright.evaluation import rigging, transfer


def test_swapped_sides_are_counted(rng):
    names = ("smile_L", "smile_R", "jawOpen")
    truth = rng.normal(size=(3, 20, 3))
    assert rigging.count_side_swaps(truth, truth, names) == 0
    assert rigging.count_side_swaps(0.3 * truth, truth, names) == 0
    assert rigging.count_side_swaps(truth[[1, 0, 2]], truth, names) == 2


def test_acting_follows_the_guide_and_rests_where_asked(rng):
    neutral, deltas = rng.normal(size=(50, 3)) * 50, rng.normal(size=(6, 50, 3))
    guide = np.concatenate([np.zeros((1, 6)), np.eye(6)])
    acted = rigging.act(neutral, deltas, guide, rng)
    assert (acted.weights[0] == 0).all()
    asked = acted.weights[guide > 0]
    assert (asked >= 0.7).all()
    assert (asked <= 1.1).all()
    assert acted.weights[guide == 0].max() <= 0.15
    noise = acted.poses - neutral - np.tensordot(acted.weights, deltas, 1)
    np.testing.assert_allclose(np.sqrt((noise**2).sum(axis=2).mean(axis=1)), 0.25)


def test_coupled_shapes_are_left_right_and_jaw():
    names = ("browDown_L", "browDown_R", "jawOpen", "mouthClose", "mouthLeft")
    assert rigging.coupled_shapes(names) == [(0, 1), (2, 3)]


@pytest.mark.parametrize("suite", [transfer, rigging])
def test_no_subjects_are_refused(suite, builtin_face):
    with pytest.raises(ValueRangeError, match="subjects"):
        suite.run(builtin_face, 0, subjects=0)


def test_both_suites_run_on_the_builtin_face(builtin_face):
    stages = []
    metrics = transfer.run(builtin_face, 1, progress=lambda *s: stages.append(s), subjects=1)
    assert {"factor_ms", "per_expression_ms", "rms_mm", "no_motion_rms_mm"} <= set(metrics)
    assert metrics["rest_motion_rms_mm"] < 1e-12
    assert metrics["rms_mm"] < 0.7 * metrics["no_motion_rms_mm"]
    assert metrics["same_mesh_rms_mm"] < 1e-6
    assert stages == [("transferring", 1, 1)]
    metrics = rigging.run(builtin_face, 1, subjects=1)
    keys = {"seconds", "unseen_rms_mm", "generic_rms_mm", "improvement", "improvement_true_weights"}
    assert keys | {"left_right_swaps"} <= set(metrics)
    assert metrics["left_right_swaps"] == 0
    assert metrics["improvement_true_weights"] > metrics["improvement"]
    expected = 1 - metrics["unseen_rms_mm"] / metrics["generic_rms_mm"]
    assert metrics["improvement"] == pytest.approx(expected)


@pytest.mark.slow
def test_targets_on_ict(ict_face):
    metrics = transfer.run(ict_face, 7)
    assert metrics["vertices"] == 11248
    assert metrics["per_expression_ms"] < 3 * 15  # the target, and room for a busy machine
    assert metrics["rms_mm"] < metrics["untransferred_rms_mm"]
    metrics = rigging.run(ict_face, 7)
    assert metrics["improvement"] >= 0.30
    assert metrics["improvement_true_weights"] >= 0.54
    assert metrics["left_right_swaps"] == 0
