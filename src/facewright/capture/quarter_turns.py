"""Quarter turns of pictures and cameras: a phone that was held sideways records heads that lie on their side."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from facewright.camera.pinhole import Intrinsics
from facewright.errors import ValueRangeError


def check_quarter_turns(turns: int) -> int:
    """Return `turns`; raises ValueRangeError unless it is 0, 1, 2 or 3."""
    if turns not in (0, 1, 2, 3):
        raise ValueRangeError(f"quarter_turns must be 0, 1, 2 or 3 (counter-clockwise), got {turns!r}.")
    return int(turns)


def turn_picture(picture: NDArray[Any], turns: int) -> NDArray[Any]:
    """Return a picture (H, W, ...) turned counter-clockwise by quarter turns, C-contiguous."""
    return np.ascontiguousarray(np.rot90(picture, turns))


def turn_points(points: ArrayLike, size: tuple[int, int], turns: int) -> NDArray[np.float64]:
    """Return where the pixels (..., 2) of a picture of `size` (height, width) lie after it is turned.

    To come back from the turned picture: its own size, and ``-turns % 4``.
    """
    x, y = np.moveaxis(np.asarray(points, dtype=np.float64), -1, 0)
    height, width = size
    for _ in range(turns % 4):
        x, y = y, width - 1 - x
        height, width = width, height
    return np.stack([x, y], axis=-1)


def turn_intrinsics(intrinsics: Intrinsics, size: tuple[int, int], turns: int) -> Intrinsics:
    """Return the camera of the turned picture; its frame is turned about the optical axis."""
    x, y = turn_points([intrinsics.centre_x, intrinsics.centre_y], size, turns)
    focal = (intrinsics.focal_x, intrinsics.focal_y)
    return Intrinsics(*(focal if turns % 2 == 0 else focal[::-1]), float(x), float(y))


def turn_size(size: tuple[int, int], turns: int) -> tuple[int, int]:
    """Return (height, width) of the turned picture."""
    return size if turns % 2 == 0 else (size[1], size[0])
