"""Draw a photo through an inverse map."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from facewright.errors import ValueRangeError
from facewright.imaging._warp_kernels import places
from facewright.imaging.resample import resample
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
    return warp_part(photo, np.ascontiguousarray(displacement, dtype=np.float32), origin)[0]


def warp_part(
    photo: NDArray[np.uint8], displacement: NDArray[np.float32], origin: tuple[int, int]
) -> tuple[NDArray[np.uint8], NDArray[np.bool_]]:
    """Return what `warp_picture` does, without its checks, and which pixels of the part do not stay, (h, w)."""
    (x, y), (h, w) = origin, displacement.shape[:2]
    part = np.ascontiguousarray(photo[y : y + h, x : x + w]).copy()
    to_x, to_y, moved = places(displacement, origin)
    resample(photo, to_x, to_y, where=moved, out=part)
    return part, moved
