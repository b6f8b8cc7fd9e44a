"""Units and axes of marker files: as they say, as asked, or guessed and said."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from facewright.errors import ValueRangeError

MM_PER_UNIT = {"mm": 1.0, "cm": 10.0, "m": 1000.0, "in": 25.4}
UP_AXES = ("x", "y", "z", "-x", "-y", "-z")
_NAMES = {
    **{name: "mm" for name in ("mm", "millimeter", "millimeters", "millimetre", "millimetres")},
    **{name: "cm" for name in ("cm", "centimeter", "centimeters", "centimetre", "centimetres")},
    **{name: "m" for name in ("m", "meter", "meters", "metre", "metres")},
    **{name: "in" for name in ("in", "inch", "inches")},
}
#: Markers on a face are this far from their middle, root mean square, millimetres: about 60.
_FACE_SPREAD_MM = (25.0, 250.0)


def unit_named(text: str) -> str | None:
    """Return ``"mm"``, ``"cm"``, ``"m"`` or ``"in"`` for a unit as files write it, or None."""
    return _NAMES.get(text.strip().strip("()[]").lower())


def guess_unit(positions: NDArray[np.floating]) -> str:
    """Return the unit in which labelled points (T, M, 3) have the size of a face, by powers of ten.

    Raises
    ------
    ValueRangeError
        If no unit gives a face's size.
    """
    centre = np.nanmean(positions, axis=1, keepdims=True)
    spread = float(np.sqrt(np.nanmedian(((positions - centre) ** 2).sum(axis=2))))
    for unit in ("mm", "m", "cm"):
        if _FACE_SPREAD_MM[0] <= spread * MM_PER_UNIT[unit] <= _FACE_SPREAD_MM[1]:
            return unit
    raise ValueRangeError(
        f"the markers' unit must be one in which they span a face, got points {spread:.3g} from their middle; "
        "give the unit."
    )


def turned_up(positions: NDArray[np.floating], up: str) -> NDArray[np.float64]:
    """Return positions (..., 3) turned so that the axis `up` becomes y: a rotation, nothing is mirrored.

    Raises
    ------
    ValueRangeError
        If `up` is not x, y or z or one of them with a minus.
    """
    if up not in UP_AXES:
        raise ValueRangeError(f"up must be one of {', '.join(UP_AXES)}, got {up!r}.")
    values = np.asarray(positions, dtype=np.float64)
    axis = "xyz".index(up[-1])
    # cyclic, so that the three axes stay right-handed
    turned = values[..., [(axis - 1) % 3, axis, (axis + 1) % 3]]
    return turned * [-1.0, -1.0, 1.0] if up.startswith("-") else turned
