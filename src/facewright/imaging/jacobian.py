"""Keep an inverse map free of folds: its Jacobian stays positive but where one surface hides another."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from facewright.imaging._warp_kernels import blocks_with, jacobian_minimum
from facewright.numeric.check import check_shape

_ROUNDS = 9
_NEARLY = 0.2  # as in `jacobian_minimum`
_GROWTH = 1.5  # of the smoothed neighbourhood from round to round


@dataclass(frozen=True)
class Untangled:
    """What `untangle` found.

    Parameters
    ----------
    smallest : float
        Smallest determinant that is left; 1 where nothing moves.
    rounds : int
        How often it had to smooth.
    """

    smallest: float
    rounds: int


def untangle(
    displacement: NDArray[np.float32], breaks: NDArray[np.bool_], offset: tuple[int, int] = (0, 0)
) -> Untangled:
    """Smooth a map p + displacement(p) in place where its Jacobian is not positive, until it is.

    Parameters
    ----------
    displacement : ndarray of shape (H, W, 2), float32, pixels
        Changed in place, only near folds.
    breaks : ndarray of shape (h, w), bool
        Pixels at whose right or lower side the map may jump: one surface ends before another.
    offset : (x, y)
        Where `breaks` begins in the picture.

    Returns
    -------
    Untangled
        The smallest determinant left.

    Raises
    ------
    ShapeError
        If the shapes do not match.
    """
    check_shape("displacement", displacement, "H", "W", 2)
    check_shape("breaks", breaks, "h", "w")
    smallest = 1.0
    for done in range(_ROUNDS + 1):
        bad = np.zeros(displacement.shape[:2], np.float32)
        smallest, count = jacobian_minimum(displacement, breaks, offset, bad)
        # what nearly folds is smoothed once too, by as much: maps that change little change little
        if (count == 0 and (done or smallest >= _NEARLY)) or done == _ROUNDS:
            return Untangled(float(smallest), done)
        _smooth(displacement, bad, round((2 + min(bad.shape) / 500) * _GROWTH**done))
    return Untangled(float(smallest), _ROUNDS)


def _smooth(displacement: NDArray[np.float32], bad: NDArray[np.float32], reach: int) -> None:
    """Replace the displacement near bad pixels by a local mean, in place."""
    block = max(4, 2 * reach)
    coarse = blocks_with(bad, block)
    for part in ndimage.find_objects(ndimage.label(coarse, np.ones((3, 3)))[0]):
        rows, cols = (slice(max(p.start * block - 4 * reach, 0), p.stop * block + 4 * reach) for p in part)
        near = bad[rows, cols]
        share = np.clip(3.0 * ndimage.uniform_filter(ndimage.maximum_filter(near, 2 * reach + 1), 2 * reach + 1), 0, 1)
        here = displacement[rows, cols]
        for k in range(2):
            mean = ndimage.gaussian_filter(here[..., k], 0.7 * reach, mode="nearest")
            here[..., k] += share * (mean - here[..., k])
