import numpy as np
import pytest

from facewright.errors import DegenerateError, ShapeError, ValueRangeError
from facewright.models.attribute_regression import fit_attribute_regression


def population(rng, people=200, modes=6, noise=0.0):
    weights = rng.normal(size=(people, modes))
    mixing = rng.normal(size=(modes, 3))
    return weights, weights @ mixing * [2.0, 5.0, 0.5] + [100, 60, 8] + noise * rng.normal(size=(people, 3))


def test_one_attribute_moves_and_the_others_stay(rng):
    weights, attributes = population(rng)
    mixing = np.linalg.lstsq(weights, attributes - attributes.mean(0), rcond=None)[0]
    regression = fit_attribute_regression(weights, attributes, ("face length", "jaw width", "chin"))
    moved = regression.change({"face length": 1.5}) @ mixing / regression.standard_deviation
    # E[w | f] is what the regression gives: its attribute is the request exactly when w determines f
    np.testing.assert_allclose(moved, [1.5, 0, 0], atol=0.02)


def test_r_squared_is_high_for_linear_and_not_positive_for_noise(rng):
    weights, attributes = population(rng)
    attributes[:, 2] = rng.normal(size=len(weights))
    r_squared = fit_attribute_regression(weights, attributes, ("a", "b", "c")).r_squared
    assert r_squared[0] > 0.95 and r_squared[1] > 0.95 and r_squared[2] < 0.05


def test_refuses(rng):
    weights, attributes = population(rng, people=20)
    with pytest.raises(ShapeError):
        fit_attribute_regression(weights, attributes[:10], ("a", "b", "c"))
    with pytest.raises(DegenerateError, match="got 4 people"):
        fit_attribute_regression(weights[:4], attributes[:4], ("a", "b", "c"))
    attributes[3, 1] = np.nan
    with pytest.raises(ValueRangeError):
        fit_attribute_regression(weights, attributes, ("a", "b", "c"))
    regression = fit_attribute_regression(*population(rng), ("a", "b", "c"))
    with pytest.raises(ValueRangeError, match="attribute must be one of a, b, c"):
        regression.change({"nose": 1})
