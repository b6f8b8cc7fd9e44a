"""The landmark term: squared distances in the picture, in units of their noise, with outliers damped."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

#: Degrees of freedom of the Student t distribution that residuals are taken to have: 4 damps beyond about 3 sigma.
DEGREES_OF_FREEDOM = 4.0


def noise_px(scale: float, mm: float, confidence: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return each point's standard deviation, pixels: a fixed length on the face at the picture's scale.

    Parameters
    ----------
    scale : float
        Pixels per millimetre.
    mm : float
        Standard deviation of a point of confidence 1, per coordinate, millimetres on the face.
    confidence : ndarray of shape (L,)
        In [0, 1], as a relative precision (1 / variance); 0 gives infinity.
    """
    with np.errstate(divide="ignore"):
        return scale * mm / np.sqrt(confidence)


def robust_weights(residuals: NDArray[np.float64], sigma: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the weight of each squared residual, 1/px^2: 1 / sigma^2, less for outliers.

    Iteratively re-weighted least squares of a bivariate Student t likelihood.

    Parameters
    ----------
    residuals : ndarray of shape (L, 2), pixels
        Projected minus found.
    sigma : ndarray of shape (L,), pixels
        Standard deviation per coordinate; infinite for missing points.
    """
    with np.errstate(invalid="ignore"):
        square = np.where(np.isfinite(sigma), (residuals**2).sum(axis=1) / sigma**2, 0.0)
        precision = np.where(np.isfinite(sigma), 1.0 / sigma**2, 0.0)
    return precision * (DEGREES_OF_FREEDOM + 2.0) / (DEGREES_OF_FREEDOM + square)


def landmark_energy(residuals: NDArray[np.float64], sigma: NDArray[np.float64]) -> float:
    """Return minus the logarithm of the same likelihood: sum of (nu + 2) / 2 log(1 + r^2 / (nu sigma^2))."""
    found = np.isfinite(sigma)
    square = (residuals[found] ** 2).sum(axis=1) / sigma[found] ** 2
    nu = DEGREES_OF_FREEDOM
    return float(0.5 * (nu + 2.0) * np.log1p(square / nu).sum())
