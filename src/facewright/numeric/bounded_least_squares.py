"""Least squares with bounds on the unknowns, many small problems at once."""

from __future__ import annotations

import warnings
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from facewright.errors import ConvergenceWarning, ShapeError, ValueRangeError
from facewright.numeric.check import check_finite, check_shape

_MAX_ITERATIONS = 200
_TOLERANCE = 1e-10


def solve_bounded(
    A: NDArray[np.floating[Any]],
    b: NDArray[np.floating[Any]],
    lower: ArrayLike,
    upper: ArrayLike,
    *,
    ridge: ArrayLike = 0.0,
    prior: ArrayLike = 0.0,
) -> NDArray[np.float64]:
    r"""Minimise :math:`\|A x - b\|^2 + \sum_i r_i (x_i - x^*_i)^2` over lower <= x <= upper.

    Parameters
    ----------
    A : ndarray of shape (M, N)
        Matrix that all problems share.
    b : ndarray of shape (M,) or (K, M)
        One right-hand side or K.
    lower, upper : array_like, broadcast to the shape of the result
        Bounds; infinite ones are allowed.
    ridge : array_like, broadcast to (N,)
        r, not negative.
    prior : array_like, broadcast to the shape of the result
        x*, what the ridge pulls towards.

    Returns
    -------
    ndarray of shape (N,) or (K, N), float64
        The minimisers.

    Raises
    ------
    ShapeError
        If shapes do not fit.
    ValueRangeError
        If values are not finite, a lower bound is above its upper one, or the ridge is negative.

    Examples
    --------
    >>> solve_bounded(np.eye(2), np.array([2.0, 0.25]), 0.0, 1.0).tolist()
    [1.0, 0.25]
    """
    sizes = check_shape("A", A, "M", "N")
    if np.ndim(b) not in (1, 2):
        raise ShapeError(f"b must have shape (M,) or (K, M), got {np.shape(b)}.")
    check_shape("b", b, *(("M",) if np.ndim(b) == 1 else ("K", "M")), **sizes)
    check_finite("A", A)
    check_finite("b", b)
    matrix = np.asarray(A, dtype=np.float64)
    weights = np.broadcast_to(np.asarray(ridge, dtype=np.float64), sizes["N"])
    if not (weights >= 0).all():
        raise ValueRangeError(f"ridge must not be negative, got {weights.min()}.")
    check_finite("prior", prior)
    H = matrix.T @ matrix + np.diag(weights)
    C = np.asarray(b, dtype=np.float64) @ matrix + weights * np.asarray(prior, dtype=np.float64)
    return solve_bounded_quadratic(H, C, lower, upper)


def solve_bounded_quadratic(
    H: NDArray[np.floating[Any]],
    c: NDArray[np.floating[Any]],
    lower: ArrayLike,
    upper: ArrayLike,
    *,
    start: ArrayLike | None = None,
) -> NDArray[np.float64]:
    """Minimise x'H x / 2 - c'x over lower <= x <= upper: projected Newton method [1]_.

    Parameters
    ----------
    H : ndarray of shape (N, N) or (K, N, N)
        Symmetric, positive semidefinite; shared, or one for each problem.
    c : ndarray of shape (N,) or (K, N)
        Linear terms.
    lower, upper : array_like, broadcast to the shape of `c`
        Bounds; infinite ones are allowed.
    start : array_like, optional
        First guess, broadcast to the shape of `c`. Default: zero, moved into the box.

    Returns
    -------
    ndarray of the shape of `c`, float64
        The minimisers; a `ConvergenceWarning` says so if an iteration limit was met.

    Raises
    ------
    ShapeError
        If shapes do not fit.
    ValueRangeError
        If values are not finite or a lower bound is above its upper one.

    References
    ----------
    .. [1] Bertsekas, Projected Newton methods for optimization problems with simple constraints, SIAM J. Control
       Optim. 1982.
    """
    from facewright.numeric._bounded_kernels import minimise_in_box

    shape = np.shape(c)
    if len(shape) not in (1, 2):
        raise ShapeError(f"c must have shape (N,) or (K, N), got {shape}.")
    C = np.atleast_2d(np.asarray(c, dtype=np.float64))
    K, N = C.shape
    check_shape("H", H, *((N, N) if np.ndim(H) == 2 else (K, N, N)))
    check_finite("H", H)
    check_finite("c", C)
    low, high, x = (
        np.broadcast_to(np.asarray(value, dtype=np.float64), shape).reshape(K, N).copy()
        for value in (lower, upper, 0.0 if start is None else start)
    )
    if not (low <= high).all():
        raise ValueRangeError("lower must not be above upper, and neither may be NaN.")
    matrices = np.ascontiguousarray(np.asarray(H, dtype=np.float64).reshape(K if np.ndim(H) == 3 else 1, N, N))
    failures = minimise_in_box(matrices, C, low, high, x, _MAX_ITERATIONS, _TOLERANCE)
    if failures:
        text = f"{failures} of {K} bounded problems stopped after {_MAX_ITERATIONS} iterations."
        warnings.warn(text, ConvergenceWarning, stacklevel=2)
    return x.reshape(shape)
