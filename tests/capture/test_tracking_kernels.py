"""The small solver inside tracking gives NumPy's solution, and refuses what is singular."""

import numpy as np

from facewright.capture._tracking_kernels import _solve


def test_the_solution_is_that_of_numpy(rng):
    for scale in (1.0, 1e4):
        A = rng.normal(size=(200, 6)) * [scale, scale, scale, 1.0, 1.0, 1.0]
        H, g = A.T @ A, A.T @ rng.normal(size=200)
        ridged = H + np.diag(1e-6 * np.diag(H))
        expected = np.linalg.solve(ridged, g)
        x = g.copy()
        assert _solve(H.copy(), x)
        assert np.abs(x - expected).max() < 1e-9 * max(1.0, np.abs(expected).max())


def test_a_singular_system_is_told():
    assert not _solve(np.zeros((6, 6)), np.ones(6))
