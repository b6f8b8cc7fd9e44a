"""Fine detail of one picture brought to what another shows: grain, and the contrast of hair."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from facewright.numeric.check import check_shape

_KERNEL = np.array([1.0, 4.0, 6.0, 4.0, 1.0], dtype=np.float32) / 16.0  # cubic B-spline
_GRAIN_BANDS = 3  # of 1, 2 and 4 pixels: a sensor's noise after demosaicking and JPEG
_ENOUGH = 0.9  # a picture so little noisier than the other is left alone
_EDGE = 4.0  # times the usual magnitude of a band: twice that is no grain but an edge, which stays
_CONTRAST = 1.3  # so many times the target's contrast the reference may have


def match_grain(
    source: NDArray[np.float32], target: NDArray[np.float32], where: NDArray[np.bool_]
) -> NDArray[np.float32]:
    """Reduce the grain of a picture to that of another; edges stay.

    Parameters
    ----------
    source, target : ndarray of shape (H, W, 3), float32
        Pictures of the same scale, such as logarithms of light; the noisier may be `source`.
    where : ndarray of shape (H, W), bool
        Pixels that show skin in both, where grain is measured.

    Returns
    -------
    ndarray of shape (H, W, 3), float32
        The source; its bands of 1, 2 and 4 pixels are scaled down to the target's usual strength on skin where they
        are as faint as grain, and stay where they are much stronger.

    Raises
    ------
    ShapeError
        If shapes do not match.
    """
    sizes = check_shape("source", source, "H", "W", 3)
    check_shape("target", target, "H", "W", 3, **sizes)
    check_shape("where", where, "H", "W", **sizes)
    result = source.copy()
    if not where.any():
        return result
    for own, other in zip(_bands(source, _GRAIN_BANDS), _bands(target, _GRAIN_BANDS), strict=True):
        magnitude = np.linalg.norm(own, axis=2)
        usual, wanted = float(np.median(magnitude[where])), float(np.median(np.linalg.norm(other, axis=2)[where]))
        if wanted < _ENOUGH * usual:
            edge = np.clip(magnitude / (_EDGE * usual) - 1.0, 0.0, 1.0)
            result -= own * ((1.0 - wanted / usual) * (1.0 - edge))[..., None]
    return result


def limit_contrast(
    source: NDArray[np.float32], target: NDArray[np.float32], weight: NDArray[np.floating], reach: float
) -> NDArray[np.float32]:
    """Limit the contrast of a part of a picture to at most 1.3 times that of another, finer or coarser detail alike.

    Parameters
    ----------
    source, target : ndarray of shape (H, W, 3), float32
        Pictures of the same scale, aligned.
    weight : ndarray of shape (H, W)
        In [0, 1]: how much a pixel belongs to the part.
    reach : float
        Size of the coarsest detail, pixels.

    Returns
    -------
    ndarray of shape (H, W, 3), float32
        The source, with its bands scaled down where their root mean square over the part exceeds the limit.

    Raises
    ------
    ShapeError
        If shapes do not match.
    """
    sizes = check_shape("source", source, "H", "W", 3)
    check_shape("target", target, "H", "W", 3, **sizes)
    check_shape("weight", weight, "H", "W", **sizes)
    result, mass = source.copy(), weight[..., None].astype(np.float32)
    if not weight.any():
        return result
    count = max(1, round(np.log2(max(reach, 2.0))))
    for own, other in zip(_bands(source, count), _bands(target, count), strict=True):
        is_strength, wanted = (float(np.sqrt((mass * band**2).sum())) for band in (own, other))
        if is_strength > _CONTRAST * wanted:
            result -= (1.0 - _CONTRAST * wanted / is_strength) * mass * own
    return result


def _bands(picture: NDArray[np.float32], count: int) -> list[NDArray[np.float32]]:
    """Return what a picture shows of 1, 2, 4, ... pixels: differences of ever smoother pictures (a trous)."""
    bands, rough = [], picture
    for k in range(count):
        kernel = np.zeros(4 * 2**k + 1, dtype=np.float32)
        kernel[:: 2**k] = _KERNEL
        smooth = ndimage.convolve1d(ndimage.convolve1d(rough, kernel, axis=0), kernel, axis=1)
        bands.append(rough - smooth)
        rough = smooth
    return bands
