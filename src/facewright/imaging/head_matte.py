"""How far each pixel of a photo shows the person and not what lies behind: the matte that parts both."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from facewright.imaging.blocks import enlarge, masked_means
from facewright.imaging.guided_filter import fit_local_lines
from facewright.imaging.matte_trust import matte_trust, smoothness
from facewright.imaging.rasterise import rasterise
from facewright.imaging.source_surface import BODY, INNER, SourceSurface
from facewright.numeric.check import check_shape

#: Finds persons: picture (h, w, 3) uint8 -> probability (any size, same extent), or None where it cannot tell.
PersonFinder = Callable[[NDArray[np.uint8]], NDArray[np.float32] | None]

_AROUND, _BELOW = 0.9, 1.1  # of the head's size: what is looked at beside and above the head, and below the chin
_WORK = 140  # pixels that the head has where the matte is sought
_FACE_RIM, _SKULL_RIM = 0.03, 0.10  # of the head's size: so far inside the fitted outlines all is person
_UNSURE = 0.02  # the finder's edges are known to so much
_RADIUS, _NOISE = 0.025, 0.02  # of the guided filter: of the head's size; in shares of white
_ROUNDS = 3
_NEAR = 0.35  # colours of what lies behind are learnt up to so far from the person
_BINS = 16
_STEEP = (0.15, 0.65)  # of the filtered map, what is none and what is all
_BLOCK_ROWS = 512
_FINDER_RIM = (0.022, 0.03)  # so far within the finder's outline all is person, so far beyond it nothing
_FINE = 400  # pixels that the head has, at most, where holes and specks are sought
_CLOSED = 0.012  # of the head's size: narrower gaps in the person are none


@dataclass(frozen=True, eq=False)
class HeadMatte:
    """The person's share of the pixels in a box of the photo.

    Parameters
    ----------
    origin : (x, y)
        First pixel of the box.
    alpha : ndarray of shape (h, w), uint8
        255 for the person, 0 for what lies behind; no holes, no loose specks.
    trust : ndarray of shape (h, w), uint8
        255 where the outline nearby is known well, see `matte_trust`.
    certainty : float
        How well colours tell the person from what lies behind along the outline, 0 to 1.
    """

    origin: tuple[int, int]
    alpha: NDArray[np.uint8]
    trust: NDArray[np.uint8]
    certainty: float


def find_head_matte(photo: NDArray[np.uint8], surface: SourceSurface, find_person: PersonFinder | None) -> HeadMatte:
    """Part the person of a fitted head from what lies behind.

    What the finder says of persons, or the head's outline where there is none, and the colours on both sides tell how
    likely each pixel is the person's; edges are those of the photo (guided filter).

    Parameters
    ----------
    photo : ndarray of shape (H, W, 3), uint8
        sRGB.
    surface : SourceSurface
        The fitted head.
    find_person : callable, optional
        Tells persons from other things.

    Raises
    ------
    ShapeError
        If `photo` has another shape.
    """
    check_shape("photo", photo, "H", "W", 3)
    x0, y0, x1, y1 = _box(surface, (photo.shape[0], photo.shape[1]))
    part = photo[y0:y1, x0:x1]
    n = max(1, round(surface.head_size / _WORK))
    small = masked_means(part, None, n)[0] / np.float32(255)
    head = surface.head_size / n
    sure, outline, skull = _outlines(surface, (x0, y0), n, small.shape[:2])
    found = None if find_person is None else find_person(np.ascontiguousarray(part))
    if found is not None:
        found = _resized(found, small.shape[:2])
        prior = ndimage.gaussian_filter(found, _UNSURE * head)
    else:
        prior = _prior_of_outline(outline, head)
    prior = np.where(sure, 1, prior).astype(np.float32)
    person, colour, certainty = _decide(small, prior, sure, head)
    if found is not None:
        person = _within_finder(person, prior, sure, head)
    below = _below_chin(surface, (x0, y0), n, small.shape[:2])
    trust = matte_trust(person, colour, found, skull, below, head)
    alpha = _at_full_size(part, person, small, head, n)
    _clean(alpha, surface.head_size)
    smooth, k = smoothness(alpha, surface.head_size)
    trusted = np.empty(part.shape[:2], np.uint8)
    for top in range(0, part.shape[0], _BLOCK_ROWS):
        rows = slice(top, min(top + _BLOCK_ROWS, part.shape[0]))
        both = enlarge(trust[..., None], n, part.shape[:2], rows) * enlarge(smooth, k, part.shape[:2], rows)
        trusted[rows] = np.rint(255 * np.clip(both[..., 0], 0, 1))
    return HeadMatte((x0, y0), alpha, trusted, certainty)


def _at_full_size(
    part: NDArray[np.uint8], person: NDArray[np.float32], small: NDArray[np.float32], head: float, n: int
) -> NDArray[np.uint8]:
    """Return the matte whose edges are the picture's."""
    line = fit_local_lines(person, small, max(1, round(_RADIUS * head)), _NOISE)
    alpha = np.empty(part.shape[:2], np.uint8)
    for top in range(0, part.shape[0], _BLOCK_ROWS):
        rows = slice(top, min(top + _BLOCK_ROWS, part.shape[0]))
        share = enlarge(line.level[..., None], n, part.shape[:2], rows)[..., 0]
        share += (enlarge(line.slope, n, part.shape[:2], rows) * (part[rows] / np.float32(255))).sum(axis=2)
        t = np.clip((share - _STEEP[0]) / (_STEEP[1] - _STEEP[0]), 0, 1)
        alpha[rows] = np.rint(255 * t * t * (3 - 2 * t))
    return alpha


def _below_chin(surface: SourceSurface, origin: tuple[int, int], n: int, shape: tuple[int, ...]) -> NDArray[np.float64]:
    """Return how far the pixels of the reduced picture lie below the chin."""
    ys, xs = np.mgrid[: shape[0], : shape[1]]
    along = surface.down / max(float(np.linalg.norm(surface.down)), 1e-9)
    chin = (surface.chin - origin + 0.5) / n - 0.5
    return np.asarray((xs - chin[0]) * along[0] + (ys - chin[1]) * along[1])


def _within_finder(
    person: NDArray[np.float32], prior: NDArray[np.float32], sure: NDArray[np.bool_], head: float
) -> NDArray[np.float32]:
    """Let colours decide near the finder's outline alone."""
    inside = ndimage.binary_fill_holes((prior > 0.5) | sure)
    person = np.where(_eroded(inside, _FINDER_RIM[0] * head), np.float32(1), person)
    beyond = ndimage.distance_transform_edt(~inside) > _FINDER_RIM[1] * head
    return np.asarray(np.where(beyond, np.float32(0), person), dtype=np.float32)


def _clean(alpha: NDArray[np.uint8], head_size: float) -> None:
    """Fill holes and narrow gaps, take loose specks away, in place."""
    n = max(1, round(head_size / _FINE))
    r = max(1, round(_CLOSED * head_size / n))
    solid = np.pad(masked_means(alpha[..., None], None, n)[0][..., 0] > 127, 2 * r, mode="edge")
    solid = ndimage.distance_transform_edt(~solid) <= r  # closing with a disk
    solid = ndimage.distance_transform_edt(solid) > r
    solid = ndimage.distance_transform_edt(solid) > 0.5 * r  # opening with a smaller one: no threads
    solid = ndimage.binary_fill_holes(ndimage.distance_transform_edt(~solid) <= 0.5 * r)
    pieces, count = ndimage.label(solid)
    if count > 1:
        solid = pieces == 1 + int(np.argmax(np.bincount(pieces.ravel())[1:]))
    for sure, value in ((_eroded(solid, r), 255), (_eroded(~solid, r), 0)):
        whole = sure[2 * r : -2 * r, 2 * r : -2 * r].repeat(n, axis=0).repeat(n, axis=1)
        alpha[whole[: alpha.shape[0], : alpha.shape[1]]] = value


def _box(surface: SourceSurface, size: tuple[int, int]) -> tuple[int, int, int, int]:
    """Return the box (x0, y0, x1, y1) that is looked at."""
    pixels = surface.view.pixels[np.unique(surface.faces[surface.kinds != BODY])]
    away = _AROUND * surface.head_size
    lo, hi = pixels.min(axis=0) - away, pixels.max(axis=0) + away
    below = surface.chin + _BELOW * surface.head_size * surface.down
    lo, hi = np.minimum(lo, below), np.maximum(hi, below)
    x0, y0 = (int(k) for k in np.maximum(np.floor(lo), 0))
    x1, y1 = (int(k) for k in np.minimum(np.ceil(hi) + 1, (size[1], size[0])))
    return x0, y0, max(x1, x0 + 1), max(y1, y0 + 1)


def _outlines(
    surface: SourceSurface, origin: tuple[int, int], n: int, shape: tuple[int, ...]
) -> tuple[NDArray[np.bool_], NDArray[np.bool_], NDArray[np.bool_]]:
    """Return, on the reduced picture, what is person for sure, what the fitted head and neck cover, and the head."""
    view = surface.view
    at = (view.pixels - origin + 0.5) / n - 0.5
    size = (shape[0], shape[1])
    seen = rasterise(at, view.depth, surface.faces, size, perspective=view.perspective)
    faces = np.maximum(seen.face_index, 0)
    head = seen.covered & (surface.kinds[faces] != BODY)
    front = head & (surface.front[surface.faces].all(axis=1)[faces] | (surface.kinds[faces] == INNER))
    large = surface.head_size / n
    sure = _eroded(front, _FACE_RIM * large) | _eroded(head, _SKULL_RIM * large)
    return sure, seen.covered, head


def _eroded(region: NDArray[np.bool_], by: float) -> NDArray[np.bool_]:
    return np.asarray(ndimage.distance_transform_edt(np.pad(region, 1))[1:-1, 1:-1] > by)


def _prior_of_outline(outline: NDArray[np.bool_], head: float) -> NDArray[np.float32]:
    """Return how likely a pixel is the person's for its distance from the fitted outline alone."""
    if outline.all():
        return np.ones(outline.shape, np.float32)
    away = ndimage.distance_transform_edt(~outline) - ndimage.distance_transform_edt(outline)
    return np.asarray(1 / (1 + np.exp((away / head - 0.05) / 0.035)), dtype=np.float32)


def _decide(
    picture: NDArray[np.float32], prior: NDArray[np.float32], sure: NDArray[np.bool_], head: float
) -> tuple[NDArray[np.float32], NDArray[np.float64], float]:
    """Return how likely each pixel is the person's, by place and colour, by colour alone, and how well colours tell."""
    odds = np.clip(np.log(np.maximum(prior, 1e-3) / np.maximum(1 - prior, 1e-3)), -4, 4)
    bins = np.minimum((picture * _BINS).astype(int), _BINS - 1)
    person, colour, certainty = prior, np.zeros(prior.shape), 0.0
    for _ in range(_ROUNDS):
        inside = person > 0.5
        if inside.all() or not inside.any():
            return np.where(sure, 1, person).astype(np.float32), colour, 0.0
        within, beyond = ndimage.distance_transform_edt(inside), ndimage.distance_transform_edt(~inside)
        # learnt near the outline, but not at it
        ours = _histogram(bins, inside & (within > _UNSURE * head) & (within < _NEAR * head))
        theirs = _histogram(bins, (beyond > _UNSURE * head) & (beyond < _NEAR * head))
        at = tuple(np.moveaxis(bins, 2, 0))
        colour = np.clip(np.log(ours[at] / theirs[at]), -2, 2)
        total = 1 / (1 + np.exp(-(odds + 1.2 * colour)))
        total = np.where(sure, 1, total)
        line = fit_local_lines(total, picture, max(1, round(_RADIUS * head)), _NOISE)
        person = np.where(sure, 1, np.clip(line.at(picture), 0, 1)).astype(np.float32)
        band = (np.minimum(within, 1e9) < 0.06 * head) & inside | (beyond < 0.06 * head) & ~inside
        certainty = float(np.abs(2 * person[band] - 1).mean())
        pieces = ndimage.label(person > 0.5)[0]
        own = np.unique(pieces[sure])
        person = np.where((pieces == 0) | np.isin(pieces, own), person, np.float32(0))
    return _without_holes(person, sure), colour, certainty


def _without_holes(person: NDArray[np.float32], sure: NDArray[np.bool_]) -> NDArray[np.float32]:
    """Fill what the person surrounds."""
    inside = ndimage.binary_fill_holes(person > 0.5)
    deep = ndimage.binary_erosion(inside, iterations=2)
    return np.where(deep & (person <= 0.5), np.float32(1), person)


def _histogram(bins: NDArray[np.intp], where: NDArray[np.bool_]) -> NDArray[np.float64]:
    """Return the smoothed density of colours."""
    index = np.ravel_multi_index(tuple(bins[where].T), (_BINS,) * 3)
    counts = np.bincount(index, minlength=_BINS**3).reshape((_BINS,) * 3).astype(float)
    smooth = ndimage.gaussian_filter(counts, 0.8, mode="constant") + 0.02 * ndimage.gaussian_filter(counts, 3.0)
    total = max(float(counts.sum()), 1.0)
    return np.asarray(smooth / total + 2e-5)


def _resized(values: NDArray[np.float32], shape: tuple[int, ...]) -> NDArray[np.float32]:
    """Interpolate a map to another size of the same extent."""
    at = [(np.arange(n) + 0.5) * m / n - 0.5 for n, m in zip(shape, values.shape)]
    return np.asarray(
        ndimage.map_coordinates(values, np.meshgrid(*at, indexing="ij"), order=1, mode="nearest"), dtype=np.float32
    )
