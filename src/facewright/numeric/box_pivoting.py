"""One strictly convex quadratic problem within bounds, many times over: block principal pivoting with a warm start."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import lapack

from facewright.errors import DegenerateError
from facewright.numeric.check import check_shape

_PATIENCE = 4  # exchanges of all violations that may fail to lessen their number
_TOLERANCE = 1e-9  # of a problem whose matrix has ones on its diagonal
_NEAR_BOUND = 1e-3  # share of the largest unknown: as near to a bound as that counts as at it in a descent
_STEPS = 500
_HALVINGS = 40
_DESCENT = 1e-4  # share of the promised decrease that a step must bring


class BoxPivoting:
    r"""Minimise :math:`x^T H x / 2 - c^T x` over lower <= x <= upper for one H and many c that change little.

    Which coordinates lie at a bound is remembered: a problem near the one before takes a round or two, each one
    factorisation of the free part. All coordinates on the wrong side change it at once [1]_; where that goes round in
    circles, projected Newton steps go on [2]_, each of which lowers the objective, so that the search always ends.
    Coordinates are scaled so that the diagonal is one: parts of very different size are no ill condition.

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
    .. [2] Bertsekas, Projected Newton methods for optimization problems with simple constraints, SIAM J. Control
       Optim. 1982.
    """

    def __init__(self, H: NDArray[np.float64], lower: NDArray[np.float64], upper: NDArray[np.float64]) -> None:
        N = check_shape("H", H, "N", "N")["N"]
        check_shape("lower", lower, N)
        check_shape("upper", upper, N)
        self._bounds = lower, upper
        self._side = np.zeros(N, dtype=np.int8)
        self.replace(H)

    def replace(self, H: NDArray[np.float64]) -> None:
        """Take another matrix of the same size, and go on from where the last problem ended.

        Raises
        ------
        DegenerateError
            If a value on its diagonal is not positive.
        """
        diagonal = np.diagonal(H)
        if not (diagonal > 0.0).all():
            raise DegenerateError("H must be positive definite, got a matrix that is not.")
        self._unit = 1.0 / np.sqrt(diagonal)
        self._H = np.ascontiguousarray(H * self._unit[:, None] * self._unit)
        self._lower, self._upper = (bound / self._unit for bound in self._bounds)

    def solve(self, c: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return the minimiser (N,) for the linear term c (N,).

        Raises
        ------
        DegenerateError
            If H is not positive definite.
        """
        c = c * self._unit
        scale = _TOLERANCE * max(float(np.abs(c).max(initial=0.0)), 1e-12)
        x, settled = self._pivot(c, scale)
        if not settled:
            x = self._descend(np.clip(x, self._lower, self._upper), c, scale)
            self._side[:] = np.where(x <= self._lower, -1, np.where(x >= self._upper, 1, 0))
        lower, upper = self._bounds
        x = np.where(self._side < 0, lower, np.where(self._side > 0, upper, x * self._unit))
        return np.clip(x, lower, upper)

    def _pivot(self, c: NDArray[np.float64], scale: float) -> tuple[NDArray[np.float64], bool]:
        """Exchange all coordinates on the wrong side until there are none, or until that does not lessen them."""
        side, H = self._side, self._H
        fewest, patience = len(c) + 1, _PATIENCE
        while True:
            x = np.where(side < 0, self._lower, np.where(side > 0, self._upper, 0.0))
            free = np.flatnonzero(side == 0)
            if len(free):
                x[free] = _solve(H[np.ix_(free, free)], (c - H @ x)[free])
            slope = H @ x - c
            new = side.copy()
            new[(side == 0) & (x < self._lower - scale)] = -1
            new[(side == 0) & (x > self._upper + scale)] = 1
            new[(side < 0) & (slope < -scale)] = 0
            new[(side > 0) & (slope > scale)] = 0
            wrong = np.count_nonzero(new != side)
            if not wrong:
                return x, True
            if wrong < fewest:
                fewest, patience = wrong, _PATIENCE
            elif patience:
                patience -= 1
            else:
                return x, False
            side[:] = new

    def _descend(self, x: NDArray[np.float64], c: NDArray[np.float64], scale: float) -> NDArray[np.float64]:
        """Return the minimiser by projected Newton steps from x within the bounds; as near as numbers allow."""
        H, lower, upper = self._H, self._lower, self._upper
        for _ in range(_STEPS):
            slope = H @ x - c
            lack = float(np.abs(x - np.clip(x - slope, lower, upper)).max(initial=0.0))
            if lack <= scale:
                break
            near = min(_NEAR_BOUND * float(np.abs(x).max()), lack)
            held = ((x <= lower + near) & (slope > 0.0)) | ((x >= upper - near) & (slope < 0.0))
            free = np.flatnonzero(~held)
            step = -slope
            if len(free):
                step[free] = _solve(H[np.ix_(free, free)], -slope[free])
            for _ in range(_HALVINGS):
                move = np.clip(x + step, lower, upper) - x
                promised = float(slope @ move)
                if promised < 0.0 and promised + 0.5 * float(move @ (H @ move)) <= _DESCENT * promised:
                    break
                step *= 0.5
            else:
                break  # rounding is all that is left
            x = np.clip(x + move, lower, upper)
        return x


def _solve(A: NDArray[np.float64], b: NDArray[np.float64]) -> Any:
    _, x, failed = lapack.dposv(A.T, b, lower=True, overwrite_a=True)
    if failed:
        raise DegenerateError("H must be positive definite, got a matrix that is not.")
    return x
