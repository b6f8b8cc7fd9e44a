"""Lips that touch in the clip touch in the fit: what of a closed mouth its points, a sum of many, leave ajar."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from facewright.models.blendshapes import BlendshapeRig
from facewright.numeric.check import check_shape

#: Points of ``mediapipe478``: middle of the upper lip's and the lower lip's inner edge, and the eyes' outer corners.
_UPPER, _LOWER = (82, 13, 312), (87, 14, 317)
_EYES = (33, 263)
#: Gap as a share of the distance between the eyes' outer corners: lips that touch are found up to the first apart (GRID
#: clips and renders), at the second they are surely open.
_TOUCH, _APART = 0.006, 0.015
#: Share of the lips' contact, about the middle, whose gap counts.
_MIDDLE = 0.6
#: Shapes that close a mouth, at least by their names.
_OPENS, _CLOSES = "jawOpen", "mouthClose"


def lip_closure(points: NDArray[np.floating]) -> NDArray[np.float64]:
    """Return how surely lips touch, (T,) in [0, 1], of the detector's points (T, 478, 2)."""
    check_shape("points", points, "T", 478, 2)
    apart = np.linalg.norm(points[:, _UPPER] - points[:, _LOWER], axis=2).mean(axis=1)
    width = np.linalg.norm(points[:, _EYES[0]] - points[:, _EYES[1]], axis=1)
    return np.clip((_APART - apart / np.maximum(width, 1e-9)) / (_APART - _TOUCH), 0.0, 1.0).astype(np.float64)


def lip_gap_row(rig: BlendshapeRig, upper: NDArray[np.integer], lower: NDArray[np.integer]) -> NDArray[np.float64]:
    """Return by how much each shape parts a person's lips, (B,) mm, at the vertices that touch, (K,) of each lip."""
    x = rig.neutral[upper, 0]
    middle = np.abs(x - np.median(x)) <= _MIDDLE * np.abs(x - np.median(x)).max()
    return np.asarray((rig.deltas[:, upper[middle], 1] - rig.deltas[:, lower[middle], 1]).mean(axis=1), np.float64)


def with_lips_closed(
    weights: NDArray[np.floating], names: Sequence[str], closure: NDArray[np.floating], row: NDArray[np.floating]
) -> NDArray[np.float64]:
    """Return coefficients whose lips touch where the clip's do: the least change of jawOpen and mouthClose.

    Parameters
    ----------
    weights : ndarray of shape (T, B)
        FACS coefficients, in [0, 1].
    names : sequence of str
        Names of the B shapes; without jawOpen and mouthClose nothing changes.
    closure : ndarray of shape (T,)
        How surely lips touch, from `lip_closure`.
    row : ndarray of shape (B,), mm
        From `lip_gap_row`.

    Returns
    -------
    ndarray of shape (T, B)
        In [0, 1].
    """
    sizes = check_shape("weights", weights, "T", len(names))
    check_shape("closure", closure, sizes["T"])
    check_shape("row", row, len(names))
    result = np.array(weights, dtype=np.float64)
    if _OPENS not in names or _CLOSES not in names:
        return result
    j, m = list(names).index(_OPENS), list(names).index(_CLOSES)
    opens, closes = float(row[j]), -float(row[m])
    if opens <= 0 or closes <= 0:
        return result
    excess = np.asarray(closure, np.float64) * np.maximum(result @ row, 0.0)
    step = excess / (opens**2 + closes**2)
    less = np.minimum(step * opens, result[:, j])
    more = np.minimum((excess - less * opens) / closes, 1.0 - result[:, m])
    less = np.minimum((excess - more * closes) / opens, result[:, j])  # where mouthClose is at its end
    result[:, j] -= less
    result[:, m] += more
    return np.clip(result, 0.0, 1.0)
