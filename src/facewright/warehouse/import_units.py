"""Millimetres from meshes whose files do not say their unit."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from facewright.errors import ValueRangeError
from facewright.numeric.check import check_choice

UNITS: dict[str, float] = {"mm": 1.0, "cm": 10.0, "dm": 100.0, "m": 1000.0}
"""Millimetres in each unit."""
# The largest extent of a mesh of a face, with or without head, neck and shoulders, is one power of ten.
SMALLEST_MM, LARGEST_MM = 80.0, 800.0


def unit_of(vertices: NDArray[np.floating[Any]], unit: str, where: Any) -> str:
    """Return the unit of a mesh of a face: the one that is given, or for ``"auto"`` the one that fits its size.

    Parameters
    ----------
    vertices : ndarray of shape (V, 3)
        In the file's unit.
    unit : {"auto", "mm", "cm", "dm", "m"}
    where : object
        Names the mesh in messages.

    Raises
    ------
    ValueRangeError
        If no unit makes the mesh between 80 and 800 mm large.
    """
    check_choice("unit", unit, ("auto", *UNITS))
    extent = float(np.ptp(np.asarray(vertices, dtype=np.float64), axis=0).max())
    for name in UNITS if unit == "auto" else (unit,):
        if SMALLEST_MM <= extent * UNITS[name] < LARGEST_MM:
            return name
    given = f"{extent * UNITS[unit]:.4g} mm" if unit != "auto" else f"{extent:.4g} in an unknown unit"
    raise ValueRangeError(
        f"{where} must be a face between {SMALLEST_MM:g} and {LARGEST_MM:g} mm large, got {given}; give its unit."
    )
