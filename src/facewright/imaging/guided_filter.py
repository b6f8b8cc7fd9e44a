"""Smooth a map of shares so that its edges are those of a picture: He, Sun, Tang, "Guided image filtering"."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from facewright.numeric.check import check_shape


@dataclass(frozen=True, eq=False)
class LocalLine:
    """A map as a local linear function of a picture's colour: slope . colour + level.

    Parameters
    ----------
    slope : ndarray of shape (h, w, 3), float32
    level : ndarray of shape (h, w), float32
    """

    slope: NDArray[np.float32]
    level: NDArray[np.float32]

    def at(self, picture: NDArray[np.float32]) -> NDArray[np.float32]:
        """Return the map that a picture (h, w, 3) of the same size has."""
        return np.asarray((self.slope * picture).sum(axis=2) + self.level, dtype=np.float32)


def fit_local_lines(
    values: NDArray[np.floating], picture: NDArray[np.floating], radius: int, noise: float
) -> LocalLine:
    """Fit a map by a linear function of the picture's colour in every window, and average the windows' functions.

    Parameters
    ----------
    values : ndarray of shape (h, w)
        The map.
    picture : ndarray of shape (h, w, 3)
        The guide.
    radius : int
        Windows are 2 radius + 1 pixels wide.
    noise : float
        Colours that differ by less are one: the smaller, the closer the map follows the picture.

    Returns
    -------
    LocalLine
        Its slopes may be interpolated for a larger copy of the picture ("fast guided filter").

    Raises
    ------
    ShapeError
        If the sizes do not match.
    """
    sizes = check_shape("values", values, "h", "w")
    check_shape("picture", picture, *sizes.values(), 3)
    guide = np.asarray(picture, np.float64)
    map_ = np.asarray(values, np.float64)

    def mean(array: NDArray[np.float64]) -> NDArray[np.float64]:
        size = (2 * radius + 1,) * 2 + (1,) * (array.ndim - 2)
        return np.asarray(ndimage.uniform_filter(array, size, mode="nearest"))

    colour, level = mean(guide), mean(map_)
    together = mean(guide * map_[..., None]) - colour * level[..., None]
    spread = _covariance(guide, colour, mean)
    spread += noise**2 * np.eye(3)
    slope = np.linalg.solve(spread, together[..., None])[..., 0]
    offset = level - (slope * colour).sum(axis=2)
    return LocalLine(mean(slope).astype(np.float32), mean(offset).astype(np.float32))


def _covariance(guide, colour, mean):  # type: ignore[no-untyped-def]
    """Return the covariance (h, w, 3, 3) of the colours in every window."""
    result = np.empty((*guide.shape, 3))
    for a in range(3):
        for b in range(a + 1):
            result[..., a, b] = mean(guide[..., a] * guide[..., b]) - colour[..., a] * colour[..., b]
            result[..., b, a] = result[..., a, b]
    return result
