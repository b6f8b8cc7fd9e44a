"""The photo's lips and lids without what shows between them."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from facewright.imaging.wide_blur import wide_blur


def skin_layer(
    photo: NDArray[np.uint8],
    inside: NDArray[np.bool_],
    *,
    inset_px: float,
    doubt_px: float,
    wanted: NDArray[np.bool_] | None = None,
) -> NDArray[np.float32]:
    """Replace what a photo shows inside mouth or eye by the skin round it going on inwards.

    Parameters
    ----------
    photo : ndarray of shape (h, w, 3), uint8
        The photo round an opening.
    inside : ndarray of shape (h, w), bool
        Pixels that show something else than skin, by the fitted mesh.
    inset_px : float
        So much of the skin's edge is always replaced: the fit and the lens are not sharper.
    doubt_px : float
        Up to so far from the opening a pixel is replaced if it does not look like the skin beyond: an error of the fit
        leaves teeth, eye or lashes there.
    wanted : ndarray of shape (h, w), bool, optional
        Skin that may be continued (for example lips only); any where absent.

    Returns
    -------
    ndarray of shape (h, w, 3), float32
        sRGB in [0, 255].
    """
    values = photo.astype(np.float32)
    if not inside.any():
        return values
    away = ndimage.distance_transform_edt(~inside)
    out = away <= inset_px
    band = (away > inset_px) & (away <= doubt_px)
    beyond = (away > doubt_px) & (away <= 2.0 * doubt_px + 2.0)
    if wanted is not None and (beyond & wanted).sum() > 20:
        beyond &= wanted
    if band.any() and beyond.sum() > 20:
        out |= band & _foreign(values, band, beyond)
        # no skin is an island in what was replaced, and nothing foreign one in skin
        out = ndimage.binary_closing(out, iterations=1) | (away <= inset_px)
        pieces, _ = ndimage.label(out)
        touching = np.unique(pieces[away <= inset_px])
        out = np.isin(pieces, touching[touching > 0])
    source = ~out if wanted is None or not (wanted & ~out).any() else wanted & ~out
    # what is above an opening goes on downwards, what is below it upwards
    rows = np.arange(out.shape[0], dtype=np.float64)[:, None]
    count = out.sum(axis=0)
    filled = np.flatnonzero(count)
    middle = np.interp(np.arange(out.shape[1]), filled, (rows * out).sum(axis=0)[filled] / count[filled])
    above, below = source & (rows < middle), source & (rows >= middle)
    upper = _continued(values, above if above.any() else source, out)
    lower = _continued(values, below if below.any() else source, out)
    side = np.clip(rows - middle + 0.5, 0, 1)[out][:, None].astype(np.float32)
    values[out] = upper + (lower - upper) * side
    return np.ascontiguousarray(values)


def _continued(values: NDArray[np.float32], known: NDArray[np.bool_], wanted: NDArray[np.bool_]) -> NDArray[np.float32]:
    """Continue the known pixels to the N wanted ones, (N, 3): near by their nearest, farther away ever smoother."""
    distance, nearest = ndimage.distance_transform_edt(~known, return_indices=True)
    result = ndimage.gaussian_filter(values[tuple(nearest)], (0.8, 0.8, 0))[wanted]
    away = distance[wanted].astype(np.float32)[:, None]
    weight = known.astype(np.float32)
    weighted = values * weight[..., None]
    sigma = 2.0
    while sigma < away.max():
        mass = wide_blur(weight, sigma, truncate=5.0)[wanted][:, None]
        mean = wide_blur(weighted, sigma, truncate=5.0)[wanted]
        share = np.where(mass > 1e-4, np.clip((away / sigma - 0.5) / 0.7, 0, 1), 0.0)
        result += share * (mean / np.maximum(mass, 1e-4) - result)
        sigma *= 1.6
    return np.asarray(result, np.float32)


def _foreign(values: NDArray[np.float32], band: NDArray[np.bool_], beyond: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Tell which pixels of the band do not look like the nearest skin beyond it."""
    nearest = ndimage.distance_transform_edt(~beyond, return_distances=False, return_indices=True)
    smooth = ndimage.gaussian_filter(values, (1.0, 1.0, 0))
    reference = smooth[tuple(nearest)]

    def features(colour: NDArray[np.float32]) -> NDArray[np.float32]:
        total = colour.sum(axis=-1) + 12.0
        return np.stack([np.log(total), 4.0 * colour[..., 0] / total, 4.0 * colour[..., 2] / total], axis=-1)

    off = np.abs(features(values) - features(reference))
    inner = features(values)[beyond] - features(ndimage.gaussian_filter(values, (2.0, 2.0, 0)))[beyond]
    spread = np.maximum(1.4826 * np.median(np.abs(inner), axis=0), [0.05, 0.04, 0.04])
    return np.asarray(((off / (4.0 * spread)) ** 2).sum(axis=-1) > 1.0) & band
