"""Teeth that the photo shows: its own pixels, on a layer that moves with the skull and one that moves with the jaw."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from facewright.imaging.wide_blur import wide_blur

_LUMINANCE = np.array([0.2126, 0.7152, 0.0722], np.float32)
_LEAST_SEEN = 14  # pixels of an open mouth
_CROWN_MM = 10.5
_GUM_MM = 6.0
_BEHIND_LIP_MM = 3.0  # so much of the upper teeth the lower lip may hide
#: Teeth must be seen in so many of the open mouth's columns to be carried over.
_LEAST_SHARE = 0.35
#: Columns of a layer beside its colours: how opaque it is, and where it hides the drawn teeth.
OPAQUE, CUT = 3, 4


@dataclass(frozen=True, eq=False)
class MouthLayers:
    """What the photo shows in the mouth.

    Parameters
    ----------
    skull, jaw : ndarray of shape (h, w, 5), float32
        sRGB in [0, 255], opacity in [0, 1], and where drawn teeth of the same row are left out; in the photo's pixels.
    origin : tuple of int
        Column and row of the photo at the first pixel.
    tooth : ndarray of shape (3,), or None
        sRGB colour, [0, 255], of the teeth seen; None where none is.
    dark : ndarray of shape (3,), or None
        The darkest that is seen in the mouth.
    """

    skull: NDArray[np.float32]
    jaw: NDArray[np.float32]
    origin: tuple[int, int]
    tooth: NDArray[np.float64] | None
    dark: NDArray[np.float64] | None


def mouth_layers(
    photo: NDArray[np.uint8],
    origin: tuple[int, int],
    inside: NDArray[np.bool_],
    lips: NDArray[np.floating],
    incisal: NDArray[np.floating],
    px_per_mm: float,
    gum: NDArray[np.floating],
) -> MouthLayers:
    """Part what a photo shows between the lips into what belongs to the skull and what to the jaw.

    Going down each column of pixels, teeth are what is bright and less red than the lips; the first row of teeth ends
    at its edge, where something dark follows, or at the lower lip. Rows go on behind the lips as they end.

    Parameters
    ----------
    photo : ndarray of shape (h, w, 3), uint8
        The photo round the mouth.
    origin : (column, row)
        Where this cut-out begins in the photo.
    inside : ndarray of shape (h, w), bool
        Pixels between the lips, by the fitted mesh.
    lips : ndarray of shape (3,)
        sRGB colour of the lips, [0, 255].
    incisal : ndarray of shape (w,)
        Row of the fitted mesh's upper cutting edge in each column; NaN where there is none.
    px_per_mm : float
        Scale.
    gum : ndarray of shape (3,)
        sRGB colour of gums in the photo's light.
    """
    h, w = inside.shape
    skull, jaw = np.zeros((h, w, 5), np.float32), np.zeros((h, w, 5), np.float32)
    values = photo.astype(np.float32)
    if inside.sum() < _LEAST_SEEN or inside.sum(axis=0).max() < _least_open(px_per_mm):
        return MouthLayers(skull, jaw, origin, None, None)
    tooth, colour = _teeth(values, inside, np.asarray(lips, np.float32))
    tall = tooth.sum(axis=0) >= max(3.0, 1.5 * px_per_mm)  # of less nothing is learnt
    if tall.sum() < _LEAST_SHARE * inside.any(axis=0).sum():
        return MouthLayers(skull, jaw, origin, None, None)
    tooth &= tall
    columns = np.flatnonzero(inside.any(axis=0))
    first, last = inside.argmax(axis=0), h - 1 - inside[::-1].argmax(axis=0)
    division, whole = _division(tooth, first, last, columns, max(2, round(0.8 * px_per_mm)))
    division, whole, has = _between(division, whole)
    whole = np.asarray(ndimage.binary_opening(whole, np.ones(5)))  # a lone column is a mistake
    if has.sum() < 4:
        return MouthLayers(skull, jaw, origin, None, None)
    bright = values @ _LUMINANCE
    limit = 0.35 * float(np.asarray(colour) @ _LUMINANCE) if colour is not None else 0.0
    inset = max(1, round(0.3 * px_per_mm))
    ends = _ends_behind_lip(incisal, last, has & ~whole, px_per_mm)
    for x in columns:
        top, bottom = int(first[x]), int(last[x])
        if has[x]:
            stop = round(division[x])
            gums = gum if tooth[min(top + inset, bottom), x] else None
            _fill_skull(skull, values, x, top, min(stop, bottom + 1), inset, px_per_mm, gums)
            if whole[x]:
                skull[stop : stop + int(8 * px_per_mm), x, CUT] = 1.0
            else:
                _continue_down(skull, x, bottom, ends[x], inset)
        elif bright[top : bottom + 1, x].mean() < limit:  # the dark beside the teeth stays with them
            _fill_skull(skull, values, x, top, bottom + 1, inset, px_per_mm, None)
        if whole[x]:
            _fill_jaw(jaw, values, x, round(division[x]), bottom, inset, px_per_mm)
    _even_out(skull, np.where(inside.any(axis=0), first, 0), px_per_mm)
    for layer in (skull, jaw):
        _soften(layer)
    dark = values[inside][values[inside] @ _LUMINANCE <= np.percentile(values[inside] @ _LUMINANCE, 5)].mean(axis=0)
    return MouthLayers(skull, jaw, origin, colour, dark.astype(np.float64))


def trim_lips(
    photo: NDArray[np.uint8], inside: NDArray[np.bool_], lips: NDArray[np.floating], most_px: int
) -> NDArray[np.bool_]:
    """Take lips out of what the fitted mesh says is between them, where the mesh's mouth is open too far.

    From either lip inwards, column by column: lip-coloured pixels up to the first that is not, at most `most_px`;
    where none follows so soon, the colour says nothing (tongue, gums) and the mesh stands.
    """
    values = ndimage.gaussian_filter(photo.astype(np.float32), (0.5, 0.5, 0))
    red = (values[..., 0] + 6) / (values[..., 1] + 6)
    bright = values @ _LUMINANCE
    lip_red, lip_bright = float((lips[0] + 6) / (lips[1] + 6)), float(lips @ _LUMINANCE)
    like = (red > 1.0 + 0.6 * (lip_red - 1.0)) & (bright > 0.55 * lip_bright) & (bright < 1.7 * lip_bright)
    result = inside.copy()
    for x in np.flatnonzero(inside.any(axis=0)):
        rows = np.flatnonzero(inside[:, x])
        for order in (rows, rows[::-1]):
            run = int(np.argmin(np.append(like[order, x], False)))
            if 0 < run <= min(most_px, len(order) - 1):
                result[order[:run], x] = False
    return np.asarray(ndimage.binary_opening(result, np.ones((1, 3)))) if result.any() else result


def teeth_in_slit(
    photo: NDArray[np.uint8], line: NDArray[np.bool_], lips: NDArray[np.bool_], px_per_mm: float
) -> NDArray[np.bool_]:
    """Find teeth that show between lips which the fitted mesh says are all but shut.

    Parameters
    ----------
    photo : ndarray of shape (h, w, 3), uint8
        The photo round the mouth.
    line : ndarray of shape (h, w), bool
        Where the lips meet, by the fitted mesh.
    lips : ndarray of shape (h, w), bool
        The lips; near their line what is brighter and less red than they are around is teeth.
    px_per_mm : float
        Scale.
    """
    none = np.zeros(line.shape, bool)
    if not line.any() or lips.sum() < _LEAST_SEEN or line.sum(axis=0).max() >= _least_open(px_per_mm):
        return none
    values = ndimage.gaussian_filter(photo.astype(np.float32), (0.7, 0.7, 0))
    red, bright = (values[..., 0] + 6) / (values[..., 1] + 6), values @ _LUMINANCE
    weight, sigma = (lips & ~line).astype(np.float32), 3.0 * px_per_mm
    mass = np.maximum(wide_blur(weight, sigma), 1e-3)
    usual_red, usual_bright = wide_blur(weight * red, sigma) / mass, wide_blur(weight * bright, sigma) / mass
    near = lips & (ndimage.distance_transform_edt(~line) <= 2.5 * px_per_mm)
    found = near & (bright > 1.12 * usual_bright) & (red < 1.0 + 0.75 * (usual_red - 1.0))
    found = ndimage.binary_opening(found, np.ones((2, 2)))
    return np.asarray(ndimage.binary_dilation(found, np.ones((3, 3)), iterations=max(1, round(0.4 * px_per_mm))))


def _least_open(px_per_mm: float) -> float:
    """Return how many rows a mouth must be open for teeth to be told from lips."""
    return max(4.0, 2.2 * px_per_mm)


def _teeth(
    values: NDArray[np.float32], inside: NDArray[np.bool_], lips: NDArray[np.float32]
) -> tuple[NDArray[np.bool_], NDArray[np.float64] | None]:
    """Return which pixels are teeth, and their colour."""
    brightness = values @ _LUMINANCE
    bright = inside & (brightness >= np.percentile(brightness[inside], 80))
    colour = np.median(values[bright], axis=0)
    red = (values[..., 0] + 6) / (values[..., 1] + 6)
    tooth_red, lip_red = float((colour[0] + 6) / (colour[1] + 6)), float((lips[0] + 6) / (lips[1] + 6))
    if tooth_red > max(1.08, 1.0 + 0.45 * (lip_red - 1.0)) or colour @ _LUMINANCE < 0.8 * (lips @ _LUMINANCE):
        return np.zeros(inside.shape, bool), None  # tongue, or only the dark
    tooth = inside & (brightness > 0.45 * (colour @ _LUMINANCE)) & (red < 0.5 * (tooth_red + lip_red))
    if tooth.sum() < 6:
        return np.zeros(inside.shape, bool), None
    return tooth, np.median(values[tooth & (brightness > 0.8 * (colour @ _LUMINANCE))], axis=0).astype(np.float64)


def _division(
    tooth: NDArray[np.bool_],
    first: NDArray[np.intp],
    last: NDArray[np.intp],
    columns: NDArray[np.intp],
    gap: int,
) -> tuple[NDArray[np.float64], NDArray[np.bool_]]:
    """Return the row below the upper teeth in each column (NaN: none seen), and whether their edge is seen."""
    w = tooth.shape[1]
    division = np.full(w, np.nan)
    whole = np.zeros(w, bool)
    for x in columns:
        top, bottom = int(first[x]), int(last[x])
        run = tooth[top : bottom + 1, x]
        if not run.any():
            continue
        start = int(run.argmax())
        if start > 0.55 * len(run) and len(run) > 3 * gap:
            continue  # only the lower teeth
        closed = ndimage.binary_closing(np.pad(run, gap), iterations=max(1, gap // 2))[gap:-gap]
        end = start + int(np.argmin(np.append(closed[start:], False)))
        whole[x] = end < len(run) - max(1, gap // 2) - 0.5
        division[x] = top + (end if whole[x] else len(run))
    known = np.flatnonzero(np.isfinite(division))
    if len(known) >= 5:
        smooth = ndimage.median_filter(division[known], 5, mode="nearest")
        division[known] = np.where(whole[known], smooth, division[known])
        whole[known] = ndimage.median_filter(whole[known].astype(np.uint8), 5, mode="nearest") > 0
    return division, whole


def _between(
    division: NDArray[np.float64], whole: NDArray[np.bool_]
) -> tuple[NDArray[np.float64], NDArray[np.bool_], NDArray[np.bool_]]:
    """Let columns between teeth, gums or dark, end where their neighbours do; also tells which columns are known."""
    known = np.flatnonzero(np.isfinite(division))
    if len(known) == 0:
        return division, whole, np.zeros(len(division), bool)
    span = np.arange(known[0], known[-1] + 1)
    filled = division.copy()
    filled[span] = np.interp(span, known, division[known])
    nearest = known[np.abs(span[:, None] - known[None]).argmin(axis=1)]
    ends = whole.copy()
    ends[span] = whole[nearest]
    return filled, ends, np.isfinite(filled)


def _fill_skull(
    layer: NDArray[np.float32],
    values: NDArray[np.float32],
    x: int,
    top: int,
    stop: int,
    inset: int,
    px_per_mm: float,
    gum: NDArray[np.floating] | None,
) -> None:
    """Put one column of upper teeth on the layer, going on upwards behind the lip: to the gum, or as it is seen."""
    if stop <= top:
        return
    layer[top:stop, x, :3] = values[top:stop, x]
    edge = min(top + inset, stop - 1)
    layer[top:edge, x, :3] = values[edge, x]
    high = max(0, int(top - (_GUM_MM + 2) * px_per_mm))
    crown = stop - _CROWN_MM * px_per_mm
    rows = np.arange(high, top)
    share = np.clip((crown - rows) / (2.0 * px_per_mm), 0, 1)[:, None]
    shade = np.clip(1.0 - 0.06 * (top - rows) / px_per_mm, 0.5, 1.0)[:, None]  # behind the lip it gets dark
    beyond = values[edge, x] if gum is None else np.asarray(gum, np.float32)
    layer[high:top, x, :3] = shade * (values[edge, x] * (1 - share) + share * beyond)
    layer[high:stop, x, OPAQUE] = 1.0
    layer[high:stop, x, CUT] = 1.0


def _even_out(layer: NDArray[np.float32], first: NDArray[np.intp], px_per_mm: float) -> None:
    """Let what goes on upwards behind the lip, column by column, lose its streaks with the distance, in place."""
    solid = (layer[..., OPAQUE] > 0).astype(np.float32)
    sigma = 1.8 * px_per_mm
    mass = ndimage.gaussian_filter1d(solid, sigma, axis=1)[..., None]
    mean = ndimage.gaussian_filter1d(layer[..., :3] * solid[..., None], sigma, axis=1) / np.maximum(mass, 1e-3)
    above = (first[None, :] - np.arange(len(layer))[:, None]) / px_per_mm
    share = np.clip(above / 1.5, 0.0, 1.0)[..., None].astype(np.float32)
    layer[..., :3] += share * (mean - layer[..., :3])


def _ends_behind_lip(
    incisal: NDArray[np.floating], last: NDArray[np.intp], hidden: NDArray[np.bool_], px_per_mm: float
) -> NDArray[np.float64]:
    """Return the row where teeth end in each column in which the lower lip hides their edge, without its steps."""
    ends = np.maximum(last + 1.0, np.minimum(np.nan_to_num(incisal, nan=0.0), last + _BEHIND_LIP_MM * px_per_mm))
    known = np.flatnonzero(hidden)
    if len(known) == 0:
        return ends
    line = np.interp(np.arange(len(ends)), known, ends[known])
    return np.where(hidden, ndimage.gaussian_filter1d(line, 1.2 * px_per_mm, mode="nearest"), ends)


def _continue_down(layer: NDArray[np.float32], x: int, bottom: int, end: float, inset: int) -> None:
    """Let teeth that the lower lip hides go on to their cutting edge, a row that need not be whole."""
    whole, edge = int(end), max(bottom - inset, 0)
    layer[edge + 1 : whole + 1, x, :3] = layer[edge, x, :3]
    layer[edge + 1 : whole, x, OPAQUE] = 1.0
    if whole < len(layer):
        layer[whole, x, OPAQUE] = end - whole
    layer[whole + 1 :, x, OPAQUE] = 0.0
    layer[edge + 1 : whole + 4, x, CUT] = 1.0


def _fill_jaw(
    layer: NDArray[np.float32],
    values: NDArray[np.float32],
    x: int,
    start: int,
    bottom: int,
    inset: int,
    px_per_mm: float,
) -> None:
    """Put one column of what moves with the jaw on the layer, going on downwards behind the lip."""
    if bottom < start:
        return
    edge = max(bottom - inset, start)
    end = int(bottom + 4 * px_per_mm) + 1
    layer[start : bottom + 1, x, :3] = values[start : bottom + 1, x]
    layer[edge:end, x, :3] = values[edge, x]
    layer[start:end, x, OPAQUE] = 1.0
    layer[start:end, x, CUT] = 1.0


def _soften(layer: NDArray[np.float32]) -> None:
    """Feather the layer's edges, in place, its colours going on beyond them."""
    solid = layer[..., OPAQUE] > 0
    if not solid.any():
        return
    nearest = ndimage.distance_transform_edt(~solid, return_distances=False, return_indices=True)
    layer[..., :3] = layer[..., :3][tuple(nearest)]
    layer[..., OPAQUE] = ndimage.gaussian_filter(layer[..., OPAQUE], 0.6)
    layer[..., CUT] = ndimage.gaussian_filter(layer[..., CUT], 0.6)
