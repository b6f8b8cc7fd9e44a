"""Markers that were not seen: told by the others, joined smoothly to what was seen before and after."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from facewright.errors import ValueRangeError
from facewright.numeric.check import check_shape

Array = NDArray[np.float64]


class FilledGaps(NamedTuple):
    """Offsets without gaps, and what was done.

    Parameters
    ----------
    offsets : ndarray of shape (T, M, 3), millimetres
    n_filled : int
        Values (a marker in a frame) filled in gaps up to the limit.
    n_beyond : int
        Values in longer gaps, told by the other markers alone.
    longest_s : float
        The longest gap, seconds.
    """

    offsets: Array
    n_filled: int
    n_beyond: int
    longest_s: float


def fill_gaps(
    offsets: NDArray[np.floating], times: NDArray[np.floating], precision: NDArray[np.floating], limit_s: float = 0.5
) -> FilledGaps:
    """Fill what was not seen.

    What a marker does is predicted from the markers that were seen in the same frame (its conditional mean under a
    Gaussian prior). How far it was off the prediction before and after the gap is interpolated over gaps up to the
    limit; in longer ones it dies out within the limit, and the prediction stands alone.

    Parameters
    ----------
    offsets : ndarray of shape (T, M, 3), millimetres
        Offsets of the markers from rest, the head held still; NaN where unseen.
    times : ndarray of shape (T,), seconds
    precision : ndarray of shape (3M, 3M), 1 / mm^2
        Inverse covariance of the offsets, marker by marker.
    limit_s : float
        Longest gap that is interpolated, seconds.

    Raises
    ------
    ShapeError, ValueRangeError
        If shapes do not match, the limit is negative, or more than half the markers of a frame are unseen.
    """
    T, M = check_shape("offsets", offsets, "T", "M", 3).values()
    check_shape("times", times, T)
    check_shape("precision", precision, 3 * M, 3 * M)
    if not limit_s >= 0:
        raise ValueRangeError(f"limit_s must not be negative, got {limit_s}.")
    missing = np.isnan(offsets).any(axis=2)
    worst = int(missing.sum(axis=1).argmax()) if T else 0
    if T and 2 * missing[worst].sum() > M:
        raise ValueRangeError(
            f"at least half of the {M} markers must be seen in each frame, got {M - int(missing[worst].sum())} "
            f"at {float(times[worst]):.3f} s; cut the frame out or give another clip."
        )
    known = np.where(missing[..., None], 0.0, np.asarray(offsets, dtype=np.float64))
    predicted = predict_missing(known, missing, precision)
    filled, n_filled, n_beyond, longest = predicted.copy(), 0, 0, 0.0
    for marker in np.flatnonzero(missing.any(axis=0)):
        gaps = _gaps(missing[:, marker])
        for start, stop in gaps:
            ends = [k for k in (start - 1, stop) if 0 <= k < T]
            length = float(times[min(stop, T - 1)] - times[max(start - 1, 0)])
            longest = max(longest, length)
            n_filled += (stop - start) * (length <= limit_s)
            n_beyond += (stop - start) * (length > limit_s)
            if ends:
                deviation = _deviations(known, missing, precision, ends, int(marker))
                inside = times[start:stop]
                filled[start:stop, marker] += _joined(inside, times[ends], deviation, limit_s, length <= limit_s)
    return FilledGaps(filled, n_filled, n_beyond, longest)


def predict_missing(known: Array, missing: NDArray[np.bool_], precision: NDArray[np.floating]) -> Array:
    """Return the offsets (T, M, 3) with those missing replaced by their conditional mean given the rest of the frame.

    `known` holds anything finite where `missing`. Frames with the same markers missing are solved together.
    """
    result = np.where(missing[..., None], 0.0, known)
    rows = np.flatnonzero(missing.any(axis=1))
    if not len(rows):
        return result
    patterns, inverse = np.unique(missing[rows], axis=0, return_inverse=True)
    inverse = inverse.ravel()
    pulled = result[rows].reshape(len(rows), -1) @ precision
    for number, pattern in enumerate(patterns):  # one small factor each
        gone = np.flatnonzero(np.repeat(pattern, 3))
        frames = np.flatnonzero(inverse == number)
        values = -np.linalg.solve(precision[np.ix_(gone, gone)], pulled[np.ix_(frames, gone)].T).T
        block = result[rows[frames]]
        block[:, pattern] = values.reshape(len(frames), -1, 3)
        result[rows[frames]] = block
    return result


def _gaps(missing: NDArray[np.bool_]) -> list[tuple[int, int]]:
    """Return (first, after the last) of each run."""
    edges = np.flatnonzero(np.diff(np.concatenate([[0], missing.astype(np.int8), [0]])))
    return list(zip(edges[::2].tolist(), edges[1::2].tolist(), strict=True))


def _deviations(
    known: Array, missing: NDArray[np.bool_], precision: NDArray[np.floating], frames: list[int], marker: int
) -> Array:
    """Return how far the marker is off its prediction in frames in which it was seen, (K, 3)."""
    without = missing[frames].copy()
    without[:, marker] = True
    return np.asarray(known[frames, marker] - predict_missing(known[frames], without, precision)[:, marker])


def _joined(inside: Array, ends: Array, deviation: Array, limit_s: float, short: bool) -> Array:
    """Spread the deviations at the ends of a gap over it, (n, 3)."""
    if short and len(ends) == 2:
        share = (inside - ends[0]) / (ends[1] - ends[0])
        return np.asarray(deviation[0] + share[:, None] * (deviation[1] - deviation[0]))
    away = np.abs(inside[:, None] - ends[None]) / max(limit_s, 1e-9)
    fade = np.clip(1.0 - away, 0.0, 1.0)
    return np.asarray(fade @ deviation)
