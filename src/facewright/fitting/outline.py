"""The outline of a face against what lies behind it, found in the picture near where a fit has it."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from facewright.fitting.lip_line import OPPONENT, interpolated, sampled_rgb, smoothest_path
from facewright.landmarks.contour import ContourStrips, build_contour_strips
from facewright.mesh.topology import Topology
from facewright.numeric.check import check_shape

#: Farthest move of the outline and the move expected (standard deviation), shares of the inter-ocular distance.
_FARTHEST, _EXPECTED = 0.2, 0.08
#: Distance of places along the outline and along the lines across it, shares of the inter-ocular distance.
_ALONG, _ACROSS = 0.06, 0.01
#: Least spread of brightness and two hues on one side, shares of white and of the side's brightness: shade darkens
#: skin by shares and hardly changes its hue.
_LEAST_SPREAD, _SHADED = np.array([0.04, 0.012, 0.012]), np.array([0.25, 0.04, 0.04])
#: A sample that is like neither side counts as so many standard deviations from each.
_MOST = 4.0
#: Sine of the angle from straight down at which the outline begins to count, and counts: below the chin is the neck.
_SIDEWAYS = (0.45, 0.75)
#: Vertices so near the line across a place, and so far beyond it, are seen behind it: shares of the same distance.
_ASIDE, _BEYOND = 0.05, 0.05
#: Length, a share of the inter-ocular distance, over which neighbouring samples say the same.
_CORRELATED = 0.03
#: Places on each side along the outline whose colours are taken together.
_TOGETHER = 2
#: By how much an edge must explain the colours better than none, in log likelihood: no trust, and full trust.
_CLEAR = (8.0, 24.0)
#: Cost of a bend of the outline between neighbouring places, per squared share of `_EXPECTED`.
_STIFFNESS = 12.0


@dataclass(frozen=True, eq=False)
class Outline:
    """Points of a face's outline.

    Parameters
    ----------
    first, second : ndarray of shape (K,), int32
        Vertices of the mesh between which each point lies.
    fraction : ndarray of shape (K,), float64
        0 at `first`, 1 at `second`.
    pixels : ndarray of shape (K, 2)
        Where the picture shows it.
    confidence : ndarray of shape (K,), float64
        0 where nothing is seen, to 1.
    """

    first: NDArray[np.int32]
    second: NDArray[np.int32]
    fraction: NDArray[np.float64]
    pixels: NDArray[np.float64]
    confidence: NDArray[np.float64]

    def __post_init__(self) -> None:
        sizes = check_shape("first", self.first, "K")
        for name in ("second", "fraction", "confidence"):
            check_shape(name, getattr(self, name), "K", **sizes)
        check_shape("pixels", self.pixels, "K", 2, **sizes)


def find_outline(
    picture: NDArray[np.uint8],
    topology: Topology,
    mean_shape: NDArray[np.floating],
    pixels: NDArray[np.floating],
    camera_from_model: NDArray[np.floating],
    iod: float,
) -> Outline:
    """Find the outline of cheek, jaw and chin in a picture, where the face bends out of sight.

    Across the fitted outline, the colours inside and outside of it are learnt, and the place is sought where one side
    ends and the other begins: the likeliest, smooth along the outline and near the fitted one (dynamic programming).
    Where the two sides look alike nothing is found: confidence 0.

    Parameters
    ----------
    picture : ndarray of shape (H, W, 3), uint8
        The photo.
    topology, mean_shape
        Of the mesh; see `build_contour_strips`.
    pixels : ndarray of shape (V, 2)
        The fitted mesh in the picture.
    camera_from_model : ndarray of shape (3, 3)
        Rotation of the head.
    iod : float
        Inter-ocular distance, pixels.

    Returns
    -------
    Outline
        Points, moved by at most 20 % of the inter-ocular distance across the fitted outline.
    """
    check_shape("picture", picture, "H", "W", 3)
    strips = _strips_of(topology, np.asarray(mean_shape, dtype=np.float32).tobytes())
    chosen = strips.outline(pixels[strips.vertices], camera_from_model)
    rows = np.arange(len(chosen))
    corners = strips.vertices[rows, chosen]
    bends = corners != strips.vertices[:, -1]  # else the strip is seen as a whole: ears, hair lie beyond it
    line = np.asarray(pixels, dtype=np.float64)[corners]
    along = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(line, axis=0), axis=1))])
    K = max(int(along[-1] / (_ALONG * iod)), 2)
    at = np.interp(np.linspace(0, along[-1], K), along, rows)
    first = np.minimum(at.astype(int), len(rows) - 2)
    fraction = at - first
    places = interpolated(line, rows, at)
    sideways = np.clip((np.abs(strips.outward[:, 0]) - _SIDEWAYS[0]) / (_SIDEWAYS[1] - _SIDEWAYS[0]), 0.0, 1.0)
    normal = _outward(places, line.mean(axis=0))
    usable = np.interp(at, rows, sideways) * (bends[first] & bends[first + 1])
    usable *= ~_something_behind(np.asarray(pixels, dtype=np.float64), places, normal, iod)
    shift, confidence = _shift(picture, places, normal, iod, usable)
    return Outline(
        corners[first].astype(np.int32),
        corners[first + 1].astype(np.int32),
        fraction,
        places + shift[:, None] * normal,
        confidence,
    )


@lru_cache(maxsize=4)
def _strips_of(topology: Topology, mean_shape: bytes) -> ContourStrips:
    return build_contour_strips(topology, np.frombuffer(mean_shape, np.float32).reshape(-1, 3))


def _something_behind(
    pixels: NDArray[np.float64], places: NDArray[np.float64], normal: NDArray[np.float64], iod: float
) -> NDArray[np.bool_]:
    """Return at which places (K, 2) more of the mesh (V, 2) is seen beyond the outline: an ear, the neck, the skull."""
    near = ((pixels >= places.min(axis=0) - iod) & (pixels <= places.max(axis=0) + iod)).all(axis=1)
    away = pixels[near][None] - places[:, None]
    beyond = np.einsum("kvc,kc->kv", away, normal) / iod
    aside = np.abs(away[..., 0] * normal[:, None, 1] - away[..., 1] * normal[:, None, 0]) / iod
    return np.asarray(((aside < _ASIDE) & (beyond > _BEYOND) & (beyond < 2 * _FARTHEST)).any(axis=1))


def _outward(line: NDArray[np.float64], middle: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return unit normals (K, 2) of a line, away from its middle."""
    tangent = np.gradient(ndimage.gaussian_filter1d(line, 2.0, axis=0, mode="nearest"), axis=0)
    normal = np.stack([tangent[:, 1], -tangent[:, 0]], axis=1)
    normal /= np.maximum(np.linalg.norm(normal, axis=1, keepdims=True), 1e-9)
    if float((normal * (line - middle)).sum()) < 0:
        normal = -normal
    return np.asarray(normal)


def _shift(
    picture: NDArray[np.uint8],
    places: NDArray[np.float64],
    normal: NDArray[np.float64],
    iod: float,
    usable: NDArray[np.float64],
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return by how much each place (K, 2) moves along its normal, pixels, and how sure that is."""
    half = round(_FARTHEST / _ACROSS)
    step = _ACROSS * iod
    offsets = np.arange(-2 * half, 2 * half + 1) * step
    at = places[:, None] + offsets[None, :, None] * normal[:, None]
    colours, inside_picture = _colours(picture, at, iod)
    near = slice(half, 3 * half + 1)  # where the outline may lie
    share = step / (_CORRELATED * iod)
    within = share * _unlikeness(colours, slice(0, half))
    beyond = share * _unlikeness(colours, slice(3 * half + 1, None))
    # an outline before sample k: samples up to there are the face's, from there on what is behind
    before = np.cumsum(within, axis=1) - within
    after = np.cumsum(beyond[:, ::-1], axis=1)[:, ::-1]
    misfit = (before + after)[:, near]
    gain = np.minimum(within.sum(axis=1), beyond.sum(axis=1)) - misfit.min(axis=1)
    trust = np.clip((gain - _CLEAR[0]) / (_CLEAR[1] - _CLEAR[0]), 0.0, 1.0) * inside_picture * usable
    positions = np.broadcast_to((offsets[near] - 0.5 * step) / (_EXPECTED * iod), misfit.shape)
    chosen = smoothest_path(trust[:, None] * misfit + 0.5 * positions**2, positions, _STIFFNESS)
    rows = np.arange(len(places))
    at_end = (chosen <= 1) | (chosen >= misfit.shape[1] - 2)
    missed = misfit[rows, chosen] - misfit.min(axis=1)
    trust = trust * ~at_end * np.exp(-0.5 * missed / _CLEAR[0])
    shift = ndimage.gaussian_filter1d(offsets[near][chosen] - 0.5 * step, 1.0, mode="nearest")
    return shift, trust


def _colours(
    picture: NDArray[np.uint8], at: NDArray[np.float64], iod: float
) -> tuple[NDArray[np.float64], NDArray[np.bool_]]:
    """Return colours, brightness and two hues, at places (K, M, 2), and which of the K lines the picture has whole."""
    height, width = picture.shape[:2]
    low = np.clip(np.floor(at.min(axis=(0, 1))) - 3, 0, (width - 1, height - 1)).astype(int)
    high = np.clip(np.ceil(at.max(axis=(0, 1))) + 4, low + 1, (width, height)).astype(int)
    part = picture[low[1] : high[1], low[0] : high[0]].astype(np.float32) / 255.0
    blur = max(0.4, 0.006 * iod)
    smooth = ndimage.gaussian_filter(part, (blur, blur, 0))
    whole = ((at >= 0) & (at <= (width - 1, height - 1))).all(axis=(1, 2))
    return sampled_rgb(smooth, at - low) @ OPPONENT.T, whole


def _unlikeness(colours: NDArray[np.float64], side: slice) -> NDArray[np.float64]:
    """Return how unlike the colours of one side of the outline all colours (K, M, 3) are, (K, M), log likelihood."""
    K = len(colours)
    padded = np.pad(colours[:, side], ((_TOGETHER, _TOGETHER), (0, 0), (0, 0)), mode="edge")
    own = np.concatenate([padded[k : k + K] for k in range(2 * _TOGETHER + 1)], axis=1)
    centre = np.median(own, axis=1)
    spread = 1.4826 * np.median(np.abs(own - centre[:, None]), axis=1)
    least = _LEAST_SPREAD + _SHADED * centre[:, :1]
    z = (colours - centre[:, None]) / np.maximum(spread, least)[:, None]
    return 0.5 * np.minimum((z**2).sum(axis=2), _MOST**2)
