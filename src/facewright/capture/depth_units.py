"""Tell the unit of depths: metres or tenths of a millimetre that somebody took for millimetres."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from facewright.errors import FileFormatError

#: The nearest things of a recording of a face are this far away, mm; outside, the unit must be another one.
PLAUSIBLE_MM = (100.0, 2000.0)
#: Where a foreign unit must lead, mm; of several units the one that leads nearest to `USUAL_MM` (by ratio) is taken.
POSSIBLE_MM = (150.0, 2000.0)
USUAL_MM = 500.0
# factor to mm -> what the numbers are
_UNITS = {
    1000.0: "metres",
    10.0: "centimetres",
    0.2: "fifths of a millimetre (5000 per metre)",
    0.1: "tenths of a millimetre",
    0.001: "micrometres",
}
#: Pictures that do not say their unit: TUM's 5000 per metre, millimetres, tenths of a millimetre.
_COUNTS_PER_METRE = (5000.0, 1000.0, 10000.0)
_MIN_LEVELS = 16


def nearest_depth(depths: Sequence[NDArray[np.floating | np.integer]]) -> float:
    """Return the distance of the nearest things in depth pictures: the 5th percentile of depths; 0 without depth."""
    near = [float(np.percentile(d[d > 0], 5)) for d in depths if (d > 0).any()]
    return float(np.median(near)) if near else 0.0


def depth_factor(depths: Sequence[NDArray[np.floating]], name: str) -> tuple[float, str | None]:
    """Return the factor that turns depths "in millimetres" into millimetres, and what to tell the user.

    Parameters
    ----------
    depths : sequence of ndarray of shape (H, W)
        Some depth pictures of a recording, said to be in millimetres; 0 where there is none, finite.
    name : str
        Name of the recording, for the message.

    Returns
    -------
    float
        1.0 where the depths look like millimetres.
    str or None
        A sentence where they do not.

    Raises
    ------
    FileFormatError
        If there is no depth at all, no unit makes sense, or the numbers were rounded to whole metres.
    """
    near = nearest_depth(depths)
    if near == 0.0:
        raise FileFormatError(f"{name} must have depth, got frames without any (all zero, negative or NaN).")
    if PLAUSIBLE_MM[0] <= near <= PLAUSIBLE_MM[1]:
        return 1.0, None
    factor = min(_UNITS, key=lambda f: abs(math.log(near * f / USUAL_MM)))
    if not POSSIBLE_MM[0] <= near * factor <= POSSIBLE_MM[1]:
        raise FileFormatError(
            f"{name} must have depths in millimetres of things {PLAUSIBLE_MM[0]:.0f} to {PLAUSIBLE_MM[1]:.0f} mm away, "
            f"got the nearest at {near:.4g}, which makes sense in no usual unit."
        )
    unit = _UNITS[factor]
    if factor > 1.0:
        _check_levels(depths, near, unit, name)
    return factor, (
        f"Depths of {name} look like {unit}, not millimetres (the nearest things at {near:.4g}): "
        f"multiplied by {factor:g}."
    )


def guess_counts_per_metre(counts: NDArray[np.floating | np.integer]) -> float:
    """Return how many counts of a depth picture that says nothing are one metre: 5000 (TUM), 1000 or 10000.

    The one that puts the nearest things nearest to `USUAL_MM`, by ratio; 5000 without depth.
    """
    near = nearest_depth([counts])
    if near == 0.0:
        return _COUNTS_PER_METRE[0]
    return min(_COUNTS_PER_METRE, key=lambda n: abs(math.log(1000.0 * near / n / USUAL_MM)))


def _check_levels(depths: Sequence[NDArray[np.floating]], near: float, unit: str, name: str) -> None:
    levels = np.unique(np.concatenate([d[d > 0].ravel() for d in depths])).size
    if levels < _MIN_LEVELS:
        raise FileFormatError(
            f"{name} must have depths of a millimetre or finer, got only {levels} different ones near {near:.4g}: "
            f"they look like {unit} that were rounded to whole numbers."
        )
