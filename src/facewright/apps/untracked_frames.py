"""Frames without a face: the last expression holds, then eases to neutral, and eases back before the face returns."""

from __future__ import annotations

from dataclasses import replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from facewright.errors import NoFaceError
from facewright.models.performance import Performance
from facewright.numeric.rotation import matrix_from_rotation_vector, rotation_vector_from_matrix

#: Seconds that an expression holds after the face is lost, and that it takes to reach the neutral.
HOLD, EASE = 0.4, 0.6
#: Seconds before its return in which the face moves from neutral to what it returns with.
RETURN = 0.2
#: Gaps up to this, seconds, are bridged between what lies before and after.
BRIDGED = 0.25
#: Rows this many usual steps apart leave a pause between them.
_PAUSE_STEPS = 5.0


class Gap(NamedTuple):
    """Frames `first` to `last` (both without a face) and how they were filled."""

    first: int
    last: int
    bridged: bool


def fill_untracked(
    performance: Performance, cuts: NDArray[np.bool_] | None = None
) -> tuple[Performance, tuple[Gap, ...]]:
    """Fill frames without a face; tracked ones stay as they are, so that filling twice changes nothing.

    Short gaps are bridged. In longer ones the last expression holds, eases to neutral, and eases to the next one
    shortly before the face returns; head and gaze turn evenly to where they are next. Nothing is carried over a cut:
    after it the frames are neutral until the face comes. A clip that begins without a face begins neutral.

    Parameters
    ----------
    performance : Performance
        Rows that are not tracked may hold anything valid.
    cuts : ndarray of shape (T,), bool, optional
        Frames that begin another shot.

    Returns
    -------
    performance : Performance
        Filled; `tracked` as before.
    gaps : tuple of Gap
        What was filled, in order.

    Raises
    ------
    NoFaceError
        If no frame is tracked.
    """
    if not performance.tracked.any():
        raise NoFaceError("the clip must show a face, none was found in any of its frames.")
    weights, rotations = performance.weights.copy(), performance.rotations.copy()
    translations, gaze = performance.translations.copy(), performance.gaze.copy()
    gaps = []
    for first, last in _runs(~performance.tracked, cuts):
        starts_shot = first == 0 or (cuts is not None and bool(cuts[first]))
        ends_shot = last == len(weights) - 1 or (cuts is not None and bool(cuts[last + 1]))
        before = None if starts_shot else first - 1
        after = None if ends_shot else last + 1
        rows = slice(first, last + 1)
        t = performance.times[rows]
        t0 = performance.times[before] if before is not None else -np.inf
        t1 = performance.times[after] if after is not None else np.inf
        bridged = bool(t1 - t0 <= BRIDGED)
        share = np.clip((t - t0) / (t1 - t0), 0, 1) if bridged else _ease(1 - (t1 - t) / RETURN)
        hold = np.zeros(len(t)) if before is None else 1 - _ease((t - t0 - HOLD) / EASE)
        leave = (1 - share) if bridged else np.where(hold > 0, hold, 0.0) * (1 - share)
        weights[rows] = 0
        if before is not None:
            weights[rows] += leave[:, None] * performance.weights[before]
        if after is not None:
            weights[rows] += share[:, None] * performance.weights[after]
        a = before if before is not None else after
        b = after if after is not None else before
        if a is None or b is None:  # a whole shot without a face: as the nearest face stands
            a = b = int(np.argmin(np.where(performance.tracked, np.abs(np.arange(len(weights)) - first), np.inf)))
        turn = _ease((t - t0) / (t1 - t0)) if before is not None and after is not None else np.zeros(len(t))
        rotations[rows] = _between(performance.rotations[a], performance.rotations[b], turn)
        translations[rows] = performance.translations[a] + turn[:, None] * (
            performance.translations[b] - performance.translations[a]
        )
        gaze[rows] = performance.gaze[a] + turn[:, None, None] * (performance.gaze[b] - performance.gaze[a])
        gaps.append(Gap(first, last, bridged))
    filled = replace(
        performance,
        weights=np.clip(weights, 0, 1),
        rotations=rotations,
        translations=translations,
        gaze=gaze,
    )
    return filled, tuple(gaps)


def gaps_sentence(gaps: tuple[Gap, ...], n_frames: int) -> str | None:
    """Return one sentence that names the frames without a face, or None where there are none."""
    if not gaps:
        return None
    ranges = [f"{gap.first}" if gap.first == gap.last else f"{gap.first}-{gap.last}" for gap in gaps]
    listed = ", ".join(ranges[:12]) + (f" and {len(ranges) - 12} more runs" if len(ranges) > 12 else "")
    total = sum(gap.last - gap.first + 1 for gap in gaps)
    return (
        f"no face in {total} of {n_frames} frames ({listed}): gaps up to {BRIDGED:g} s are bridged, in longer ones "
        f"the expression holds {HOLD:g} s and then eases to neutral."
    )


def _runs(missing: NDArray[np.bool_], cuts: NDArray[np.bool_] | None) -> list[tuple[int, int]]:
    """Return first and last frame of each run of missing frames, split at cuts."""
    frames = np.flatnonzero(missing)
    if not len(frames):
        return []
    breaks = np.diff(frames) > 1
    if cuts is not None:
        breaks |= cuts[frames[1:]]
    parts = np.split(frames, np.flatnonzero(breaks) + 1)
    return [(int(part[0]), int(part[-1])) for part in parts]


def _ease(share: NDArray[np.float64]) -> NDArray[np.float64]:
    """Smooth step from 0 to 1."""
    s = np.clip(share, 0.0, 1.0)
    return s * s * (3 - 2 * s)


def _between(a: NDArray[np.float64], b: NDArray[np.float64], share: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return rotations on the way from `a` to `b`, (N, 3, 3)."""
    turn = rotation_vector_from_matrix(a.T @ b)
    return a @ matrix_from_rotation_vector(share[:, None] * turn)


def pause_sentence(times: NDArray[np.float64], usual_seconds: float) -> str | None:
    """Return one sentence that names stretches without rows in curves, or None where there are none.

    Parameters
    ----------
    times : ndarray of shape (T,), seconds
        Of the rows, increasing.
    usual_seconds : float
        From one row to the next; five times as much is a pause.
    """
    steps = np.diff(times)
    pauses = np.flatnonzero(steps > _PAUSE_STEPS * usual_seconds)
    if not len(pauses):
        return None
    listed = ", ".join(f"{times[k]:.2f} to {times[k + 1]:.2f} s" for k in pauses[:6]) + (
        " ..." if len(pauses) > 6 else ""
    )
    return f"No rows from {listed}: the expression goes evenly from the one before to the one after."
