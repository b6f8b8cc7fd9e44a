"""The front of an eyeball as the photo would show it without lids: its own pixels, and what they tell of the rest."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from facewright.imaging.colour import linear_from_srgb, srgb_from_linear
from facewright.imaging.wide_blur import wide_blur

#: Shadow of the upper lid on the eyeball: its depth and how fast it fades downwards.
LID_SHADOW, LID_SHADOW_MM = 0.42, 1.6
IRIS_MM = 6.0
_PUPIL_SHARE = 0.36
_SCLERA_ALBEDO = np.array([0.62, 0.58, 0.55])
_IRIS_ALBEDO = np.array([0.075, 0.045, 0.028])  # brown, as most eyes are
_LUMINANCE = np.array([0.2126, 0.7152, 0.0722], np.float32)
_LEAST_SEEN = 12  # pixels


@dataclass(frozen=True, eq=False)
class EyeLayer:
    """An eyeball without lids, in the photo's pixels.

    Parameters
    ----------
    picture : ndarray of shape (h, w, 3), float32
        sRGB in [0, 255], without the lids' shadows and what the cornea mirrors.
    origin : tuple of int
        Column and row of the photo at the picture's first pixel.
    iris : ndarray of shape (3,), float64, pixels
        Centre and radius of the iris in the photo.
    sclera : ndarray of shape (3,), float64
        Linear colour of the white of the eye, unshadowed.
    seen : bool
        Whether the photo shows the eye open.
    glint : ndarray of shape (n, m, 3), float32
        What the cornea mirrors, to be added to `picture`, sRGB.
    glint_origin : tuple of int
        Column and row of the photo at its first pixel.
    """

    picture: NDArray[np.float32]
    origin: tuple[int, int]
    iris: NDArray[np.float64]
    sclera: NDArray[np.float64]
    seen: bool
    glint: NDArray[np.float32]
    glint_origin: tuple[int, int]


def eye_light(
    below_mm: NDArray[np.floating], above_mm: NDArray[np.floating], corner_mm: NDArray[np.floating]
) -> NDArray[np.floating]:
    """Return the share of light, sRGB over sRGB, on an eyeball.

    At distances (mm) below the upper lid's edge, above the lower one's and from the nearer corner.
    """
    shade = 1.0
    for away, depth, reach in ((below_mm, LID_SHADOW, LID_SHADOW_MM), (above_mm, 0.15, 0.8), (corner_mm, 0.22, 2.0)):
        shade = shade * (1.0 - depth * np.exp(-np.maximum(away, 0.0) / reach))
    return np.asarray(shade)


def eye_layer(
    photo: NDArray[np.uint8],
    origin: tuple[int, int],
    seen: NDArray[np.bool_],
    light: NDArray[np.floating],
    iris: NDArray[np.floating],
    px_per_mm: float,
    white: NDArray[np.floating],
) -> EyeLayer:
    """Complete the eyeball that a photo shows between the lids.

    Parameters
    ----------
    photo : ndarray of shape (h, w, 3), uint8
        The photo round the eye, as far as the eyeball may ever be seen.
    origin : (column, row)
        Where this cut-out begins in the photo.
    seen : ndarray of shape (h, w), bool
        Pixels that show the eyeball, by the fitted mesh.
    light : ndarray of shape (h, w)
        Share of light that the lids leave, see `eye_light`.
    iris : ndarray of shape (3,), pixels
        Centre and radius of the iris in the cut-out by the fitted mesh.
    px_per_mm : float
        Scale.
    white : ndarray of shape (3,)
        Linear colour of a white surface that faces the camera, for eyes that the photo does not show.

    Returns
    -------
    EyeLayer
        The eyeball; where the photo does not show it, the white of the eye goes on and the iris is round.
    """
    values = photo.astype(np.float32)
    sure = _sure(seen, px_per_mm)
    bare = np.minimum(values / light[..., None].astype(np.float32), 255.0)
    open_eye = int(sure.sum()) >= _LEAST_SEEN
    if open_eye:
        iris = find_iris(values @ _LUMINANCE, sure, iris)
    radius = _radius(photo.shape[:2], iris)
    sure &= (radius < 1.08) | _white(values, sure & (radius > 1.08))
    usual_white = 255.0 * srgb_from_linear(_SCLERA_ALBEDO * white).astype(np.float32)
    sclera = _sclera(bare, sure & (radius > 1.12), usual_white, px_per_mm)
    plain = _iris_disc(bare, sure, radius, white)
    glint, glint_origin = _mirrored(values, bare, plain, seen, radius, iris, px_per_mm, open_eye)
    hidden = _glint_mask(glint, glint_origin, seen.shape)
    sure &= ~hidden
    disc = _lit_like(plain, bare, sure & (radius < 1.0), iris[2])
    edge = np.clip((1.03 - radius) * iris[2] / 1.2 + 0.5, 0, 1)[..., None]
    drawn = sclera + (disc - sclera) * edge
    weight = np.clip(ndimage.distance_transform_edt(sure) / max(1.0, 0.8 * px_per_mm), 0, 1)[..., None]
    picture = drawn + (bare - drawn) * weight
    middle = linear_from_srgb(np.median(sclera[radius > 1.2].reshape(-1, 3), axis=0) / 255.0).astype(np.float64)
    where = np.array([iris[0] + origin[0], iris[1] + origin[1], iris[2]])
    mirror = (origin[0] + glint_origin[0], origin[1] + glint_origin[1])
    return EyeLayer(np.ascontiguousarray(picture, np.float32), origin, where, middle, open_eye, glint, mirror)


def _sure(seen: NDArray[np.bool_], px_per_mm: float) -> NDArray[np.bool_]:
    """Return the pixels that show the eyeball for certain: clear of the lids' edges and of lashes."""
    away = ndimage.distance_transform_edt(np.pad(seen, 1))[1:-1, 1:-1]
    inside = np.asarray(away > max(1.0, 0.5 * px_per_mm))
    hang = round(0.5 * px_per_mm)  # the upper lid's lashes hang into the picture of the eye
    if hang:
        shifted = np.zeros_like(inside)
        shifted[hang:] = inside[:-hang]
        inside &= shifted
    return inside


def _white(values: NDArray[np.float32], around: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Tell what may be the white of the eye: neither the redder flesh of corner and lids, nor dark lashes."""
    if not around.any():
        return around
    red = (values[..., 0] + 8) / (values[..., 1:].mean(axis=2) + 8)
    bright = values @ _LUMINANCE
    typical, usual = np.percentile(red[around], 35), np.percentile(bright[around], 80)
    return np.asarray((red < max(1.25, 1.2 * float(typical))) & (bright > 0.5 * usual))


def _radius(shape: tuple[int, ...], iris: NDArray[np.floating]) -> NDArray[np.float32]:
    y, x = np.mgrid[: shape[0], : shape[1]].astype(np.float32)
    return np.asarray(np.hypot(x - iris[0], y - iris[1]) / iris[2], np.float32)


def find_iris(
    brightness: NDArray[np.floating], seen: NDArray[np.bool_], start: NDArray[np.floating]
) -> NDArray[np.float64]:
    """Find the circle near `start` (x, y, radius) across which the picture brightens most (Daugman 1993).

    Only what is `seen` counts: mostly the left and right of the iris. The start stays where nothing speaks against it.
    """
    x0, y0, r0 = (float(v) for v in start)
    smooth = ndimage.gaussian_filter(np.asarray(brightness, np.float64), max(0.5, 0.06 * r0))
    known = seen.astype(np.float64)
    best = np.array([x0, y0, r0])
    # coarsely first, across a wide step of brightness, then finely
    for reach, spread, width in ((0.45, 0.2, 0.15), (0.12, 0.08, 0.07), (0.04, 0.03, 0.05)):
        best = _best_circle(smooth, known, np.asarray(start, np.float64), best, reach, spread, width)
    return best


def _best_circle(
    smooth: NDArray[np.float64],
    known: NDArray[np.float64],
    start: NDArray[np.float64],
    around: NDArray[np.float64],
    reach: float,
    spread: float,
    width: float,
) -> NDArray[np.float64]:
    """Return the best of circles near `around`, up to `reach` radii away and `spread` larger or smaller."""
    x0, y0, r0 = around
    shifts, sizes = np.linspace(-reach, reach, 11), np.linspace(1 - spread, 1 + spread, 9)
    angles = np.linspace(0, 2 * np.pi, 64, endpoint=False)
    dy, dx, size = (g.ravel() for g in np.meshgrid(shifts, shifts, sizes, indexing="ij"))
    cx, cy, radius = x0 + dx * r0, y0 + dy * r0, r0 * size
    gain, weight = np.zeros(len(cx)), np.zeros(len(cx))
    inner, outer = 1 - width, 1 + width
    for angle in angles:
        c, s = np.cos(angle), np.sin(angle)
        ins = [cy + inner * radius * s, cx + inner * radius * c]
        outs = [cy + outer * radius * s, cx + outer * radius * c]
        both = ndimage.map_coordinates(known, ins, order=1) * ndimage.map_coordinates(known, outs, order=1)
        step = ndimage.map_coordinates(smooth, outs, order=1) - ndimage.map_coordinates(smooth, ins, order=1)
        gain += both * np.clip(step, -60.0, 60.0)
        weight += both
    off_x, off_y, larger = (cx - start[0]) / start[2], (cy - start[1]) / start[2], radius / start[2] - 1
    usual = np.exp(-0.5 * ((off_x / 0.3) ** 2 + (off_y / 0.25) ** 2 + (larger / 0.13) ** 2))
    if reach < 0.2:  # near what was found the picture alone decides
        usual = np.ones(len(cx))
    score = gain / np.maximum(weight, 0.12 * len(angles)) * usual
    best = int(np.argmax(score))
    return np.array([cx[best], cy[best], radius[best]]) if score[best] > 2.0 else around


def _sclera(
    bare: NDArray[np.float32], known: NDArray[np.bool_], usual: NDArray[np.float32], px_per_mm: float
) -> NDArray[np.float32]:
    """Continue the white of the eye from where it is seen."""
    if known.sum() < 4:
        return np.broadcast_to(usual, bare.shape).astype(np.float32)
    brightness = bare @ _LUMINANCE
    known = known & (brightness > 0.6 * np.percentile(brightness[known], 80))  # not lashes, not shadows in the corner
    colour = np.percentile(bare[known], 60, axis=0).astype(np.float32)
    weight = known.astype(np.float32)
    sigma = max(1.0, 1.5 * px_per_mm)
    mass = wide_blur(weight, sigma)[..., None] + 0.03
    moment = wide_blur(bare * weight[..., None], sigma) + 0.03 * colour
    return np.asarray(moment / mass, np.float32)


def _iris_disc(
    bare: NDArray[np.float32], sure: NDArray[np.bool_], radius: NDArray[np.float32], white: NDArray[np.floating]
) -> NDArray[np.float32]:
    """Return a round iris with the radial profile of what is seen of it, everywhere."""
    bins = np.linspace(0.0, 1.1, 12)
    own = sure & (radius < 1.1)
    index = np.digitize(radius, bins) - 1
    iris = 255.0 * srgb_from_linear(_IRIS_ALBEDO * white)
    usual = np.where(bins[:, None] < _PUPIL_SHARE, 0.12, 1.0) * iris
    profile, known = usual.copy(), np.zeros(len(bins), bool)
    for k in range(len(bins)):
        ring = own & (index == k)
        if ring.sum() >= 3:
            profile[k] = np.percentile(bare[ring], 45, axis=0)  # below the median: glints are bright
            known[k] = True
    if known.any():
        for k in range(3):
            profile[:, k] = np.interp(bins, bins[known], profile[known, k])
        if not known[:3].any():  # the pupil is never brighter than the iris
            profile[bins < _PUPIL_SHARE] *= 0.5
    profile = ndimage.gaussian_filter1d(profile, 0.6, axis=0, mode="nearest")
    centres = bins + 0.05
    return np.stack([np.interp(radius, centres, profile[:, k]) for k in range(3)], axis=2).astype(np.float32)


def _lit_like(
    disc: NDArray[np.float32], bare: NDArray[np.float32], known: NDArray[np.bool_], size: float
) -> NDArray[np.float32]:
    """Give the drawn iris the slow changes of light over what is seen of it."""
    if known.sum() < 4:
        return disc
    ratio = np.clip((bare + 4) / (disc + 4), 0.5, 2.0) * known[..., None]
    sigma = max(0.8, 0.35 * size)
    mass = wide_blur(known.astype(np.float32), sigma)[..., None] + 0.01
    smooth = (wide_blur(ratio, sigma) + 0.01) / mass
    return np.asarray(disc * np.clip(smooth, 0.6, 1.6), np.float32)


def _mirrored(
    values: NDArray[np.float32],
    bare: NDArray[np.float32],
    disc: NDArray[np.float32],
    seen: NDArray[np.bool_],
    radius: NDArray[np.float32],
    iris: NDArray[np.floating],
    px_per_mm: float,
    open_eye: bool,
) -> tuple[NDArray[np.float32], tuple[int, int]]:
    """Return what the cornea mirrors in a photo, (n, m, 3) sRGB to be added, and where its first pixel is.

    That is what is much brighter than the iris round it; a small usual highlight where the eye is shut.
    """
    reach = int(np.ceil(iris[2] * 1.1)) + 2
    x0, y0 = max(int(iris[0]) - reach, 0), max(int(iris[1]) - reach, 0)
    part = np.s_[y0 : int(iris[1]) + reach + 1, x0 : int(iris[0]) + reach + 1]
    if values[part].size == 0:
        return np.zeros((2, 2, 3), np.float32), (0, 0)
    if not open_eye:
        return _usual_glint(values[part].shape, np.array([iris[0] - x0, iris[1] - y0, iris[2]]), px_per_mm), (x0, y0)
    own = seen[part] & (radius[part] < 0.97)
    inside = ndimage.distance_transform_edt(np.pad(seen[part], 1))[1:-1, 1:-1] > 1.0
    over = (values[part] - disc[part]) @ _LUMINANCE
    usual = disc[part] @ _LUMINANCE
    core = own & inside & (over > np.maximum(55.0, usual))
    if not core.any():
        return np.zeros((2, 2, 3), np.float32), (x0, y0)
    near = ndimage.distance_transform_edt(~core) <= max(1.0, 0.35 * px_per_mm)
    near &= own
    extra = np.where(near[..., None], np.maximum(values[part] - np.minimum(disc[part], bare[part]), 0.0), 0.0)
    extra += 0.7 * ((extra @ _LUMINANCE)[..., None] - extra)  # what is mirrored is mostly white light
    extra = np.asarray(ndimage.gaussian_filter(extra, (0.4, 0.4, 0)), np.float32)
    return np.ascontiguousarray(extra), (x0, y0)


def _glint_mask(glint: NDArray[np.float32], origin: tuple[int, int], shape: tuple[int, ...]) -> NDArray[np.bool_]:
    """Return where a picture of the given shape holds what the cornea mirrors."""
    mask = np.zeros(shape, bool)
    part = mask[origin[1] : origin[1] + glint.shape[0], origin[0] : origin[0] + glint.shape[1]]
    part |= glint[: part.shape[0], : part.shape[1]].max(axis=2) > 2.0
    return mask


def _usual_glint(shape: tuple[int, ...], iris: NDArray[np.floating], px_per_mm: float) -> NDArray[np.float32]:
    """Return the highlight of a light above the camera, for an eye that the photo does not show."""
    y, x = np.mgrid[: shape[0], : shape[1]].astype(np.float32)
    size = max(0.7, 0.8 * px_per_mm)
    away = np.hypot(x - iris[0] + 0.30 * iris[2], y - iris[1] + 0.33 * iris[2]) / size
    return np.asarray(140.0 * np.clip(1.5 - away, 0, 1)[..., None] * np.ones(3, np.float32), np.float32)
