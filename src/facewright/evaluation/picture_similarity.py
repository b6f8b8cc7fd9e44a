"""How alike two pictures are within a region: peak signal-to-noise ratio and structural similarity."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from facewright.errors import ValueRangeError
from facewright.numeric.check import check_shape

_SIGMA = 1.5  # pixels; 11 x 11 window of Wang et al.
_C1, _C2 = (0.01 * 255) ** 2, (0.03 * 255) ** 2


def psnr_db(picture: NDArray[np.uint8], truth: NDArray[np.uint8], region: NDArray[np.bool_]) -> float:
    """Return the peak signal-to-noise ratio of pictures (H, W, 3), sRGB of 8 bits, over a region (H, W), decibels.

    Equal pictures give 100.

    Raises
    ------
    ShapeError
        If the pictures are not of one size.
    ValueRangeError
        If the region is empty.
    """
    _check(picture, truth, region)
    error = np.mean((picture[region].astype(np.float64) - truth[region]) ** 2)
    return float(min(10 * np.log10(255.0**2 / max(error, 1e-12)), 100.0))


def ssim(picture: NDArray[np.uint8], truth: NDArray[np.uint8], region: NDArray[np.bool_]) -> float:
    """Return the mean structural similarity of pictures (H, W, 3) over the pixels of a region (H, W), in [-1, 1].

    Of the luma, under a Gaussian window of 1.5 pixels, C1 and C2 as published (Wang, Bovik, Sheikh, Simoncelli, 2004).

    Raises
    ------
    ShapeError, ValueRangeError
        As `psnr_db`.
    """
    _check(picture, truth, region)
    a, b = (image @ np.array([0.299, 0.587, 0.114]) for image in (picture, truth))

    def mean(values: NDArray[np.float64]) -> NDArray[np.float64]:
        return np.asarray(ndimage.gaussian_filter(values, _SIGMA, truncate=3.5))

    ma, mb = mean(a), mean(b)
    va, vb, cov = mean(a * a) - ma**2, mean(b * b) - mb**2, mean(a * b) - ma * mb
    similarity = (2 * ma * mb + _C1) * (2 * cov + _C2) / ((ma**2 + mb**2 + _C1) * (va + vb + _C2))
    return float(similarity[region].mean())


def _check(picture: NDArray[np.uint8], truth: NDArray[np.uint8], region: NDArray[np.bool_]) -> None:
    sizes = check_shape("picture", picture, "H", "W", 3)
    check_shape("truth", truth, "H", "W", 3, **sizes)
    check_shape("region", region, "H", "W", H=sizes["H"], W=sizes["W"])
    if not region.any():
        raise ValueRangeError("region must hold at least one pixel, got none.")
