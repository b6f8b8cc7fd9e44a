"""Smooth random displacements of points in space, for simulated people and for tests."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from facewright.errors import ValueRangeError
from facewright.numeric.check import check_finite, check_shape

_N_WAVES = 128


def smooth_random_field(
    points: NDArray[np.floating[Any]],
    correlation_mm: float,
    rms_mm: float,
    rng: np.random.Generator,
    n_fields: int | None = None,
) -> NDArray[np.float64]:
    """Draw smooth random displacement fields and evaluate them at points.

    Each coordinate is an independent stationary random function with correlation exp(-d^2 / (2 c^2)) at distance d,
    drawn as random Fourier features [1]_: waves cos(k x), sin(k x) with k ~ N(0, 1 / c^2) and normal amplitudes.

    Parameters
    ----------
    points : ndarray of shape (V, 3), millimetres
        Where to evaluate. Not modified.
    correlation_mm : float
        Correlation length c, mm.
    rms_mm : float
        Root mean square length of the displacements over `points`, mm; met exactly.
    rng : numpy.random.Generator
        Source of randomness.
    n_fields : int, optional
        Number of fields; they share their waves, with amplitudes of their own, which costs far less than separate
        draws. Default: one field without a leading axis.

    Returns
    -------
    ndarray of shape (V, 3) or (n_fields, V, 3), float64, millimetres
        Displacements.

    Raises
    ------
    ShapeError
        If `points` is not (V, 3).
    ValueRangeError
        If points are not finite, `correlation_mm` is not positive, or `rms_mm` or `n_fields` is negative.

    References
    ----------
    .. [1] Rahimi and Recht, Random features for large-scale kernel machines, NeurIPS 2007.
    """
    V = check_shape("points", points, "V", 3)["V"]
    check_finite("points", points)
    if not (correlation_mm > 0 and np.isfinite(correlation_mm)):
        raise ValueRangeError(f"correlation_mm must be positive, got {correlation_mm}.")
    if not (rms_mm >= 0 and np.isfinite(rms_mm)):
        raise ValueRangeError(f"rms_mm must not be negative, got {rms_mm}.")
    count = 1 if n_fields is None else int(n_fields)
    if count < 0:
        raise ValueRangeError(f"n_fields must not be negative, got {n_fields}.")
    k = rng.normal(size=(3, _N_WAVES)) / correlation_mm
    amplitudes = rng.normal(size=(2 * _N_WAVES, count * 3)) / np.sqrt(_N_WAVES)
    phase = np.asarray(points, dtype=np.float64) @ k
    waves = np.concatenate([np.cos(phase), np.sin(phase)], axis=1)
    fields = (waves @ amplitudes).reshape(V, count, 3).transpose(1, 0, 2)
    rms = np.sqrt((fields**2).sum(axis=2).mean(axis=1)) if V else np.ones(count)
    fields = np.ascontiguousarray(fields * (rms_mm / np.where(rms > 0, rms, 1.0))[:, None, None])
    return fields[0] if n_fields is None else fields
