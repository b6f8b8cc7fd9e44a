"""Where a person is in a picture, from the segmentation network that MediaPipe brings along."""

from __future__ import annotations

from collections.abc import Callable
from importlib.util import find_spec

import numpy as np
from numpy.typing import NDArray

from facewright.landmarks.mediapipe_detector import import_mediapipe, quiet_native_log
from facewright.numeric.check import check_shape

_LONGEST = 512  # pixels: the network looks at 256 x 256


def person_probability(picture: NDArray[np.uint8]) -> NDArray[np.float32] | None:
    """Return how likely each pixel shows a person: hair, clothes and what is worn included.

    Parameters
    ----------
    picture : ndarray of shape (H, W, 3), uint8
        sRGB; a person should take up a good part of it.

    Returns
    -------
    ndarray of shape (h, w), float32, in [0, 1], or None
        For a picture of the same extent, reduced to at most 512 pixels a side; None where MediaPipe's release has no
        such network.

    Raises
    ------
    MissingExtraError
        If MediaPipe is not installed.
    ShapeError
        If the picture has another shape.
    """
    check_shape("picture", picture, "H", "W", 3)
    every = max(1, -(-max(picture.shape[:2]) // _LONGEST))
    with quiet_native_log():
        solutions = getattr(import_mediapipe(), "solutions", None)
        network = getattr(solutions, "selfie_segmentation", None)
        if network is None:
            return None
        with network.SelfieSegmentation(model_selection=0) as segmenter:
            found = segmenter.process(_reduced(picture, every)).segmentation_mask
    return np.clip(np.asarray(found, dtype=np.float32), 0, 1)


def _reduced(picture: NDArray[np.uint8], every: int) -> NDArray[np.uint8]:
    """Return means of blocks; the last block of a row or column may be smaller."""
    if every == 1:
        return np.ascontiguousarray(picture)
    rows, cols = (np.arange(0, n, every) for n in picture.shape[:2])
    total = np.add.reduceat(np.add.reduceat(picture, rows, axis=0, dtype=np.uint32), cols, axis=1)
    count = np.diff([*rows, picture.shape[0]])[:, None] * np.diff([*cols, picture.shape[1]])[None]
    return np.ascontiguousarray(np.rint(total / count[..., None]).astype(np.uint8))


def person_finder() -> Callable[[NDArray[np.uint8]], NDArray[np.float32] | None] | None:
    """Return `person_probability`, or None where MediaPipe is not installed."""
    return person_probability if find_spec("mediapipe") is not None else None
