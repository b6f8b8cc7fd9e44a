import numpy as np
import pytest

from facewright.errors import ShapeError, ValueRangeError
from facewright.mesh.random_field import smooth_random_field


def test_size_is_exact_and_seeds_repeat():
    points = np.random.default_rng(0).uniform(-100, 100, (500, 3))
    field = smooth_random_field(points, 20.0, 0.5, np.random.default_rng(1))
    assert field.shape == (500, 3)
    assert np.sqrt((field**2).sum(axis=1).mean()) == pytest.approx(0.5)
    np.testing.assert_array_equal(field, smooth_random_field(points, 20.0, 0.5, np.random.default_rng(1)))


def test_correlation_falls_as_promised(rng):
    x = np.linspace(0, 100, 101)
    points = np.stack([x, 0 * x, 0 * x], axis=1)
    fields = np.concatenate([smooth_random_field(points, 20.0, 1.0, rng, n_fields=4) for _ in range(150)])
    product = np.einsum("nax,nbx->ab", fields, fields) / len(fields)
    for lag in (10, 20, 40):
        found = np.diagonal(product, lag).mean() / np.diagonal(product).mean()
        assert found == pytest.approx(np.exp(-(lag**2) / (2 * 20**2)), abs=0.12)


def test_fields_of_one_draw_are_not_related(rng):
    points = rng.uniform(-100, 100, (2000, 3))
    fields = smooth_random_field(points, 15.0, 2.0, rng, n_fields=6).reshape(6, -1)
    correlation = np.corrcoef(fields) - np.eye(6)
    assert np.abs(correlation).max() < 0.4


def test_edges():
    rng = np.random.default_rng(0)
    assert smooth_random_field(np.zeros((0, 3)), 10, 1, rng).shape == (0, 3)
    assert (smooth_random_field(np.ones((4, 3)), 10, 0, rng) == 0).all()
    assert smooth_random_field(np.ones((4, 3)), 10, 1, rng, n_fields=0).shape == (0, 4, 3)


def test_refuses(rng):
    with pytest.raises(ShapeError):
        smooth_random_field(np.zeros((3, 2)), 10, 1, rng)
    for arguments in ((0, 1), (np.nan, 1), (10, -1)):
        with pytest.raises(ValueRangeError):
            smooth_random_field(np.zeros((3, 3)), *arguments, rng)
    with pytest.raises(ValueRangeError):
        smooth_random_field(np.zeros((3, 3)), 10, 1, rng, n_fields=-1)
    with pytest.raises(ValueRangeError):
        smooth_random_field(np.full((3, 3), np.nan), 10, 1, rng)
