import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from facewright.errors import DegenerateError, ShapeError, ValueRangeError
from facewright.models.attribute_regression import fit_attribute_regression, least_change


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


def space(rng, modes=8, attributes=4):
    spread = rng.normal(size=(modes, modes))
    return rng.normal(size=(attributes, modes)), spread @ spread.T


@settings(max_examples=30, deadline=None)
@given(seed=st.integers(0, 2**32 - 1), hold=st.floats(0.02, 2.0), asked=st.integers(0, 3))
def test_the_least_change_solves_its_problem(seed, hold, asked):
    """Against the KKT system of the stated problem, solved naively."""
    jacobian, covariance = space(np.random.default_rng(seed))
    request = np.zeros(4)
    request[asked] = 1.5
    mask = np.arange(4) == asked
    found = least_change(jacobian, covariance, request, mask, hold)
    held, wanted = jacobian[~mask], jacobian[mask]
    hessian = np.linalg.inv(covariance) + held.T @ held / hold**2
    kkt = np.block([[hessian, wanted.T], [wanted, np.zeros((1, 1))]])
    exact = np.linalg.solve(kkt, np.append(np.zeros(8), 1.5))[:8]
    scale = np.sqrt(exact @ np.linalg.solve(covariance, exact))
    error = found - exact
    assert np.sqrt(error @ np.linalg.solve(covariance, error)) < 2e-3 * scale
    assert jacobian[asked] @ found == pytest.approx(1.5, abs=2e-3)


def test_a_firm_hold_is_equation_12_of_endless_people(rng):
    jacobian, covariance = space(rng)
    weights = rng.multivariate_normal(np.zeros(8), covariance, size=4000)
    attributes = weights @ jacobian.T
    regression = fit_attribute_regression(weights, attributes, tuple("abcd"))
    scaled = jacobian / regression.standard_deviation[:, None]
    found = least_change(scaled, np.cov(weights.T), np.array([0, 1.0, 0, 0]), np.arange(4) == 1, 1e-3)
    np.testing.assert_allclose(found, regression.change({"b": 1.0}), atol=0.02 * np.abs(found).max())


def test_few_people_give_the_nearest_that_they_span(rng):
    jacobian, _ = space(rng)
    people = rng.normal(size=(3, 8))  # two directions, four attributes
    found = least_change(jacobian, np.cov(people.T), np.array([1.0, 0, 0, 0]), np.arange(4) == 0, 0.25)
    outside = np.linalg.svd(people - people.mean(0))[2][2:]
    assert np.abs(outside @ found).max() < 1e-9
    assert (jacobian @ found)[0] == pytest.approx(1.0, abs=0.01)


def test_a_soft_hold_costs_less_and_leaks_more(rng):
    jacobian, covariance = space(rng)
    request, asked = np.array([2.0, 0, 0, 0]), np.arange(4) == 0
    length, leak = [], []
    for hold in (0.05, 0.25, 2.0):
        change = least_change(jacobian, covariance, request, asked, hold)
        length.append(change @ np.linalg.solve(covariance, change))
        leak.append(np.abs((jacobian @ change)[1:]).max())
    assert length[0] > length[1] > length[2]
    assert leak[0] < leak[1] < leak[2]


def test_the_least_change_refuses(rng):
    jacobian, covariance = space(rng)
    asked = np.arange(4) == 0
    with pytest.raises(ValueRangeError, match="hold must be positive"):
        least_change(jacobian, covariance, np.zeros(4), asked, 0.0)
    with pytest.raises(ShapeError):
        least_change(jacobian, covariance[:5, :5], np.zeros(4), asked, 0.25)
    with pytest.raises(ValueRangeError):
        least_change(jacobian, covariance, np.full(4, np.nan), asked, 0.25)
