"""One strictly convex quadratic problem within bounds, many times over: block principal pivoting with a warm start."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import lapack

from facewright.errors import DegenerateError
from facewright.numeric.bounded_least_squares import solve_bounded_quadratic
from facewright.numeric.check import check_shape

_PATIENCE = 4  # exchanges of all violations that may fail to lessen their number
_ROUNDS = 200
_TOLERANCE = 1e-10


class BoxPivoting:
    r"""Minimise :math:`x^T H x / 2 - c^T x` over lower <= x <= upper for one H and many c that change little.

    Which coordinates lie at a bound is remembered: a problem near the one before takes a round or two, each one
    factorisation of the free part. All coordinates on the wrong side change it at once, in the end one by one [1]_.

    Parameters
    ----------
    H : ndarray of shape (N, N), float64
        Symmetric positive definite.
    lower, upper : ndarray of shape (N,), float64
        Bounds; infinite ones are allowed.

    Raises
    ------
    ShapeError
        If shapes do not fit.

    References
    ----------
    .. [1] Júdice and Pires, A block principal pivoting algorithm for large-scale strictly monotone linear
       complementarity problems, Computers & Operations Research 1994.
    """

    def __init__(self, H: NDArray[np.float64], lower: NDArray[np.float64], upper: NDArray[np.float64]) -> None:
        N = check_shape("H", H, "N", "N")["N"]
        check_shape("lower", lower, N)
        check_shape("upper", upper, N)
        self._lower, self._upper = lower, upper
        self._side = np.zeros(N, dtype=np.int8)
        self.replace(H)

    def replace(self, H: NDArray[np.float64]) -> None:
        """Take another matrix of the same size, and go on from where the last problem ended."""
        self._H = np.ascontiguousarray(H, dtype=np.float64)

    def solve(self, c: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return the minimiser (N,) for the linear term c (N,).

        Raises
        ------
        DegenerateError
            If H is not positive definite.
        """
        side, H = self._side, self._H
        fewest, patience = len(c) + 1, _PATIENCE
        scale = _TOLERANCE * max(float(np.abs(c).max(initial=0.0)), 1e-12)
        for _ in range(_ROUNDS):
            x = np.where(side < 0, self._lower, np.where(side > 0, self._upper, 0.0))
            free = np.flatnonzero(side == 0)
            if len(free):
                x[free] = _solve(H[np.ix_(free, free)], (c - H @ x)[free])
            slope = H @ x - c
            new = side.copy()
            new[(side == 0) & (x < self._lower - _TOLERANCE)] = -1
            new[(side == 0) & (x > self._upper + _TOLERANCE)] = 1
            new[(side < 0) & (slope < -scale)] = 0
            new[(side > 0) & (slope > scale)] = 0
            wrong = np.flatnonzero(new != side)
            if not len(wrong):
                return np.clip(x, self._lower, self._upper)
            if len(wrong) < fewest:
                fewest, patience = len(wrong), _PATIENCE
            elif patience:
                patience -= 1
            else:  # one by one, which ends for certain
                wrong = wrong[-1:]
            side[wrong] = new[wrong]
        side[:] = 0
        return np.asarray(solve_bounded_quadratic(H, c, self._lower, self._upper))


def _solve(A: NDArray[np.float64], b: NDArray[np.float64]) -> Any:
    _, x, failed = lapack.dposv(A, b, lower=True)
    if failed:
        raise DegenerateError("H must be positive definite, got a matrix that is not.")
    return x
