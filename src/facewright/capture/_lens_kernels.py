"""Compiled loop of lens undistortion; see `facewright.capture.lens`."""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray


@njit(cache=True, nogil=True)
def undistort_pixels(
    color: NDArray[np.uint8],
    depth: NDArray[np.float32],
    centre_x: float,
    centre_y: float,
    farthest: float,
    table: NDArray[np.float64],
    step: float,
) -> tuple[NDArray[np.uint8], NDArray[np.float32]]:
    """Look every undistorted pixel up where the lens put it: colour bilinear, depth bilinear on one surface only."""
    height, width = depth.shape
    new_color = np.empty_like(color)
    new_depth = np.zeros_like(depth)
    last = len(table) - 1
    for row in range(height):
        for column in range(width):
            x, y = column - centre_x, row - centre_y
            place = min(np.sqrt(x * x + y * y) / farthest, 1.0) * last
            k = min(int(place), last - 1)
            magnified = 1.0 + table[k] + (place - k) * (table[k + 1] - table[k])
            x, y = centre_x + x * magnified, centre_y + y * magnified
            inside = -0.5 < x < width - 0.5 and -0.5 < y < height - 0.5
            x, y = min(max(x, 0.0), width - 1.0), min(max(y, 0.0), height - 1.0)
            left, top = min(int(x), width - 2), min(int(y), height - 2)
            a, b = x - left, y - top
            w00, w01, w10, w11 = (1 - a) * (1 - b), a * (1 - b), (1 - a) * b, a * b
            for c in range(3):
                mixed = (
                    w00 * color[top, left, c]
                    + w01 * color[top, left + 1, c]
                    + w10 * color[top + 1, left, c]
                    + w11 * color[top + 1, left + 1, c]
                )
                new_color[row, column, c] = np.uint8(mixed + 0.5)
            if not inside:
                continue
            d00, d01, d10, d11 = depth[top, left], depth[top, left + 1], depth[top + 1, left], depth[top + 1, left + 1]
            low, high = min(d00, d01, d10, d11), max(d00, d01, d10, d11)
            if low > 0 and high - low <= step:
                new_depth[row, column] = w00 * d00 + w01 * d01 + w10 * d10 + w11 * d11
            else:
                new_depth[row, column] = depth[int(y + 0.5), int(x + 0.5)]
    return new_color, new_depth
