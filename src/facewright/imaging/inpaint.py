"""Fill pixels that no photo shows from their surroundings: smooth colour, and the grain of what lies around."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import distance_transform_edt, gaussian_filter

from facewright.errors import DegenerateError, ValueRangeError
from facewright.imaging.poisson import mask_box, solve_poisson
from facewright.numeric.check import check_finite, check_shape

#: Pixels that part smooth colour from grain: standard deviation of the Gaussian between them, per pixel of the hole's
#: half width, and its limits.
_SMOOTHING, _SMOOTHING_LIMITS = 0.25, (1.0, 3.0)

#: Grain stronger than this many times the typical one about it is an outline.
_OUTLINE = 2.0


def inpaint(image: NDArray[Any], hole: NDArray[np.bool_], *, grain: float = 1.0) -> NDArray[Any]:
    """Fill a hole of a picture so that it looks like what lies around it.

    Parameters
    ----------
    image : ndarray of shape (H, W, 3), uint8 or float32
        Picture; what it holds inside the hole is not read.
    hole : ndarray of shape (H, W), bool
        Pixels to fill; any number of separate pieces.
    grain : float
        Share of the surroundings' fine texture that the filling gets; 0 is smooth, which does not flicker in videos
        whose hole moves.

    Returns
    -------
    ndarray of shape (H, W, 3), of the picture's type
        The picture, to the last bit outside the hole. uint8 is rounded and clipped.

    Raises
    ------
    ShapeError, ValueRangeError
        If shapes do not match, the type is neither uint8 nor a float, known pixels are not finite, or `grain` is not in
        [0, 1].
    DegenerateError
        If no pixel is known.

    Notes
    -----
    The colour is a membrane (`facewright.imaging.poisson`) through the smoothed pixels around the hole. The grain, what
    the smoothing took from the known pixels, is mirrored at the hole's border: it meets the border without a step and
    keeps the look of pores, hair or cloth. Large holes in what has structure (an eye, letters) become a blur with that
    grain: this fills gaps and invents nothing.
    """
    sizes = check_shape("image", image, "H", "W", 3)
    check_shape("hole", hole, "H", "W", **sizes)
    if image.dtype != np.uint8 and image.dtype.kind != "f":
        raise ValueRangeError(f"image must be uint8 or float, got {image.dtype}.")
    if not 0.0 <= grain <= 1.0:
        raise ValueRangeError(f"grain must lie in [0, 1], got {grain}.")
    missing = np.asarray(hole, dtype=np.bool_)
    out = np.array(image)
    if not missing.any():
        return out
    if missing.all():
        raise DegenerateError("hole must leave pixels to fill it from, got a hole as large as the picture.")
    deepest = float(distance_transform_edt(np.pad(missing[mask_box(missing)], 1)).max())
    sigma = float(np.clip(_SMOOTHING * deepest, *_SMOOTHING_LIMITS))
    box = _with_margin(missing, int(np.ceil(2 * deepest + 4 * sigma)))
    missing = missing[box]
    part = np.where(missing[..., None], 0, image[box]).astype(np.float32)
    check_finite("image", part)
    smooth = _smooth_known(part, ~missing, sigma)
    filled = solve_poisson(smooth, missing, tolerance=1e-3)[missing]
    if grain > 0:
        filled += np.float32(grain) * _mirrored(_without_outlines(part - smooth, ~missing, 4 * sigma), missing)
    if image.dtype == np.uint8:
        filled = np.clip(np.rint(filled), 0, 255)
    out[box][missing] = filled.astype(image.dtype)
    return out


def _with_margin(mask: NDArray[np.bool_], margin: int) -> tuple[slice, slice]:
    """Return the mask's bounding box, grown by `margin` within the picture."""
    rows, columns = mask_box(mask)
    return (
        slice(max(rows.start - margin, 0), min(rows.stop + margin, mask.shape[0])),
        slice(max(columns.start - margin, 0), min(columns.stop + margin, mask.shape[1])),
    )


def _smooth_known(part: NDArray[np.float32], known: NDArray[np.bool_], sigma: float) -> NDArray[np.float32]:
    """Smooth the known pixels among themselves."""
    weight = gaussian_filter(known.astype(np.float32), sigma)
    total = gaussian_filter(part, (sigma, sigma, 0))
    return np.asarray(total / np.maximum(weight, np.float32(1e-6))[..., None], dtype=np.float32)


def _without_outlines(detail: NDArray[np.float32], known: NDArray[np.bool_], sigma: float) -> NDArray[np.float32]:
    """Cut what is stronger than the texture about it: mirrored outlines would look like petals round the hole."""
    # the mean of square roots hardly minds the few pixels of an outline
    typical = _smooth_known(np.sqrt(np.abs(detail)) * known[..., None], known, sigma) ** 2
    limit = _OUTLINE * typical
    return np.clip(detail, -limit, limit)


def _mirrored(grain: NDArray[np.float32], missing: NDArray[np.bool_]) -> NDArray[np.float32]:
    """Return the grain of known pixels mirrored at the hole's border, for the pixels of the hole, (N, 3)."""
    nearest = distance_transform_edt(missing, return_distances=False, return_indices=True)
    y, x = np.nonzero(missing)
    border_y, border_x = nearest[0][missing], nearest[1][missing]
    reach_y, reach_x = border_y - y, border_x - x
    out = np.zeros((len(y), 3), np.float32)
    todo = np.ones(len(y), np.bool_)
    # where the mirrored place is unknown too (thin bridges, the picture's border), one nearer to the border is taken
    for share in (1.0, 0.6, 0.3, 0.0):
        from_y = np.rint(border_y + share * reach_y).astype(np.int64)
        from_x = np.rint(border_x + share * reach_x).astype(np.int64)
        height, width = missing.shape
        within = todo & (from_y >= 0) & (from_y < height) & (from_x >= 0) & (from_x < width)
        within[within] = ~missing[from_y[within], from_x[within]]
        out[within] = grain[from_y[within], from_x[within]]
        todo &= ~within
    return out
