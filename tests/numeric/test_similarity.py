import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from facewright.errors import DegenerateError, ShapeError, ValueRangeError
from facewright.numeric.rotation import matrix_from_quaternion
from facewright.numeric.similarity import Similarity, estimate_similarity


def random_similarity(rng):
    R = matrix_from_quaternion(rng.normal(size=4))
    return Similarity(float(rng.uniform(0.2, 5)), R, rng.normal(size=3) * 100)


@settings(max_examples=50, deadline=None)
@given(L=st.integers(3, 30), flat=st.booleans(), seed=st.integers(0, 2**32 - 1))
def test_finds_the_true_similarity(L, flat, seed):
    rng = np.random.default_rng(seed)
    truth, x = random_similarity(rng), rng.normal(size=(L, 3)) * 50
    x[:, 2] *= not flat
    found = estimate_similarity(x, truth.apply(x))
    np.testing.assert_allclose(found.scale, truth.scale, rtol=1e-6)
    np.testing.assert_allclose(found.apply(x), truth.apply(x), atol=1e-6)
    np.testing.assert_allclose(found.inverse().apply(truth.apply(x)), x, atol=1e-6)
    np.testing.assert_allclose(found.compose(found.inverse()).apply(x), x, atol=1e-6)


def test_no_other_similarity_is_better(rng):
    x, y = rng.normal(size=(20, 3)), rng.normal(size=(20, 3))
    w = rng.uniform(size=20)
    found = estimate_similarity(x, y, weights=w)
    assert np.linalg.det(found.rotation) > 0

    def energy(s):
        return (w * ((y - s.apply(x)) ** 2).sum(axis=1)).sum()

    for _ in range(50):
        step = matrix_from_quaternion(np.r_[1.0, rng.normal(size=3) * 1e-2])
        near = Similarity(found.scale * (1 + 1e-2 * rng.normal()), step @ found.rotation, found.translation)
        assert energy(near) >= energy(found)


def test_without_scale_it_is_rigid_and_mirrored_points_are_never_reflected(rng):
    x = rng.normal(size=(10, 3))
    assert estimate_similarity(x, 3 * x, with_scale=False).scale == 1.0
    mirrored = estimate_similarity(x, x * [-1, 1, 1])
    assert np.linalg.det(mirrored.rotation) == pytest.approx(1.0)


def test_points_without_weight_have_no_say(rng):
    truth, x = random_similarity(rng), rng.normal(size=(8, 3))
    y = truth.apply(x)
    y[5] += 100
    w = np.ones(8)
    w[5] = 0
    np.testing.assert_allclose(estimate_similarity(x, y, weights=w).rotation, truth.rotation, atol=1e-9)


@pytest.mark.parametrize(
    "points", [np.outer(np.arange(5.0), [1, 2, 3]), np.zeros((4, 3)), np.zeros((0, 3)), np.eye(3)[:2]]
)
def test_refuses_points_on_a_line(points):
    with pytest.raises(DegenerateError):
        estimate_similarity(points, points)


def test_refuses_wrong_shapes_and_values(rng):
    x = rng.normal(size=(4, 3))
    with pytest.raises(ShapeError):
        estimate_similarity(x, x[:3])
    with pytest.raises(ShapeError):
        estimate_similarity(x, x, weights=np.ones(3))
    with pytest.raises(ValueRangeError):
        estimate_similarity(x, x * np.nan)
    with pytest.raises(ValueRangeError):
        estimate_similarity(x, x, weights=-np.ones(4))
