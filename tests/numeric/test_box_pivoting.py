"""Quadratic problems within bounds by pivoting, against projected Newton steps."""

import warnings

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from facewright.errors import DegenerateError, ShapeError
from facewright.numeric.bounded_least_squares import solve_bounded_quadratic
from facewright.numeric.box_pivoting import BoxPivoting


@settings(max_examples=40, deadline=None)
@given(seed=st.integers(0, 2**32 - 1), n=st.integers(1, 25))
def test_minimiser_is_that_of_projected_newton_and_fulfils_the_conditions(seed, n):
    rng = np.random.default_rng(seed)
    A = rng.normal(size=(n, n))
    H = A.T @ A + 1e-3 * np.eye(n)
    lower = np.where(rng.random(n) < 0.2, -np.inf, rng.uniform(-1, 0, n))
    upper = np.where(rng.random(n) < 0.2, np.inf, rng.uniform(0, 1, n))
    box = BoxPivoting(H, lower, upper)
    for _ in range(3):  # warm starts
        c = rng.normal(size=n) * 3
        x = box.solve(c)
        slope = H @ x - c
        assert (x >= lower).all() and (x <= upper).all()
        inside = (x > lower) & (x < upper)
        np.testing.assert_allclose(slope[inside], 0.0, atol=1e-7)
        assert (slope[x == lower] >= -1e-7).all() and (slope[x == upper] <= 1e-7).all()
        np.testing.assert_allclose(x, solve_bounded_quadratic(H, c, lower, upper), atol=1e-5)


def test_it_ends_within_the_bounds_where_coordinates_look_alike_and_differ_in_size():
    """Rank 30 of 90 unknowns, sizes over six decades, a trace of a ridge: pivoting alone goes round in circles."""
    rng = np.random.default_rng(5)
    A = rng.normal(size=(30, 90)) * 10.0 ** rng.uniform(-3, 3, 90)
    H = A.T @ A
    H[np.diag_indices(90)] *= 1.0 + 1e-6
    box = BoxPivoting(H, np.zeros(90), np.ones(90))
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        for _ in range(5):
            c = A.T @ rng.normal(size=30) * 100
            x = box.solve(c)
            assert (x >= 0).all() and (x <= 1).all()
            slope = (H @ x - c) / np.sqrt(np.diag(H))
            scale = 1e-6 * np.abs(c / np.sqrt(np.diag(H))).max()
            assert (slope[x < 1] >= -scale).all() and (slope[x > 0] <= scale).all()


def test_descent_alone_finds_the_same():
    rng = np.random.default_rng(6)
    A = rng.normal(size=(40, 25))
    H, c = A.T @ A, rng.normal(size=25) * 40
    box = BoxPivoting(H, np.zeros(25), np.ones(25))
    wanted = box.solve(c)
    box._pivot = lambda c, scale: (np.full(25, 9.0), False)
    np.testing.assert_allclose(box.solve(c), wanted, atol=1e-7)


def test_another_matrix_takes_its_place():
    box = BoxPivoting(np.eye(2), np.zeros(2), np.ones(2))
    np.testing.assert_allclose(box.solve(np.array([2.0, 0.25])), [1.0, 0.25], atol=1e-12)
    box.replace(2.0 * np.eye(2))
    np.testing.assert_allclose(box.solve(np.array([-1.0, 0.5])), [0.0, 0.25], atol=1e-12)


def test_bad_input_is_refused():
    with pytest.raises(ShapeError):
        BoxPivoting(np.eye(2), np.zeros(3), np.ones(2))
    with pytest.raises(DegenerateError, match="positive definite"):
        BoxPivoting(-np.eye(2), np.full(2, -1.0), np.ones(2)).solve(np.zeros(2))
