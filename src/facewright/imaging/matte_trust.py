"""Along which stretches of a person's outline the matte can be trusted, so that what lies behind may stay there."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from facewright.imaging.blocks import masked_means

# all as shares of the head's size
_BAND = 0.05  # so near the outline colours must tell both sides
_LOCAL = 0.05  # over which they are averaged
_WRONG = (0.26, 0.42)  # mean chance of the wrong side by colour: all trust, none
_CORE = 0.025  # the finder may be soft so near the outline
_SOFT = (0.12, 0.88)  # and beyond there must not say anything between
_AGAINST = (0.3, 0.6)  # and must not be below this in the person, or above that beside them
_OVER = 0.018  # the fitted head may reach so far beyond the person
_CLOTHES, _FROM = 0.035, -0.42  # what is so far from the head's mesh, from so far below the chin, is neck or clothes
_RAGGED = (1.18, 1.5)  # length of the outline beside a smoothed one's: all trust, none
_SMOOTHED, _STRETCH = 0.02, 0.035  # so far it is smoothed; over so much lengths are compared
_FINE = 400  # pixels that the head has, at most, where they are
_CLEAR, _RAMP = 0.03, 0.07  # no trust so near a doubtful place, rising over


def matte_trust(
    person: NDArray[np.float32],
    colour: NDArray[np.floating],
    found: NDArray[np.floating] | None,
    head: NDArray[np.bool_],
    below: NDArray[np.floating],
    size: float,
) -> NDArray[np.float32]:
    """Return how far the matte is to be trusted around each pixel: along a stretch of the outline, and beside it.

    It is not where colours near the outline do not tell the sides (textured hair before dark things), where the finder
    is in doubt away from its own edge, where the fitted head reaches beyond the person, and at neck and clothes, which
    do not move as the head does.

    Parameters
    ----------
    person : ndarray of shape (h, w)
        The person's share.
    colour : ndarray of shape (h, w)
        Logarithm of how much likelier the person has a pixel's colour than what lies behind.
    found : ndarray of shape (h, w), optional
        The finder's probability.
    head : ndarray of shape (h, w), bool
        What the fitted head without the neck covers.
    below : ndarray of shape (h, w)
        How far a pixel lies below the chin, pixels.
    size : float
        Of the head, pixels.

    Returns
    -------
    ndarray of shape (h, w), float32, in [0, 1]
    """
    inside = person > 0.5
    if inside.all() or not inside.any():
        return np.zeros(person.shape, np.float32)
    away = np.where(inside, ndimage.distance_transform_edt(inside), ndimage.distance_transform_edt(~inside)) / size
    band = away < max(_BAND, 2 / size)
    wrong = 1 / (1 + np.exp(np.where(inside, 1.0, -1.0) * colour))
    sigma = _LOCAL * size
    weight = ndimage.gaussian_filter(band.astype(float), sigma)
    mean = ndimage.gaussian_filter(np.where(band, wrong, 0.0), sigma) / np.maximum(weight, 1e-6)
    good = 1 - _smooth((mean - _WRONG[0]) / (_WRONG[1] - _WRONG[0]))
    nearest = ndimage.distance_transform_edt(~band, return_distances=False, return_indices=True)
    good = ndimage.gaussian_filter(good[tuple(nearest)], 0.8 * sigma)
    doubtful = _doubtful(inside, away, found, head, below, size)
    if doubtful.any():
        clear = ndimage.distance_transform_edt(~doubtful) / size
        good = np.minimum(good, _smooth((clear - _CLEAR) / _RAMP))
    return np.asarray(np.clip(ndimage.gaussian_filter(good, 0.015 * size), 0, 1), dtype=np.float32)


def smoothness(alpha: NDArray[np.uint8], size: float) -> tuple[NDArray[np.float32], int]:
    """Return how smooth the outline nearby is: loose specks, bites and see-through stretches make it longer.

    Parameters
    ----------
    alpha : ndarray of shape (h, w), uint8
        The matte.
    size : float
        Of the head, pixels.

    Returns
    -------
    ndarray of shape (h', w', 1), float32, in [0, 1]
        For blocks of pixels.
    int
        Pixels along a block's side.
    """
    n = max(1, round(size / _FINE))
    small = masked_means(alpha[..., None], None, n)[0][..., 0] / np.float32(255)
    size = size / n
    length = [_variation(ndimage.gaussian_filter(small, s)) for s in (0.7, _SMOOTHED * size)]
    mean = [ndimage.gaussian_filter(a, _STRETCH * size) for a in length]
    told = mean[1] > 1e-3 * max(float(mean[1].max()), 1e-9)
    if not told.any():
        return np.ones((*small.shape, 1), np.float32), n
    ratio = np.where(told, mean[0] / np.maximum(mean[1], 1e-9), 0)
    ratio = ratio[tuple(ndimage.distance_transform_edt(~told, return_distances=False, return_indices=True))]
    good = 1 - _smooth((ratio - _RAGGED[0]) / (_RAGGED[1] - _RAGGED[0]))
    return np.asarray(ndimage.gaussian_filter(good, _STRETCH * size), dtype=np.float32)[..., None], n


def _variation(picture: NDArray[np.float32]) -> NDArray[np.float64]:
    """Return the length of the gradient."""
    return np.hypot(*np.gradient(picture.astype(np.float64)))


def _doubtful(
    inside: NDArray[np.bool_],
    away: NDArray[np.floating],
    found: NDArray[np.floating] | None,
    head: NDArray[np.bool_],
    below: NDArray[np.floating],
    size: float,
) -> NDArray[np.bool_]:
    """Return places that no outline may be trusted near."""
    mesh = ndimage.distance_transform_edt(head) / size
    beyond = ndimage.distance_transform_edt(~head) / size
    doubtful = (~inside & (mesh > _OVER)) | (inside & (beyond > _CLOTHES) & (below > _FROM * size))
    if found is not None:
        soft = (found > _SOFT[0]) & (found < _SOFT[1]) & (away > _CORE)
        against = np.where(inside, (found < _AGAINST[0]) & (mesh == 0), found > _AGAINST[1])
        doubtful |= ndimage.binary_opening(soft, iterations=1) | ndimage.binary_opening(against, iterations=1)
    return np.asarray(doubtful)


def _smooth(t: NDArray[np.floating]) -> NDArray[np.floating]:
    t = np.clip(t, 0, 1)
    return np.asarray(t * t * (3 - 2 * t))
