"""Draw a photo through an inverse map."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from facewright.errors import ValueRangeError
from facewright.imaging.resample import resample_displaced
from facewright.numeric.check import check_finite, check_shape


def warp_picture(
    photo: NDArray[np.uint8], displacement: NDArray[np.floating], origin: tuple[int, int] = (0, 0)
) -> NDArray[np.uint8]:
    """Return the part of a picture whose pixel p is the photo's at p + displacement(p), bicubic.

    Parameters
    ----------
    photo : ndarray of shape (H, W, 3), uint8
        The photo.
    displacement : ndarray of shape (h, w, 2), pixels
        From `displacement_field`; pixels where it is exactly zero keep their bits.
    origin : (x, y)
        Where the part begins in the picture.

    Returns
    -------
    ndarray of shape (h, w, 3), uint8
        The part. Beyond the photo's border its border's pixels go on.

    Raises
    ------
    ShapeError, ValueRangeError
        If arrays do not match, the part leaves the photo, or a displacement is not finite.
    """
    sizes = check_shape("photo", photo, "H", "W", 3)
    found = check_shape("displacement", displacement, "h", "w", 2)
    check_finite("displacement", displacement)
    (x, y), h, w = origin, found["h"], found["w"]
    if x < 0 or y < 0 or x + w > sizes["W"] or y + h > sizes["H"]:
        raise ValueRangeError(
            f"the part must lie in the photo of {sizes['W']} x {sizes['H']} pixels, got {w} x {h} pixels at ({x}, {y})."
        )
    return resample_displaced(photo, displacement, origin)[0]
