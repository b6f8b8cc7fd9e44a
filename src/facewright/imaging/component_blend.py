"""Set a component of an aligned picture into a warped one: light, seam, gradients."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from facewright.errors import DegenerateError
from facewright.imaging.alignment_flow import AlignedPicture
from facewright.imaging.colour import linear_from_srgb, srgb_from_linear
from facewright.imaging.gradient_blend import blend_gradients
from facewright.imaging.seam import find_seam
from facewright.numeric.check import check_shape

_SEEN = 0.5  # of `AlignedPicture.seen`: what counts as shown
_FLOOR = 0.03  # added to linear light before logarithms: the noise of dark pixels must not count
_LIGHT_MM = 12.0  # over this distance light is taken to vary; what varies faster is the face
_LARGEST = np.log(3.0)  # of the light's variation about its mean
_DECAY_MM = 5.0  # over this distance from the seam what the pictures differ by there dies out
_PINHOLE_MM = 4.0  # a hole of less than a square of this side is filled
_COARSE = 6.0  # pixels that stand for `_LIGHT_MM` where light is compared


@dataclass(frozen=True, eq=False)
class ComponentBlend:
    """A picture with a component of another.

    Parameters
    ----------
    image : ndarray of shape (H, W, 3), uint8
        The picture; outside `mask` the warped one to the last bit.
    mask : ndarray of shape (H, W), bool
        Pixels that come from the aligned picture.
    seen_share : float
        Share of the component that the aligned picture shows.
    """

    image: NDArray[np.uint8]
    mask: NDArray[np.bool_]
    seen_share: float


def blend_component(
    warped: NDArray[np.uint8],
    aligned: AlignedPicture,
    level: NDArray[np.floating],
    skin: NDArray[np.bool_],
) -> ComponentBlend:
    """Replace a component of one picture by that of another that shows the same view.

    Parameters
    ----------
    warped : ndarray of shape (H, W, 3), uint8
        Picture to change, the expression's flow applied.
    aligned : AlignedPicture
        Picture that shows the component, the alignment's flow applied.
    level : ndarray of shape (H, W)
        From `facewright.imaging.component_mask.component_pixels`: 1 and more is replaced, the seam runs between 1
        and 0.
    skin : ndarray of shape (H, W), bool
        Pixels of the face's skin away from its outline: where light is compared.

    Returns
    -------
    ComponentBlend
        The picture.

    Raises
    ------
    ShapeError
        If sizes differ.
    DegenerateError
        If the view does not show the component.

    Notes
    -----
    Everything is done on logarithms of linear light, where light is a term that skin, lips and teeth share. First the
    component gets the target's light, colour and slow variation: the mean ratio of the two pictures of the same skin
    over some 12 mm. Then comes the seam; last the gradient-domain blend, whose correction meets the target at the seam
    and dies out within a few millimetres, so that a fold that only one picture has at the seam does not tint the lips.
    """
    sizes = check_shape("warped", warped, "H", "W", 3)
    check_shape("level", level, "H", "W", **sizes)
    check_shape("skin", skin, "H", "W", **sizes)
    shown = aligned.seen >= _SEEN
    inner, outer = level >= 1.0, (level > 0.0) & shown
    if not inner.any():
        raise DegenerateError("the target must show the component, got a view that hides it.")
    share = float((inner & shown).sum() / inner.sum())
    if not (outer & inner).any():
        return ComponentBlend(warped.copy(), np.zeros(level.shape, bool), 0.0)
    target, source = _log_light(warped), _log_light(aligned.image)
    source += _light_difference(target - source, skin & shown, aligned.pixels_per_mm)
    mask = find_seam(_picture(target), _picture(source), inner & shown, outer)
    mask = _without_pinholes(mask, aligned.pixels_per_mm)
    image = warped.copy()
    correction = blend_gradients(target, source, mask)[mask] - source[mask]
    depth = ndimage.distance_transform_edt(mask)[mask] / (_DECAY_MM * aligned.pixels_per_mm)
    image[mask] = _picture(source[mask] + np.exp(-(depth**2))[:, None] * correction)
    return ComponentBlend(image, mask, share)


def _without_pinholes(mask: NDArray[np.bool_], pixels_per_mm: float) -> NDArray[np.bool_]:
    """Return the mask with its small holes filled; large ones stay, such as a nostril that one picture hides.

    Pixels left to the warped picture within the component would bleed into what is around them.
    """
    labels, count = ndimage.label(ndimage.binary_fill_holes(mask) & ~mask)
    area = ndimage.sum_labels(labels > 0, labels, np.arange(1, count + 1))
    small = np.concatenate([[False], area <= (_PINHOLE_MM * pixels_per_mm) ** 2])
    return np.asarray(mask | small[labels])


def _light_difference(
    ratio: NDArray[np.float32], where: NDArray[np.bool_], pixels_per_mm: float
) -> NDArray[np.float32]:
    """Return the slowly varying part (H, W, 3) of a log ratio of two pictures, known where both show the same skin."""
    if not where.any():
        return np.zeros_like(ratio)
    middle = np.median(ratio[where], axis=0)
    step = max(1, round(_LIGHT_MM * pixels_per_mm / _COARSE))
    apart = np.clip(ratio - middle, -_LARGEST, _LARGEST)
    # brows, wrinkles and shadows of lips that only one of the pictures has are left out
    luma = apart.mean(axis=2)
    spread = 1.4826 * np.median(np.abs(luma[where])) + 0.02
    weight = np.where(where, np.clip(1.0 - (luma / (4.0 * spread)) ** 2, 0.0, None) ** 2, 0.0)
    total = _block_means(apart * weight[..., None], step)
    mass = _block_means(weight[..., None], step)
    sigma = (_COARSE, _COARSE, 0.0)
    smooth = ndimage.gaussian_filter(total, sigma) / (ndimage.gaussian_filter(mass, sigma) + 0.01)
    grid = [(np.arange(n, dtype=np.float32) + 0.5) / step - 0.5 for n in ratio.shape[:2]]
    at = np.meshgrid(*grid, indexing="ij")
    field = [ndimage.map_coordinates(c, at, order=1, mode="nearest") for c in np.moveaxis(smooth, 2, 0)]
    return np.asarray(np.stack(field, axis=-1) + middle, dtype=np.float32)


def _block_means(values: NDArray[np.floating], step: int) -> NDArray[np.float32]:
    """Return means (h, w, C) over blocks of `step` pixels; zeros count beyond the border."""
    height, width, channels = values.shape
    padded = np.pad(values, ((0, -height % step), (0, -width % step), (0, 0)))
    blocks = padded.reshape(padded.shape[0] // step, step, padded.shape[1] // step, step, channels)
    return np.asarray(blocks.mean(axis=(1, 3)), dtype=np.float32)


def _log_light(image: NDArray[np.uint8]) -> NDArray[np.float32]:
    return np.log(linear_from_srgb(image.astype(np.float32) / 255.0) + _FLOOR)


def _picture(log_light: NDArray[np.floating]) -> NDArray[np.uint8]:
    return np.rint(srgb_from_linear(np.exp(log_light) - _FLOOR) * 255.0).astype(np.uint8)
