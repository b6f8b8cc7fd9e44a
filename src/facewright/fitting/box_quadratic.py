"""A small quadratic energy within bounds, by coordinate descent."""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray


def minimise_in_box(
    H: NDArray[np.float64],
    g: NDArray[np.float64],
    start: NDArray[np.float64],
    lower: float = 0.0,
    upper: float = 1.0,
    sweeps: int = 300,
    tolerance: float = 1e-5,
) -> NDArray[np.float64]:
    """Minimise x^T H x / 2 + g^T x with lower <= x <= upper.

    Parameters
    ----------
    H : ndarray of shape (B, B), float64
        Symmetric positive definite.
    g : ndarray of shape (B,), float64
    start : ndarray of shape (B,)
        Where to start.
    lower, upper : float
        Bounds of every coordinate.
    sweeps : int
        At most so many rounds over all coordinates.
    tolerance : float
        Stop when no coordinate moved by more in a round.

    Returns
    -------
    ndarray of shape (B,), float64
        The minimiser.
    """
    x = np.clip(start, lower, upper).astype(np.float64)
    _descend(np.ascontiguousarray(H), np.ascontiguousarray(g), x, lower, upper, sweeps, tolerance)
    return x


@njit(cache=True)
def _descend(H, g, x, lower, upper, sweeps, tolerance):  # type: ignore[no-untyped-def]
    n = x.size
    slope = g + H @ x
    for _ in range(sweeps):
        largest = 0.0
        for i in range(n):
            new = min(max(x[i] - slope[i] / H[i, i], lower), upper)
            step = new - x[i]
            if step != 0.0:
                x[i] = new
                for j in range(n):
                    slope[j] += H[i, j] * step
                largest = max(largest, abs(step))
        if largest < tolerance:
            break
