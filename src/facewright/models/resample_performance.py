"""A performance at other moments: coefficients, poses and gaze between frames."""

from __future__ import annotations

from fractions import Fraction

import numpy as np
from numpy.typing import NDArray

from facewright.errors import ValueRangeError
from facewright.models.performance import Performance
from facewright.numeric.rotation import matrix_from_rotation_vector, rotation_vector_from_matrix

COMMON_RATES: tuple[Fraction, ...] = (
    Fraction(24000, 1001),
    Fraction(24),
    Fraction(25),
    Fraction(30000, 1001),
    Fraction(30),
    Fraction(48),
    Fraction(50),
    Fraction(60000, 1001),
    Fraction(60),
)


def usual_rate(times: NDArray[np.float64]) -> Fraction:
    """Return the frame rate of times (T,) by their median step: a common one within 0.05 %, else the rounded one."""
    if len(times) < 2:
        return Fraction(30)
    rate = 1.0 / float(np.median(np.diff(times)))
    nearest = min(COMMON_RATES, key=lambda common: abs(float(common) - rate))
    if abs(float(nearest) - rate) < 5e-4 * rate:
        return nearest
    return max(Fraction(1), Fraction(round(rate)))


def resampled(performance: Performance, times: NDArray[np.float64]) -> Performance:
    """Return the performance at `times` (N,), linear between its frames; rotations on the shortest way.

    A moment is tracked if the nearer frame is. Frames must have been filled before, see
    `facewright.apps.untracked_frames`: rows that mean nothing would be mixed in.

    Raises
    ------
    ValueRangeError
        If a time lies outside the performance.
    """
    own = performance.times
    if len(times) and (times.min() < own[0] - 1e-9 or times.max() > own[-1] + 1e-9):
        raise ValueRangeError(f"times must lie in [{own[0]:g}, {own[-1]:g}] s, got [{times.min():g}, {times.max():g}].")
    right = np.clip(np.searchsorted(own, times, side="left"), 1, max(1, len(own) - 1))
    left = right - 1
    right = np.minimum(right, len(own) - 1)
    step = np.maximum(own[right] - own[left], 1e-12)
    share = np.clip((times - own[left]) / step, 0.0, 1.0)

    def mixed(values: NDArray[np.float64]) -> NDArray[np.float64]:
        s = share.reshape(-1, *[1] * (values.ndim - 1))
        return (1 - s) * values[left] + s * values[right]

    turn = rotation_vector_from_matrix(np.swapaxes(performance.rotations[left], 1, 2) @ performance.rotations[right])
    return Performance(
        times=np.asarray(times, dtype=np.float64),
        names=performance.names,
        weights=np.clip(mixed(performance.weights), 0.0, 1.0),
        rotations=performance.rotations[left] @ matrix_from_rotation_vector(share[:, None] * turn),
        translations=mixed(performance.translations),
        gaze=mixed(performance.gaze),
        tracked=np.where(share < 0.5, performance.tracked[left], performance.tracked[right]),
    )
