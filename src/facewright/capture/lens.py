"""Undo the radial distortion that Apple's cameras state as a table, so that a frame is what a pinhole camera sees."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from facewright.errors import FileFormatError
from facewright.numeric.check import check_shape

_STEP_MM = 10.0
_MAX_MAGNIFICATION = 0.5


@dataclass(frozen=True, eq=False)
class LensTable:
    """Radial distortion as `AVCameraCalibrationData` states it.

    Parameters
    ----------
    centre : (x, y), pixels
        Of the distortion, on the grid of the picture.
    table : ndarray of shape (N,), float64
        Magnification less one that takes an undistorted point to where the lens puts it, by radius: the first entry is
        for the centre, the last for the corner farthest from it (``inverse_lens_distortion_lookup_table``).
    """

    centre: tuple[float, float]
    table: NDArray[np.float64]

    def __post_init__(self) -> None:
        usable = self.table.ndim == 1 and len(self.table) >= 2 and np.isfinite(self.table).all()
        if not usable or np.abs(self.table).max() > _MAX_MAGNIFICATION or not np.isfinite(self.centre).all():
            raise FileFormatError("lens distortion table must be two or more magnifications near 0, got others.")


def undistort(
    color: NDArray[np.uint8], depth: NDArray[np.floating], lens: LensTable
) -> tuple[NDArray[np.uint8], NDArray[np.float32]]:
    """Return a frame as a camera without distortion would see it.

    Between four pixels with depth on one surface the depth is interpolated; at steps and holes the nearest pixel's is
    taken, so that no surface is made up between face and wall.

    Parameters
    ----------
    color : ndarray of shape (H, W, 3), uint8
        Distorted picture.
    depth : ndarray of shape (H, W), millimetres
        Distorted depth; 0 where there is none.
    lens : LensTable
        The distortion.

    Returns
    -------
    color : ndarray of shape (H, W, 3), uint8
    depth : ndarray of shape (H, W), float32
        0 where the distorted picture did not reach.

    Raises
    ------
    ShapeError
        If sizes differ.
    """
    from facewright.capture._lens_kernels import undistort_pixels

    sizes = check_shape("depth", depth, "H", "W")
    check_shape("color", color, "H", "W", 3, **sizes)
    height, width = sizes["H"], sizes["W"]
    x, y = lens.centre
    farthest = math.hypot(max(x, width - x), max(y, height - y))
    return undistort_pixels(
        np.ascontiguousarray(color),
        np.ascontiguousarray(depth, dtype=np.float32),
        float(x),
        float(y),
        farthest,
        np.ascontiguousarray(lens.table, dtype=np.float64),
        _STEP_MM,
    )
