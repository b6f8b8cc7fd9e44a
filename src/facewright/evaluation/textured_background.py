"""A wall behind simulated people, with texture of every size, so that a warp of the background is seen."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage


def textured_background(
    tone: tuple[int, int, int], size: tuple[int, int], rng: np.random.Generator
) -> NDArray[np.uint8]:
    """Return a picture (height, width, 3) of patches of several sizes, stripes and a few straight edges.

    Parameters
    ----------
    tone : sRGB colour
        Its mean colour.
    size : (height, width)
        Pixels.
    rng : numpy.random.Generator
        Source of randomness.
    """
    height, width = size
    picture = np.broadcast_to(np.asarray(tone, dtype=np.float64), (height, width, 3)).copy()
    for extent, strength in ((40.0, 20.0), (8.0, 8.0), (1.5, 3.0)):
        patches = ndimage.gaussian_filter(rng.standard_normal((height, width)), extent)
        picture += strength * (patches / patches.std())[..., None]
    y, x = np.mgrid[:height, :width] / height
    picture += 8.0 * np.sign(np.sin(2 * np.pi * rng.uniform(8, 14) * (x + rng.uniform(-0.3, 0.3) * y)))[..., None]
    for column in rng.integers(0, width, 4):
        picture[:, column:] += rng.uniform(-20, 20)
    return np.clip(np.rint(picture), 0, 255).astype(np.uint8)
