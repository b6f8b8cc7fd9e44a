"""Weights of robust estimators for iteratively reweighted least squares."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from facewright.errors import ValueRangeError


def _check_scale(scale: float) -> None:
    if not (scale > 0 and np.isfinite(scale)):
        raise ValueRangeError(f"scale must be positive, got {scale}.")


def huber_weights(residuals: NDArray[np.floating[Any]], scale: float) -> NDArray[np.float64]:
    """Return 1 up to |r| = scale and scale / |r| beyond; the shape and unit of `residuals` are free.

    Raises
    ------
    ValueRangeError
        If `scale` is not positive.

    Examples
    --------
    >>> huber_weights(np.array([0.5, 4.0]), 1.0).tolist()
    [1.0, 0.25]
    """
    _check_scale(scale)
    size = np.abs(np.asarray(residuals, dtype=np.float64))
    return scale / np.maximum(size, scale)


def tukey_weights(residuals: NDArray[np.floating[Any]], scale: float) -> NDArray[np.float64]:
    """Return (1 - (r / scale)^2)^2 within |r| < scale and 0 beyond: outliers lose all influence.

    Raises
    ------
    ValueRangeError
        If `scale` is not positive.
    """
    _check_scale(scale)
    share = np.minimum(np.abs(np.asarray(residuals, dtype=np.float64)) / scale, 1.0)
    return (1.0 - share**2) ** 2


def median_scale(residuals: NDArray[np.floating[Any]]) -> float:
    """Return 1.4826 times the median of |r|: the standard deviation of normal noise, blind to half the data.

    Raises
    ------
    ValueRangeError
        If there are no residuals.
    """
    values = np.abs(np.asarray(residuals, dtype=np.float64))
    if not values.size:
        raise ValueRangeError("residuals must not be empty.")
    return float(1.4826 * np.median(values))
