"""Set a component of an aligned picture into a warped one: light, seam, gradients."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from facewright.errors import DegenerateError
from facewright.imaging.alignment_flow import AlignedPicture
from facewright.imaging.colour import linear_from_srgb, srgb_from_linear
from facewright.imaging.detail_match import limit_contrast, match_grain
from facewright.imaging.gradient_blend import blend_gradients
from facewright.imaging.seam import find_seam
from facewright.numeric.check import check_shape

_SEEN = 0.5  # of `AlignedPicture.seen`: what counts as shown
_FLOOR = 0.03  # added to linear light before logarithms: the noise of dark pixels must not count
_LIGHT_MM = 12.0  # over this distance light is taken to vary; what varies faster is the face
_RELIGHT = 2  # times: the floor makes the first difference of light too small where it is dark
_LARGEST = np.log(3.0)  # of the light's variation about its mean
_DECAY_MM = 5.0  # over this distance from the seam what the pictures differ by there dies out
_FEATHER_MM = 4.0  # over this distance from the seam the two pictures are mixed: folds that it cuts fade
_HAIR_MM = 12.0  # twice the width of a brow: coarser differences are light
# Skin that is turned further away than this wears its outline's own light, less so next to features.
_OUTLINE, _FEATURES_OUTLINE, _FEATURES = 0.55, 0.35, 1.5
_TEETH = (-0.7, -0.1)  # log of light relative to the skin's, between which what is seen in an opening loses its tint
_TINT_SPAN = 0.7  # difference in log light over which colour is taken to change with lightness
_TINT_MM = 1.0  # colours of the target are taken over with this blur
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
    *,
    openings: NDArray[np.bool_] | None = None,
    brows: NDArray[np.floating] | None = None,
    away_from_outline: bool = False,
    colourless: bool = False,
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
        Pixels of the face's skin away from its outline: where light and grain are compared.
    openings : ndarray of shape (H, W), bool, optional
        Pixels between lips or lids; none where absent.
    brows : ndarray of shape (H, W), optional
        Level of the brows, whose contrast is limited; nothing is where absent.
    away_from_outline : bool
        Leave out skin that either picture shows turned away: rim light and beard line of a jaw.
    colourless : bool
        The aligned picture has no colours: it takes the warped one's, teeth become neutral.

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
    over some 12 mm; then its grain. Then comes the seam; last the gradient-domain blend, whose correction meets the
    target at the seam and dies out within a few millimetres, so that a fold that only one picture has at the seam does
    not tint the lips, and a mixture across the seam's band, so that such a fold fades.
    """
    sizes = check_shape("warped", warped, "H", "W", 3)
    check_shape("level", level, "H", "W", **sizes)
    check_shape("skin", skin, "H", "W", **sizes)
    openings = np.zeros(level.shape, bool) if openings is None else openings
    check_shape("openings", openings, "H", "W", **sizes)
    shown = aligned.seen >= _SEEN
    inner = level >= 1.0
    if not inner.any():
        raise DegenerateError("the target must show the component, got a view that hides it.")
    share = float((inner & shown).sum() / inner.sum())
    if away_from_outline:
        shown &= _away_from_outline(aligned, level) | openings
    outer = (level > 0.0) & shown
    if not (outer & inner).any():
        return ComponentBlend(warped.copy(), np.zeros(level.shape, bool), 0.0)
    target, source = _log_light(warped), _log_light(aligned.image)
    for _ in range(_RELIGHT):
        light = _light_difference(target - source, skin & shown, aligned.pixels_per_mm)
        source = _relit(source, light.mean(axis=2, keepdims=True) if colourless else light)
    if colourless:
        source += _tint(source, target, openings, skin & shown, aligned.pixels_per_mm)
    source = match_grain(source, target, skin & shown)
    if brows is not None:
        weight = np.where(shown, np.clip(brows, 0.0, 1.0), 0.0)
        source = limit_contrast(source, target, weight, _HAIR_MM * aligned.pixels_per_mm)
    # the seam leaves room to fade between itself and the core
    core = ndimage.binary_dilation(inner & shown, iterations=max(1, round(0.5 * _FEATHER_MM * aligned.pixels_per_mm)))
    mask = find_seam(_picture(target), _picture(source), core & outer, outer)
    mask = _without_pinholes(mask, aligned.pixels_per_mm)
    image = warped.copy()
    correction = blend_gradients(target, source, mask)[mask] - source[mask]
    depth = ndimage.distance_transform_edt(mask)[mask] / (_DECAY_MM * aligned.pixels_per_mm)
    result = _relit(source[mask], np.exp(-(depth**2))[:, None] * correction)
    part = _feather(mask, inner, _FEATHER_MM * aligned.pixels_per_mm)[mask][:, None]
    image[mask] = _picture(target[mask] + part * (result - target[mask]))
    return ComponentBlend(image, mask, share)


def _away_from_outline(aligned: AlignedPicture, level: NDArray[np.floating]) -> NDArray[np.bool_]:
    """Tell which pixels lie away from the face's outline in both pictures; steep sides of a nose are inside it."""
    steep = np.where(level >= _FEATURES, _FEATURES_OUTLINE, _OUTLINE)
    flat = ndimage.gaussian_filter(aligned.facing, aligned.pixels_per_mm) >= steep
    return np.asarray(ndimage.binary_fill_holes(flat))


def _feather(mask: NDArray[np.bool_], inner: NDArray[np.bool_], width: float) -> NDArray[np.float32]:
    """Return the share (H, W) of the region's picture: 0 at the seam, 1 where the component must come as a whole.

    Beside what the mask leaves out of the component's core it rises over `width` pixels as well.
    """
    depth = ndimage.distance_transform_edt(mask)
    to_inner = ndimage.distance_transform_edt(~(inner & mask))
    share = np.clip(depth / np.maximum(np.minimum(depth + to_inner, width), 1.0), 0.0, 1.0)
    hole = inner & ~mask
    if hole.any():
        share = np.minimum(share, np.clip(ndimage.distance_transform_edt(~hole) / max(width, 1.0), 0.0, 1.0))
    return np.asarray(share * share * (3.0 - 2.0 * share), dtype=np.float32)


def _tint(
    source: NDArray[np.float32],
    target: NDArray[np.float32],
    openings: NDArray[np.bool_],
    skin: NDArray[np.bool_],
    pixels_per_mm: float,
) -> NDArray[np.float32]:
    """Return the colour (H, W, 3) of the target without its lightness, as it is at the source's lightness.

    What is bright in an opening, teeth and the white of eyes, gives no colour away and gets none.
    """
    sigma = (_TINT_MM * pixels_per_mm, _TINT_MM * pixels_per_mm, 0.0)
    luma = target.mean(axis=2, keepdims=True)
    level = float(np.median(luma[skin])) if skin.any() else 0.0
    near = ndimage.gaussian_filter(ndimage.binary_dilation(openings, iterations=2).astype(np.float32), sigma[0])
    known = 1.0 - np.minimum(2.0 * near, 1.0) * _bright(luma[..., 0] - level) + 1e-3
    colour = ndimage.gaussian_filter((target - luma) * known[..., None], sigma)
    colour /= ndimage.gaussian_filter(known, sigma[:2])[..., None]
    if skin.sum() > 1:  # highlights are paler than skin, folds redder: not all of them are where the source has them
        apart = luma[skin] - luma[skin].mean()
        slope = (apart * (target - luma)[skin]).sum(axis=0) / max(float((apart**2).sum()), 1e-9)
        change = source.mean(axis=2, keepdims=True) - ndimage.gaussian_filter(luma, sigma)
        colour += slope * np.clip(change, -_TINT_SPAN, _TINT_SPAN)
    near = ndimage.gaussian_filter(openings.astype(np.float32), 0.5 * sigma[0])
    colour *= (1.0 - near * _bright(source.mean(axis=2) - level))[..., None]
    return np.asarray(colour, dtype=np.float32)


def _bright(above_skin: NDArray[np.floating]) -> NDArray[np.floating]:
    """Return how sure it is that what an opening shows is teeth or the white of an eye, from log light over skin's."""
    low, high = _TEETH
    return np.asarray(np.clip((above_skin - low) / (high - low), 0.0, 1.0))


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


def _relit(log_light: NDArray[np.float32], change: NDArray[np.floating]) -> NDArray[np.float32]:
    """Return logarithms of light multiplied by exp(change): without the floor, so that dark hair does not go black."""
    light = np.maximum(np.exp(log_light) - _FLOOR, 0.0)
    return np.asarray(np.log(light * np.exp(change) + _FLOOR), dtype=np.float32)


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
