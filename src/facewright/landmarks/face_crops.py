"""The face's own brightness in each frame of a video, small enough to keep: grey squares round the detected points."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from facewright.errors import ShapeError
from facewright.numeric.check import check_shape

#: Pixels of a side: 25.6 kB a frame, 2.3 GB an hour, on disk.
CROP_SIDE = 160
#: The square is so much larger than the points' box.
_MARGIN = 1.12


class FaceCrop(NamedTuple):
    """A grey square of a frame.

    Parameters
    ----------
    pixels : ndarray of shape (S, S), uint8
        sRGB brightness.
    corner : ndarray of shape (2,), float64, pixels
        Where the middle of its first pixel is in the frame.
    step : float, pixels
        From one of its pixels to the next, in the frame.
    """

    pixels: NDArray[np.uint8]
    corner: NDArray[np.float64]
    step: float


def cut_face(image: NDArray[np.uint8], points: NDArray[np.floating], side: int = CROP_SIDE) -> FaceCrop:
    """Return the square round detected points, every one of its pixels a mean over its share of the frame.

    Parameters
    ----------
    image : ndarray of shape (H, W, 3), uint8
        sRGB frame.
    points : ndarray of shape (N, 2), pixels
        Where the face is.
    side : int
        Pixels of the square's side.

    Raises
    ------
    ShapeError
        If the picture is not (H, W, 3) of uint8, or points are not (N, 2).
    """
    if image.ndim != 3 or image.shape[2] != 3 or image.dtype != np.uint8 or 0 in image.shape:
        raise ShapeError(f"image must be (H, W, 3) of uint8, got {image.shape} of {image.dtype}.")
    check_shape("points", points, "N", 2)
    low, high = points.min(axis=0).astype(np.float64), points.max(axis=0).astype(np.float64)
    step = _MARGIN * float((high - low).max()) / (side - 1)
    # what is stored is what was sampled: float32 corners and steps
    step = float(np.float32(max(step, 1e-3)))
    corner = ((low + high) / 2.0 - step * (side - 1) / 2.0).astype(np.float32).astype(np.float64)
    pixels = np.empty((side, side), np.uint8)
    _shrink(np.ascontiguousarray(image), corner[0], corner[1], step, pixels)
    return FaceCrop(pixels, corner, step)


@njit(cache=True, nogil=True)
def _shrink(image, left, top, step, out):  # type: ignore[no-untyped-def]
    """Fill a square with means under a tent of the step's width (bilinear where the step is less than a pixel)."""
    height, width = image.shape[:2]
    side = out.shape[0]
    reach = max(step, 1.0)
    most = int(2 * reach) + 3
    columns, shares, counts = np.zeros(side, np.int64), np.zeros((side, most), np.float32), np.zeros(side, np.int64)
    for i in range(side):
        x = left + i * step
        first = int(np.ceil(x - reach))
        columns[i] = first
        n = 0
        while first + n < x + reach and n < most:
            shares[i, n] = 1.0 - abs(first + n - x) / reach
            n += 1
        counts[i] = n
    for j in range(side):
        y = top + j * step
        first = int(np.ceil(y - reach))
        last = int(np.floor(y + reach))
        for i in range(side):
            total, weight = np.float32(0.0), np.float32(0.0)
            for row in range(max(first, 0), min(last, height - 1) + 1):
                tall = np.float32(1.0 - abs(row - y) / reach)
                for k in range(counts[i]):
                    column = columns[i] + k
                    if column < 0 or column >= width:
                        continue
                    share = tall * shares[i, k]
                    r, g, b = image[row, column, 0], image[row, column, 1], image[row, column, 2]
                    total += share * (np.float32(0.3) * r + np.float32(0.6) * g + np.float32(0.1) * b)
                    weight += share
            out[j, i] = np.uint8(total / weight + np.float32(0.5)) if weight > 0.0 else 0


@dataclass(frozen=True, eq=False)
class FaceCrops:
    """The squares of all frames of a video, in one or several arrays, which may be mapped files.

    Parameters
    ----------
    pieces : sequence of ndarray of shape (T_i, S, S), uint8
        The pixels of consecutive frames; zero where no face was found.
    corners : ndarray of shape (T, 2), float32, pixels
    steps : ndarray of shape (T,), float32, pixels
        See `FaceCrop`; 0 where no face was found.

    Raises
    ------
    ShapeError
        If the pieces have not T frames in all.
    """

    pieces: Sequence[NDArray[np.uint8]]
    corners: NDArray[np.float32]
    steps: NDArray[np.float32]

    def __post_init__(self) -> None:
        for piece in self.pieces:
            check_shape("a piece of crops", piece, "n", "s", "s")
        sizes = check_shape("corners", self.corners, "T", 2)
        check_shape("steps", self.steps, "T", **sizes)
        total = sum(len(piece) for piece in self.pieces)
        if total != len(self.steps):
            raise ShapeError(f"crops must be as many as their steps, got {total} and {len(self.steps)}.")

    @classmethod
    def of(cls, crops: Iterable[FaceCrop | None], side: int = CROP_SIDE) -> FaceCrops:
        """Return the crops of each frame, None where no face was found."""
        found = list(crops)
        pixels = np.zeros((len(found), side, side), np.uint8)
        corners, steps = np.zeros((len(found), 2), np.float32), np.zeros(len(found), np.float32)
        for k, crop in enumerate(found):
            if crop is not None:
                pixels[k], corners[k], steps[k] = crop.pixels, crop.corner, crop.step
        return cls((pixels,), corners, steps)

    @property
    def n_frames(self) -> int:
        """Number of frames T."""
        return len(self.steps)

    def at(self, frame: int) -> FaceCrop | None:
        """Return a frame's crop; None where no face was found."""
        if self.steps[frame] <= 0:
            return None
        row = frame
        for piece in self.pieces:
            if row < len(piece):
                break
            row -= len(piece)
        return FaceCrop(np.asarray(piece[row]), self.corners[frame].astype(np.float64), float(self.steps[frame]))
