"""Put a region of one picture into another without a seam: keep its gradients, take the level from around it."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from facewright.errors import ValueRangeError
from facewright.imaging.poisson import mask_box, solve_poisson
from facewright.numeric.check import check_shape


def blend_gradients(
    target: NDArray[Any],
    source: NDArray[Any],
    mask: NDArray[np.bool_],
    *,
    mixed: bool = False,
    free: NDArray[np.bool_] | None = None,
) -> NDArray[Any]:
    """Replace the pixels of a mask by those of `source`, shifted smoothly so that they meet `target` around the mask.

    Parameters
    ----------
    target : ndarray of shape (H, W, 3), uint8 or float32
        Picture to change.
    source : ndarray of shape (H, W, 3), of the target's type
        Picture that gives the gradients, aligned with `target`. It is read inside the mask and one pixel around it.
    mask : ndarray of shape (H, W), bool
        Pixels to replace.
    mixed : bool
        Take, between each two neighbours, the stronger of the two pictures' gradients rather than the source's: keeps
        the target's texture (stubble, freckles, hair) where the source is smoother.
    free : ndarray of shape (H, W), bool, optional
        Pixels around the mask that the region shall not be made to meet, such as hair or a hand before the face in one
        of the pictures.

    Returns
    -------
    ndarray of shape (H, W, 3), of the target's type
        The target to the last bit outside the mask; inside, the source plus a correction. uint8 is rounded and clipped.

    Raises
    ------
    ShapeError
        If the pictures and masks do not match.
    ValueRangeError
        If the pictures are of different types, or of another type than uint8 and floats.
    DegenerateError
        If no pixel around the mask holds the region's level: the mask covers the whole picture.

    Notes
    -----
    [1]_, eq. (10) to (13): the correction is the membrane (each pixel the mean of its neighbours) through the
    difference of the pictures around the mask; where the mask ends at the picture's border, it ends freely. It is added
    to sRGB values: they go with the ratio of light more than with its difference, as shading does.

    References
    ----------
    .. [1] Perez, Gangnet, Blake, Poisson image editing, SIGGRAPH 2003, doi:10.1145/882262.882269.
    """
    sizes = check_shape("target", target, "H", "W", 3)
    check_shape("source", source, "H", "W", 3, **sizes)
    check_shape("mask", mask, "H", "W", **sizes)
    if free is not None:
        check_shape("free", free, "H", "W", **sizes)
    if target.dtype != source.dtype or (target.dtype != np.uint8 and target.dtype.kind != "f"):
        raise ValueRangeError(
            f"target and source must both be uint8 or both floats, got {target.dtype} and {source.dtype}."
        )
    out = np.array(target)
    inside = np.asarray(mask, dtype=np.bool_)
    if not inside.any():
        return out
    box = mask_box(inside)
    inside, around, region = inside[box], target[box].astype(np.float32), source[box].astype(np.float32)
    correction = solve_poisson(
        around - region,
        inside,
        source=_stronger_gradients(around, region) if mixed else None,
        free=None if free is None else np.asarray(free, dtype=np.bool_)[box],
    )
    blended = region[inside] + correction[inside]
    if target.dtype == np.uint8:
        blended = np.clip(np.rint(blended), 0, 255)
    out[box][inside] = blended.astype(target.dtype)
    return out


def _stronger_gradients(target: NDArray[np.float32], source: NDArray[np.float32]) -> NDArray[np.float32]:
    """Return, per pixel, what the target's gradients add to the source's where they are stronger, (H, W, 3)."""
    total = np.zeros_like(target)
    for axis in (0, 1):
        theirs, ours = np.diff(target, axis=axis), np.diff(source, axis=axis)
        # all channels from one picture: single channels would make coloured edges
        stronger = (theirs**2).sum(axis=2) > (ours**2).sum(axis=2)
        more = np.where(stronger[..., None], theirs - ours, np.float32(0))
        # Eq. (13) with (11): each step pulls its two ends apart
        ahead, behind = [slice(None)] * 2, [slice(None)] * 2
        ahead[axis], behind[axis] = slice(1, None), slice(None, -1)
        total[tuple(ahead)] += more
        total[tuple(behind)] -= more
    return total
