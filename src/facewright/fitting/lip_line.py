"""The edge between lips and the open mouth, found in the picture near where the detector put it."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from facewright.landmarks.points import Landmarks
from facewright.numeric.check import check_shape

#: Points of the detector from the right corner of the mouth to the left one, corners left out: upper and lower lip.
_UPPER_INNER = np.array([191, 80, 81, 82, 13, 312, 311, 310, 415])
_LOWER_INNER = np.array([95, 88, 178, 87, 14, 317, 402, 318, 324])
_UPPER_OUTER = np.array([185, 40, 39, 37, 0, 267, 269, 270, 409])
_LOWER_OUTER = np.array([146, 91, 181, 84, 17, 314, 405, 321, 375])
_CORNERS = np.array([78, 308])

#: Farthest move of the edge and the move expected (standard deviation), shares of the inter-ocular distance.
_FARTHEST, _EXPECTED = 0.07, 0.03
#: Places across the mouth and along each of them.
_COLUMNS, _OFFSETS = 33, 41
#: Width of the bands compared on both sides of an edge, a share of the inter-ocular distance.
_BAND = 0.0175
#: A mouth that is less open than this share of the inter-ocular distance, anywhere, has no inside to compare with.
_OPEN = 0.03
#: Difference of colour from the lip, in standard deviations of its own, that counts in full: above the mouth are gums,
#: which are like a lip.
_CLEAR_UPPER, _CLEAR_LOWER = 8.0, 3.0
#: Brightness and two hues, orthonormal; and the least spread of each within a lip, as shares of white: shadow alone
#: says less than another hue.
OPPONENT = np.array([[1.0, 1.0, 1.0], [1.0, -1.0, 0.0], [0.5, 0.5, -1.0]]) / np.sqrt([[3.0], [2.0], [1.5]])
_LEAST_SPREAD = np.array([0.05, 0.012, 0.012])
#: Cost of a bend of the edge between neighbouring places, per squared share of `_EXPECTED`.
_STIFFNESS = 8.0


def refine_lip_line(picture: NDArray[np.uint8], found: Landmarks) -> Landmarks:
    """Return landmarks whose inner lip points lie on the edge between lip and mouth that the picture shows.

    Along lines across each lip, the colours on both sides of a place are compared with the lip's own colour; the edge
    is where they part most, smooth along the lip and near the detector's (dynamic programming). Where the mouth is
    closed or cut by the picture's edge, or teeth, gums and lip look alike, points stay.

    Parameters
    ----------
    picture : ndarray of shape (H, W, 3), uint8
        The photo.
    found : Landmarks
        Of scheme ``mediapipe478``; others are returned as they are.

    Returns
    -------
    Landmarks
        Inner lip points moved by at most 7 % of the inter-ocular distance.
    """
    check_shape("picture", picture, "H", "W", 3)
    ids = np.concatenate([_UPPER_INNER, _LOWER_INNER, _UPPER_OUTER, _LOWER_OUTER, _CORNERS])
    if found.scheme != "mediapipe478" or not found.present[ids].all():
        return found
    iod = found.interocular_distance()
    gap = np.linalg.norm(found.points[_UPPER_INNER] - found.points[_LOWER_INNER], axis=1)
    size = picture.shape[1::-1]
    if gap.max() < max(_OPEN * iod, 2.0) or not ((found.points[_CORNERS] > 0) & (found.points[_CORNERS] < size)).all():
        return found
    points = found.points.copy()
    crop, origin = _smooth_crop(picture, points[ids], iod)
    across = (
        (_UPPER_INNER, _UPPER_OUTER, _LOWER_INNER, _CLEAR_UPPER),
        (_LOWER_INNER, _LOWER_OUTER, _UPPER_INNER, _CLEAR_LOWER),
    )
    for inner, outer, facing, clear in across:
        edge, rim, other = (found.points[k] - origin for k in (inner, outer, facing))
        points[inner] += _edge_shift(crop, edge, rim, other, iod, clear)
    return Landmarks(found.scheme, points, found.confidence)


def _smooth_crop(
    picture: NDArray[np.uint8], points: NDArray[np.float64], iod: float
) -> tuple[NDArray[np.float32], NDArray[np.float64]]:
    """Return the surroundings of the mouth, lightly smoothed, sRGB in [0, 1] (H, W, 3), and their corner."""
    margin = 0.2 * iod
    low = np.clip(np.floor(points.min(axis=0) - margin), 0, None).astype(int)
    high = np.ceil(points.max(axis=0) + margin).astype(int) + 1
    part = picture[low[1] : high[1], low[0] : high[0]].astype(np.float32) / 255.0
    smooth = ndimage.gaussian_filter(part, (max(0.4, 0.006 * iod), max(0.4, 0.006 * iod), 0))
    return smooth, low.astype(np.float64)


def _edge_shift(
    crop: NDArray[np.float32],
    inner: NDArray[np.float64],
    outer: NDArray[np.float64],
    facing: NDArray[np.float64],
    iod: float,
    clear: float,
) -> NDArray[np.float64]:
    """Return by how much each of the inner points (N, 2) of one lip moves, pixels; `facing` is the other lip's edge."""
    N = len(inner)
    place, at = np.arange(N), np.linspace(0, N - 1, _COLUMNS)
    inner_c, outer_c, facing_c = (interpolated(p, place, at) for p in (inner, outer, facing))
    lip = outer_c - inner_c
    thickness = np.linalg.norm(lip, axis=1)
    way = lip / np.maximum(thickness, 1e-9)[:, None]  # out of the mouth, into the lip
    gap = np.linalg.norm(facing_c - inner_c, axis=1)
    reach = np.minimum(_FARTHEST * iod, 0.5 * np.minimum(thickness, np.maximum(gap, 0.0)))
    offsets = np.linspace(-1, 1, _OFFSETS)[None] * reach[:, None]
    unlike = _unlikeness(crop, inner_c, lip, clear)
    band = np.linspace(0.15, 1.0, 6) * _BAND * iod
    inside = _sampled(unlike, inner_c[:, None, None] + (offsets[..., None] - band)[..., None] * way[:, None, None])
    beyond = _sampled(unlike, inner_c[:, None, None] + (offsets[..., None] + band)[..., None] * way[:, None, None])
    score = inside.mean(axis=2) - beyond.mean(axis=2)
    cost = -2.0 * score + 0.5 * (offsets / (_EXPECTED * iod)) ** 2
    cost[reach < 1.0] = 0.5 * (np.linspace(-1, 1, _OFFSETS) * 4) ** 2  # too narrow to see anything: stays
    chosen = smoothest_path(cost, offsets / (_EXPECTED * iod))
    shift = ndimage.gaussian_filter1d(offsets[np.arange(_COLUMNS), chosen], 1.0, mode="nearest")
    return np.asarray(np.interp(place, at, shift)[:, None] * interpolated(way, at, place.astype(float)))


def _unlikeness(
    crop: NDArray[np.float32], inner: NDArray[np.float64], lip: NDArray[np.float64], clear: float
) -> NDArray[np.float32]:
    """Return how unlike the lip's colour each pixel is, (H, W), in [0, 1]: 0 below 0.4 `clear`, 1 above 1.4."""
    own = sampled_rgb(crop, inner[:, None] + np.linspace(0.4, 0.8, 7)[None, :, None] * lip[:, None]).reshape(-1, 3)
    centre = np.median(own, axis=0)
    spread = 1.4826 * np.median(np.abs((own - centre) @ OPPONENT.T), axis=0)
    scale = np.maximum(spread, _LEAST_SPREAD)
    z = (crop - centre.astype(np.float32)) @ (OPPONENT / scale[:, None]).T.astype(np.float32)
    return np.clip(np.sqrt((z**2).sum(axis=2)) / clear - 0.4, 0.0, 1.0).astype(np.float32)


def interpolated(values: NDArray[np.float64], at: NDArray, wanted: NDArray) -> NDArray[np.float64]:
    """Return values (N, D) given at places (N,), linearly interpolated at the wanted ones."""
    return np.stack([np.interp(wanted, at, values[:, k]) for k in range(values.shape[1])], axis=1)


def _sampled(image: NDArray[np.float32], points: NDArray[np.float64]) -> NDArray[np.float64]:
    return np.asarray(ndimage.map_coordinates(image, [points[..., 1], points[..., 0]], order=1, mode="nearest"))


def sampled_rgb(image: NDArray[np.float32], points: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the colours (..., 3) of an image (H, W, 3) at places (..., 2), bilinear."""
    return np.stack([_sampled(image[..., k], points) for k in range(3)], axis=-1)


def smoothest_path(
    cost: NDArray[np.float64], positions: NDArray[np.float64], stiffness: float = _STIFFNESS
) -> NDArray[np.intp]:
    """Return one offset per column (N, M) that minimises cost plus stiffness times squared change (Viterbi)."""
    n, m = cost.shape
    best = cost[0].copy()
    came = np.zeros((n, m), dtype=np.intp)
    for k in range(1, n):
        change = best[:, None] + stiffness * (positions[k - 1][:, None] - positions[k][None]) ** 2
        came[k] = change.argmin(axis=0)
        best = change.min(axis=0) + cost[k]
    path = np.empty(n, dtype=np.intp)
    path[-1] = int(best.argmin())
    for k in range(n - 1, 0, -1):
        path[k - 1] = came[k, path[k]]
    return path
