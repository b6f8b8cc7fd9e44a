"""The baseline of photo editing: a thin-plate spline through landmarks in the picture, no 3D."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from facewright.imaging.resample import resample
from facewright.numeric.check import check_finite, check_shape

_BORDER_POINTS = 8  # per side of the picture, which stay
_SMOOTHING = 1e-6  # of the kernel's size: points of closed lips lie on each other
_ROWS = 32  # evaluated at a time


def thin_plate_warp(
    photo: NDArray[np.uint8], source: NDArray[np.floating], target: NDArray[np.floating]
) -> NDArray[np.uint8]:
    """Move landmarks of a picture from `source` to `target`, the rest by a thin-plate spline, the border not at all.

    Parameters
    ----------
    photo : ndarray of shape (H, W, 3), uint8
        The picture.
    source, target : ndarray of shape (L, 2), pixels
        Landmarks before and after.

    Returns
    -------
    ndarray of shape (H, W, 3), uint8
        The warped picture.

    Raises
    ------
    ShapeError, ValueRangeError
        If shapes do not match or a landmark is not finite.

    Notes
    -----
    Bookstein, Principal Warps, 1989: of all maps through the points the one of least bending energy; here from
    target to source, which is where a pixel of the result is looked up.
    """
    sizes = check_shape("photo", photo, "H", "W", 3)
    count = check_shape("source", source, "L", 2)
    check_shape("target", target, "L", 2, **count)
    check_finite("source", source)
    check_finite("target", target)
    height, width = sizes["H"], sizes["W"]
    border = _border(height, width)
    scale = float(max(height, width))
    knots = np.concatenate([target, border]) / scale
    weights = _spline(knots, np.concatenate([source, border]))
    x, y = np.empty((height, width), np.float32), np.empty((height, width), np.float32)
    columns = np.arange(width) / scale
    for top in range(0, height, _ROWS):
        rows = np.arange(top, min(top + _ROWS, height)) / scale
        at = np.stack(np.broadcast_arrays(columns, rows[:, None]), axis=-1).reshape(-1, 2)
        places = _design(at, knots) @ weights
        x[top : top + len(rows)] = places[:, 0].reshape(len(rows), width)
        y[top : top + len(rows)] = places[:, 1].reshape(len(rows), width)
    warped: NDArray[np.uint8] = resample(photo, x, y)
    return warped


def _border(height: int, width: int) -> NDArray[np.float64]:
    """Return points (32, 2) along the picture's edge."""
    along = np.arange(_BORDER_POINTS) / _BORDER_POINTS
    x, y = along * (width - 1), along * (height - 1)
    right, bottom = np.full(_BORDER_POINTS, width - 1.0), np.full(_BORDER_POINTS, height - 1.0)
    sides = [(x, 0 * x), (right, y), (width - 1 - x, bottom), (0 * y, height - 1 - y)]
    return np.concatenate([np.stack(side, axis=1) for side in sides])


def _spline(knots: NDArray[np.float64], values: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the weights (L + 3, 2) of kernel and affine part."""
    design = _design(knots, knots)
    kernel, affine = design[:, :-3], design[:, -3:]
    kernel = kernel + _SMOOTHING * np.abs(kernel).max() * np.eye(len(knots))
    matrix = np.block([[kernel, affine], [affine.T, np.zeros((3, 3))]])
    return np.linalg.solve(matrix, np.concatenate([values, np.zeros((3, 2))]))


def _design(at: NDArray[np.float64], knots: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return U(r) = r^2 log r of points (N, 2) to knots (L, 2), then 1, x, y: (N, L + 3)."""
    squared = (at**2).sum(axis=1)[:, None] + (knots**2).sum(axis=1) - 2.0 * at @ knots.T
    squared = np.maximum(squared, 1e-20)
    return np.concatenate([0.5 * squared * np.log(squared), np.ones((len(at), 1)), at], axis=1)
