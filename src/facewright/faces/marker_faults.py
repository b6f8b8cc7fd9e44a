"""What goes wrong in motion capture: markers unseen for a while, neighbours that swap their labels."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

#: Dropouts of a marker per second, their mean length in seconds, and how much likelier the outermost ones are unseen.
_DROPOUTS_PER_S, _DROPOUT_S, _OUTER = 0.06, 0.18, 2.5
#: Swaps of two labels per second over all markers, and their lengths in seconds.
_SWAPS_PER_S, _SWAP_S = 0.2, (0.08, 0.8)


@dataclass(frozen=True, eq=False)
class MarkerFaults:
    """Faults of a recording, for tests of what mends them.

    Parameters
    ----------
    seen : ndarray of shape (T, M), bool
        Where the marker that a column is labelled for was seen.
    swaps : tuple of (int, int, int, int)
        Marker, other marker, first frame and frame after the last of each swap of labels.
    """

    seen: NDArray[np.bool_]
    swaps: tuple[tuple[int, int, int, int], ...]


def draw_faults(truth: NDArray[np.float64], times: NDArray[np.float64], rng: np.random.Generator) -> MarkerFaults:
    """Draw dropouts, likelier at the rim of the face, and swaps of neighbours, for true positions (T, M, 3)."""
    T, M = truth.shape[:2]
    seconds = float(times[-1] - times[0]) if T > 1 else 0.0
    rate = T / max(seconds, 1e-9) if T > 1 else 1.0
    rest = truth[0]
    off = np.linalg.norm(rest - rest.mean(axis=0), axis=1)
    likely = 1.0 + (_OUTER - 1.0) * (off / max(off.max(), 1e-9)) ** 3
    seen = np.ones((T, M), bool)
    for marker, count in enumerate(rng.poisson(_DROPOUTS_PER_S * seconds * likely)):
        for _ in range(count):
            start, length = int(rng.integers(T)), 1 + int(rng.exponential(_DROPOUT_S) * rate)
            seen[start : start + length, marker] = False
    seen[0] = True  # takes begin with all markers in view
    neighbours = cKDTree(rest).query(rest, k=min(4, M))[1].reshape(M, -1)
    swaps: list[tuple[int, int, int, int]] = []
    for _ in range(rng.poisson(_SWAPS_PER_S * seconds) if M > 1 else 0):
        a = int(rng.integers(M))
        b = int(neighbours[a, rng.integers(1, neighbours.shape[1])])
        start = int(rng.integers(1, max(2, T)))
        stop = min(T, start + max(2, int(rng.uniform(*_SWAP_S) * rate)))
        free = all(stop <= s or start >= e or not {a, b} & {c, d} for c, d, s, e in swaps)
        if free and start < stop:
            swaps.append((a, b, start, stop))
    return MarkerFaults(seen, tuple(swaps))


def faulty_markers(
    truth: NDArray[np.float64], faults: MarkerFaults, noise_mm: float, rng: np.random.Generator
) -> NDArray[np.float64]:
    """Return the positions (T, M, 3) as recorded: noise, NaN where unseen, labels swapped."""
    result = truth + noise_mm * rng.standard_normal(truth.shape)
    result[~faults.seen] = np.nan
    for a, b, start, stop in faults.swaps:
        result[start:stop, [a, b]] = result[start:stop, [b, a]]
    return result
