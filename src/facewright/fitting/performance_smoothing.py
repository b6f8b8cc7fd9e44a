"""Smoothing a performance over time, forwards and backwards at once: no jitter, no lag, sharp blinks."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numba import njit
from numpy.typing import NDArray
from scipy.linalg import solveh_banded
from scipy.spatial.transform import Rotation, Slerp

from facewright.fitting.dense_model import CENTRE, FramePose
from facewright.models.performance import Performance

#: How much a coefficient usually changes in a 25th of a second, by the start of its name; faces are quick at the lids
#: and lips. The changes' distribution has long tails, so that what happens quickly stays quick.
_CHANGE = {"eyeBlink": 0.2, "mouth": 0.06, "jaw": 0.06}
_OTHER_CHANGE = 0.04
_TAIL = 4.0
_SWEEPS = 8
#: Strength of the smoothing of the head's motion: frames of a 25th of a second that act together, to the fourth.
_MOTION = 4.0
#: A face that is lost: hold its expression, then ease to the neutral.
HOLD_SECONDS, EASE_SECONDS = 0.4, 0.6


def smooth_coefficients(
    hessians: NDArray[np.float64],
    slopes: NDArray[np.float64],
    beta: NDArray[np.float64],
    steps: NDArray[np.float64],
    names: Sequence[str],
    strength: float = 1.0,
) -> NDArray[np.float64]:
    """Minimise the sum of all frames' energies and a penalty on changes, within [0, 1].

    Frame t has energy b^T H_t b / 2 + s_t^T b; a change d of coefficient i costs (nu + 1) / 2 log(1 + (d / sigma_i)^2
    / nu): a Student t prior, quadratic for small changes and nearly flat for what really moves. What is uncertain in
    a frame takes its value from the frames before and after, alike.

    Parameters
    ----------
    hessians, slopes : ndarray of shape (T, B, B) and (T, B)
        Of each frame.
    beta : ndarray of shape (T, B)
        Where to start.
    steps : ndarray of shape (T - 1,), seconds
        Between frames.
    names : sequence of str
        Names of the B shapes.
    strength : float
        Scales sigma^-2.

    Returns
    -------
    ndarray of shape (T, B)
        The minimiser.
    """
    usual = np.array([next((v for k, v in _CHANGE.items() if name.startswith(k)), _OTHER_CHANGE) for name in names])
    spread2 = usual**2 / strength * np.maximum(steps[:, None] * 25.0, 1e-3)
    x = np.ascontiguousarray(beta, dtype=np.float64).copy()
    _smooth(
        np.ascontiguousarray(hessians), np.ascontiguousarray(slopes), x, np.ascontiguousarray(spread2), _TAIL, _SWEEPS
    )
    return x


@njit(cache=True, nogil=True)
def _smooth(H, s, x, spread2, nu, sweeps):  # type: ignore[no-untyped-def]
    T, B = x.shape
    link = np.zeros((T + 1, B))  # link[t] ties frame t - 1 to frame t
    for sweep in range(sweeps):
        for t in range(1, T):
            for i in range(B):
                d = x[t, i] - x[t - 1, i]
                link[t, i] = (nu + 1.0) / (nu + d * d / spread2[t - 1, i]) / spread2[t - 1, i]
        for k in range(T):
            t = k if sweep % 2 == 0 else T - 1 - k
            for _ in range(2):
                for i in range(B):
                    slope = s[t, i]
                    for j in range(B):
                        slope += H[t, i, j] * x[t, j]
                    weight = H[t, i, i]
                    if t > 0:
                        slope += link[t, i] * (x[t, i] - x[t - 1, i])
                        weight += link[t, i]
                    if t < T - 1:
                        slope += link[t + 1, i] * (x[t, i] - x[t + 1, i])
                        weight += link[t + 1, i]
                    x[t, i] = min(max(x[t, i] - slope / weight, 0.0), 1.0)


def smooth_motion(
    poses: Sequence[FramePose], times: NDArray[np.float64], strength: float = 1.0
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return rotations (T, 3, 3) and translations (T, 3) of poses with little acceleration (Whittaker's smoother).

    The middle of the head and the rotation about it are smoothed, not the model's origin.
    """
    rotations = np.array([pose.motion.rotation for pose in poses])
    middles = np.array([pose.motion.apply(CENTRE) for pose in poses])
    if len(poses) > 2 and strength > 0:
        rate = 1.0 / (25.0 * float(np.median(np.diff(times))))
        weight = strength * (_MOTION * rate) ** 4 / 16.0
        mean = Rotation.from_matrix(rotations).mean()
        vectors = (mean.inv() * Rotation.from_matrix(rotations)).as_rotvec()
        rotations = (mean * Rotation.from_rotvec(_whittaker(vectors, weight))).as_matrix()
        # depth is the least certain: the logarithm is smoothed more
        middles = np.column_stack([_whittaker(middles[:, :2], weight), _whittaker(middles[:, 2:], 10.0 * weight)])
    return rotations, middles - rotations @ CENTRE


def _whittaker(values: NDArray[np.float64], weight: float) -> NDArray[np.float64]:
    """Minimise |x - values|^2 + weight |second differences of x|^2 over each column."""
    T = len(values)
    D = np.zeros((3, T))
    bands = np.zeros((3, T))
    for offset, factor in enumerate((1.0, -2.0, 1.0)):
        D[offset] = factor
    for a in range(3):
        for b in range(a, 3):
            rows = np.arange(T - 2)
            bands[2 - (b - a), rows + b] += weight * D[a, rows] * D[b, rows]
    bands[2] += 1.0
    return np.asarray(solveh_banded(bands, values))


def fill_gaps(performance: Performance) -> Performance:
    """Return the performance with frames without a face filled: hold, then ease to the neutral; heads move evenly."""
    seen = np.flatnonzero(performance.tracked)
    if not len(seen) or len(seen) == performance.n_frames:
        return performance
    times = performance.times
    before = seen[np.clip(np.searchsorted(seen, np.arange(len(times)), side="right") - 1, 0, len(seen) - 1)]
    lost = ~performance.tracked
    gone = np.abs(times - times[before])
    share = np.clip(1.0 - (gone - HOLD_SECONDS) / EASE_SECONDS, 0.0, 1.0)
    weights, gaze = performance.weights.copy(), performance.gaze.copy()
    share = share * share * (3.0 - 2.0 * share)
    weights[lost] = performance.weights[before[lost]] * share[lost, None]
    gaze[lost] = performance.gaze[before[lost]] * share[lost, None, None]
    rotations, translations = performance.rotations.copy(), performance.translations.copy()
    inner = np.clip(times, times[seen[0]], times[seen[-1]])
    if len(seen) > 1:
        turns = Slerp(times[seen], Rotation.from_matrix(performance.rotations[seen]))
        rotations[lost] = turns(inner[lost]).as_matrix()
    else:
        rotations[lost] = performance.rotations[seen[0]]
    for axis in range(3):
        translations[lost, axis] = np.interp(times[lost], times[seen], performance.translations[seen, axis])
    return replace(performance, weights=weights, gaze=gaze, rotations=rotations, translations=translations)
