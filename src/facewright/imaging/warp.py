"""Draw a photo through an inverse map."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from facewright.numeric.check import check_shape


def warp_picture(photo: NDArray[np.uint8], displacement: NDArray[np.floating]) -> NDArray[np.uint8]:
    """Return the picture whose pixel p is the photo's at p + displacement(p), bicubic.

    Parameters
    ----------
    photo : ndarray of shape (H, W, 3), uint8
    displacement : ndarray of shape (H, W, 2), pixels
        From `displacement_field`; pixels where it is exactly zero keep their bits.
    """
    sizes = check_shape("photo", photo, "H", "W", 3)
    check_shape("displacement", displacement, "H", "W", 2, **sizes)
    moved = (displacement != 0).any(axis=2)
    result = photo.copy()
    if moved.any():
        ys, xs = np.nonzero(moved)
        at = np.stack([ys + displacement[ys, xs, 1], xs + displacement[ys, xs, 0]])
        for k in range(3):
            values = ndimage.map_coordinates(photo[..., k].astype(np.float32), at, order=3, mode="nearest")
            result[ys, xs, k] = np.clip(np.round(values), 0, 255).astype(np.uint8)
    return result


def smallest_jacobian(displacement: NDArray[np.floating], outside: NDArray[np.bool_] | None = None) -> float:
    """Return the smallest determinant of the map p + displacement(p) over pixel cells, but those of `outside`."""
    d = np.asarray(displacement, dtype=np.float64)
    dx, dy = np.diff(d, axis=1)[:-1], np.diff(d, axis=0)[:, :-1]
    determinant = (1 + dx[..., 0]) * (1 + dy[..., 1]) - dx[..., 1] * dy[..., 0]
    if outside is not None:
        determinant = determinant[~outside[:-1, :-1]]
    return float(determinant.min()) if determinant.size else 1.0
