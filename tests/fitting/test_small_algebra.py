import numpy as np

from facewright.fitting.box_quadratic import minimise_in_box
from facewright.fitting.small_algebra import (
    contract_between,
    contract_first,
    contract_last,
    contract_points,
    normal_equations,
    solve_spd,
)


def test_kernels_equal_numpy(rng):
    core, w = rng.normal(size=(5, 7, 4)).astype(np.float32), rng.normal(size=4).astype(np.float32)
    np.testing.assert_allclose(contract_last(core, w), core @ w, rtol=1e-4, atol=1e-5)
    c = rng.normal(size=7).astype(np.float32)  # one row that stands alone, four at once, two left over
    c[0] = 1.0
    rows = rng.normal(size=(7, 20)).astype(np.float32)
    np.testing.assert_allclose(contract_first(rows, c), c @ rows, rtol=1e-4, atol=1e-5)
    points, w64 = rng.normal(size=(6, 3, 4)), rng.normal(size=4)
    np.testing.assert_allclose(contract_points(points, w64), points @ w64)
    strips, first, second = rng.normal(size=(2, 6, 3, 4)).astype(np.float32), np.array([0, 4]), np.array([1, 2])
    at = 0.75 * (strips @ w)[:, first] + 0.25 * (strips @ w)[:, second]
    np.testing.assert_allclose(contract_between(strips, first, second, np.full(2, 0.25), w), at, rtol=1e-4, atol=1e-5)
    J, weights, r = rng.normal(size=(30, 6)), rng.uniform(0, 2, 30), rng.normal(size=30)
    weights[3] = 0.0
    H, g = normal_equations(J, weights, r)
    np.testing.assert_allclose(H, J.T @ np.diag(weights) @ J)
    np.testing.assert_allclose(g, J.T @ (weights * r))
    B = rng.normal(size=(6, 3))
    np.testing.assert_allclose(solve_spd(H, B), np.linalg.solve(H, B))


def test_an_indefinite_system_gives_nan(rng):
    assert np.isnan(solve_spd(np.diag([1.0, -1.0]), np.ones((2, 1)))).all()
    assert np.isnan(solve_spd(np.full((2, 2), np.nan), np.ones((2, 1)))).all()


def test_box_minimum_fulfils_the_optimality_conditions(rng):
    for _ in range(20):
        A = rng.normal(size=(40, 12))
        H, g = A.T @ A + 0.1 * np.eye(12), rng.normal(size=12) * 20
        x = minimise_in_box(H, g, np.full(12, 0.5), tolerance=1e-12)
        slope = H @ x + g
        assert ((x >= 0) & (x <= 1)).all()
        assert (slope[x == 0] >= -1e-8).all()
        assert (slope[x == 1] <= 1e-8).all()
        assert np.abs(slope[(x > 0) & (x < 1)]).max(initial=0) < 1e-6


def test_box_minimum_without_active_bounds_is_the_solution(rng):
    A = rng.normal(size=(40, 5))
    H = A.T @ A
    wanted = rng.uniform(0.2, 0.8, 5)
    np.testing.assert_allclose(minimise_in_box(H, -H @ wanted, np.zeros(5), tolerance=1e-12), wanted, atol=1e-8)
