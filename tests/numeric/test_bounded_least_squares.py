import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.optimize import lsq_linear

from facewright.errors import ShapeError, ValueRangeError
from facewright.numeric.bounded_least_squares import solve_bounded, solve_bounded_quadratic


@settings(max_examples=60, deadline=None)
@given(m=st.integers(1, 40), n=st.integers(1, 30), spread=st.floats(0, 2), seed=st.integers(0, 2**32 - 1))
def test_objective_is_as_low_as_scipy_finds(m, n, spread, seed):
    rng = np.random.default_rng(seed)
    A = rng.normal(size=(m, n)) * 10.0 ** rng.uniform(-spread, spread, n)
    b = rng.normal(size=(3, m)) * 3
    prior = rng.uniform(size=(3, n))
    ridge = rng.uniform(1e-3, 1.0, n)
    X = solve_bounded(A, b, 0.0, 1.0, ridge=ridge, prior=prior)
    assert ((X >= 0) & (X <= 1)).all()
    for x, right, star in zip(X, b, prior):
        matrix = np.vstack([A, np.diag(np.sqrt(ridge))])
        rhs = np.concatenate([right, np.sqrt(ridge) * star])
        best = lsq_linear(matrix, rhs, (0, 1), method="bvls", tol=1e-14).x
        value, least = ((matrix @ x - rhs) ** 2).sum(), ((matrix @ best - rhs) ** 2).sum()
        assert value <= least * (1 + 1e-9) + 1e-12


def test_without_active_bounds_it_is_plain_least_squares(rng):
    A, b = rng.normal(size=(30, 8)), rng.normal(size=(4, 30))
    expected = np.linalg.lstsq(A, b.T, rcond=None)[0].T
    np.testing.assert_allclose(solve_bounded(A, b, -np.inf, np.inf), expected, atol=1e-9)


def test_equal_bounds_fix_a_variable(rng):
    A, b = rng.normal(size=(10, 3)), rng.normal(size=10)
    x = solve_bounded(A, b, [0.3, -5, -5], [0.3, 5, 5])
    assert x[0] == 0.3
    expected = np.linalg.lstsq(A[:, 1:], b - 0.3 * A[:, 0], rcond=None)[0]
    np.testing.assert_allclose(x[1:], expected, atol=1e-9)


def test_own_matrices_for_every_problem(rng):
    A = rng.normal(size=(5, 12, 4))
    H = np.einsum("kmi,kmj->kij", A, A)
    c = rng.normal(size=(5, 4)) * 10
    X = solve_bounded_quadratic(H, c, 0.0, 1.0)
    for k in range(5):
        np.testing.assert_allclose(X[k], solve_bounded_quadratic(H[k], c[k], 0.0, 1.0), atol=1e-12)


def test_a_singular_matrix_stays_in_the_box():
    x = solve_bounded_quadratic(np.zeros((2, 2)), np.array([1.0, -1.0]), 0.0, 1.0, start=0.5)
    np.testing.assert_array_equal(x, [1.0, 0.0])


def test_no_problems_and_no_unknowns():
    assert solve_bounded(np.zeros((3, 2)), np.zeros((0, 3)), 0, 1).shape == (0, 2)
    assert solve_bounded(np.zeros((3, 0)), np.zeros(3), 0, 1).shape == (0,)


@pytest.mark.parametrize(
    ("arguments", "error"),
    [
        ((np.eye(2), np.zeros(3), 0, 1), ShapeError),
        ((np.eye(2), np.zeros((1, 1, 2)), 0, 1), ShapeError),
        ((np.zeros(2), np.zeros(2), 0, 1), ShapeError),
        ((np.eye(2), np.zeros(2), 1, 0), ValueRangeError),
        ((np.eye(2), np.zeros(2), np.nan, 1), ValueRangeError),
        ((np.eye(2) * np.nan, np.zeros(2), 0, 1), ValueRangeError),
        ((np.eye(2), np.full(2, np.inf), 0, 1), ValueRangeError),
    ],
)
def test_refuses(arguments, error):
    with pytest.raises(error):
        solve_bounded(*arguments)


def test_refuses_a_negative_ridge_and_wrong_matrices():
    with pytest.raises(ValueRangeError, match="ridge"):
        solve_bounded(np.eye(2), np.zeros(2), 0, 1, ridge=-1.0)
    with pytest.raises(ShapeError, match="H"):
        solve_bounded_quadratic(np.zeros((3, 2, 2)), np.zeros((2, 2)), 0, 1)
    with pytest.raises(ShapeError, match="c"):
        solve_bounded_quadratic(np.eye(2), np.zeros((1, 1, 2)), 0, 1)
