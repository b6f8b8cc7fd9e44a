"""One picture of a depth camera."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from facewright.camera.pinhole import Intrinsics
from facewright.errors import ValueRangeError
from facewright.numeric.check import check_shape


@dataclass(frozen=True, eq=False)
class RGBDFrame:
    """Colour and depth on one pixel grid.

    Parameters
    ----------
    color : ndarray of shape (H, W, 3), uint8
        sRGB.
    depth : ndarray of shape (H, W), float32, millimetres
        Distance along the optical axis; 0 where the camera saw none.
    intrinsics : Intrinsics
        Of this grid.
    time : float
        Seconds.

    Raises
    ------
    ShapeError
        If colour and depth are not of one size.
    ValueRangeError
        If colour is not uint8, or a depth is negative or not finite.
    """

    color: NDArray[np.uint8]
    depth: NDArray[np.float32]
    intrinsics: Intrinsics
    time: float = 0.0

    def __post_init__(self) -> None:
        sizes = check_shape("depth", self.depth, "H", "W")
        check_shape("color", self.color, "H", "W", 3, **sizes)
        if self.color.dtype != np.uint8:
            raise ValueRangeError(f"color must be uint8, got {self.color.dtype}.")
        if not (np.isfinite(self.depth).all() and (self.depth >= 0).all()):
            raise ValueRangeError("depth must be finite and not negative, 0 where there is none.")

    @property
    def size(self) -> tuple[int, int]:
        """(height, width), pixels."""
        return self.depth.shape[0], self.depth.shape[1]
