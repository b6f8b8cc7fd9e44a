"""Rigid motion is found and taken out; generalised Procrustes; what hardly moves tells the head's motion."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from facewright.errors import DegenerateError, ShapeError, ValueRangeError
from facewright.models.procrustes import generalised_procrustes, rigid_motions, stable_weights
from facewright.numeric.similarity import estimate_similarity


def _moved(rng, reference, n):
    rotations = Rotation.random(n, random_state=int(rng.integers(1000))).as_matrix()
    shifts = rng.normal(0, 300.0, (n, 3))
    return reference @ rotations.transpose(0, 2, 1) + shifts[:, None]


@settings(max_examples=20, deadline=None)
@given(st.integers(0, 10_000))
def test_any_rigid_motion_is_undone(seed):
    rng = np.random.default_rng(seed)
    reference = rng.normal(0, 60.0, (25, 3))
    motion = rigid_motions(_moved(rng, reference, 5), reference)
    shapes = motion.inverse().apply(np.repeat(reference[None], 5, 0))
    assert np.allclose(motion.apply(shapes), reference, atol=1e-9)
    assert np.allclose(np.linalg.det(motion.rotations), 1.0)
    both = motion.compose(motion.inverse())
    assert np.allclose(both.rotations, np.eye(3), atol=1e-12) and np.allclose(both.translations, 0, atol=1e-9)


def test_equals_the_one_off_estimate(rng):
    reference, shapes = rng.normal(0, 60, (30, 3)), rng.normal(0, 60, (4, 30, 3))
    weights = rng.random((4, 30))
    found = rigid_motions(shapes, reference, weights)
    for t in range(4):
        one = estimate_similarity(shapes[t], reference, weights=weights[t], with_scale=False)
        assert np.allclose(one.rotation, found.rotations[t]) and np.allclose(one.translation, found.translations[t])


def test_unseen_points_without_weight(rng):
    reference = rng.normal(0, 60, (30, 3))
    shapes = _moved(rng, reference, 3)
    weights = np.ones((3, 30))
    shapes[1, 4:9], weights[1, 4:9] = np.nan, 0.0
    moved = rigid_motions(shapes, reference, weights).apply(shapes)
    assert np.nanmax(np.abs(moved - reference)) < 1e-9
    with pytest.raises(ValueRangeError):
        rigid_motions(shapes, reference)


def test_generalised(rng):
    reference = rng.normal(0, 60, (40, 3))
    shapes = _moved(rng, reference, 6) + rng.normal(0, 0.5, (6, 40, 3))
    mean, motions = generalised_procrustes(shapes)
    aligned = motions.apply(shapes)
    assert np.allclose(aligned.mean(axis=0), mean, atol=0.01)
    assert np.sqrt(((aligned - mean) ** 2).sum(axis=2).mean()) < 1.0
    before = np.sqrt(((rigid_motions(shapes, shapes[0]).apply(shapes) - shapes[0]) ** 2).sum())
    after = np.sqrt(((aligned - mean) ** 2).sum())
    assert after < before
    with pytest.raises(ValueRangeError):
        generalised_procrustes(shapes[:0])


def test_the_jaw_does_not_turn_the_head(rng):
    reference = rng.normal(0, 60, (60, 3))
    acting = reference[:, 1] < -20
    still = np.repeat(reference[None], 30, 0)
    still[:, acting] += rng.normal(0, 1.0, (30, 1, 1)) * [0.0, 8.0, 3.0]
    w = stable_weights(_moved_each(rng, still), reference)
    assert w[~acting].min() > 3 * w[acting].max()
    shapes = _moved_each(rng, still)
    by_all = rigid_motions(shapes, reference).apply(shapes)
    by_still = rigid_motions(shapes, reference, w).apply(shapes)
    assert np.abs(by_still - still)[:, ~acting].max() < 0.2 * np.abs(by_all - still)[:, ~acting].max()


def _moved_each(rng, shapes):
    rotations = Rotation.from_rotvec(rng.normal(0, 0.3, (len(shapes), 3))).as_matrix()
    return shapes @ rotations.transpose(0, 2, 1) + rng.normal(0, 100, (len(shapes), 1, 3))


def test_refusals(rng):
    line = np.outer(np.arange(9.0), [1.0, 2.0, 3.0])
    with pytest.raises(DegenerateError, match="line"):
        rigid_motions(line[None], line)
    with pytest.raises(ShapeError):
        rigid_motions(np.zeros((2, 5, 3)), np.zeros((4, 3)))
    good = rng.normal(size=(1, 5, 3))
    with pytest.raises(ValueRangeError, match="negative"):
        rigid_motions(good, good[0], -np.ones(5))
    with pytest.raises(DegenerateError, match="weight"):
        rigid_motions(good, good[0], np.zeros(5))
