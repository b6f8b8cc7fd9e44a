"""Labels that jumped: markers that changed names are given them back, markers that nothing explains are left out."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from facewright.errors import ValueRangeError
from facewright.models.marker_gaps import predict_missing
from facewright.numeric.check import check_shape

Array = NDArray[np.float64]

_REACH_MM = 30.0  # labels are mixed up between neighbours
_ROUNDS = 6
#: What a swap must gain in squared standard deviations, and beyond what a marker alone is implausible.
_GAIN, _OUTLIER = 40.0, 60.0
_SUSPECT = 15.0  # of a marker alone: only frames with such a one are searched for swaps
_OUTLIER_MM = 2.5
#: Markers of a frame that may be left out: one in this many, and at least so many.
_SHARE_LEFT_OUT, _LEAST_LEFT_OUT = 16, 6


class MendedLabels(NamedTuple):
    """Offsets under the right labels, and what was done.

    Parameters
    ----------
    offsets : ndarray of shape (T, M, 3), millimetres
        NaN where a marker was left out.
    partner : ndarray of shape (T, M), int
        Whose label a marker bore; its own number where nothing was mended.
    n_swapped, n_left_out : int
        Values (a marker in a frame) renamed, and left out as no face would put a marker there.
    n_stray : ndarray of shape (T,), int
        Markers of a frame that are still out of place once as many are left out as may be: such frames show no face.
    stray_mm : float
        Median distance of those markers from where the others say they are; 0 without any.
    """

    offsets: Array
    partner: NDArray[np.intp]
    n_swapped: int
    n_left_out: int
    n_stray: NDArray[np.intp]
    stray_mm: float


def mend_labels(
    offsets: NDArray[np.floating], rest: NDArray[np.floating], precision: NDArray[np.floating]
) -> MendedLabels:
    """Find swapped labels and markers out of place in every frame.

    Two labels are exchanged where the frame becomes far likelier under a Gaussian prior of the offsets; all pairs of
    neighbours are tried in all frames at once, the best pair of each frame first. A marker that is then still far from
    where the others say it is counts as unseen, up to a sixteenth of them in a frame.

    Parameters
    ----------
    offsets : ndarray of shape (T, M, 3), millimetres
        Offsets of the labelled points from the labels' places at rest, the head held still; NaN where unseen.
    rest : ndarray of shape (M, 3), millimetres
        The markers at rest.
    precision : ndarray of shape (3M, 3M), 1 / mm^2
        Inverse covariance of the offsets.

    Raises
    ------
    ShapeError
        If shapes do not match.
    ValueRangeError
        If a frame has no marker.
    """
    T, M = check_shape("offsets", offsets, "T", "M", 3).values()
    check_shape("rest", rest, M, 3)
    check_shape("precision", precision, 3 * M, 3 * M)
    missing = np.isnan(offsets).any(axis=2)
    if missing.all(axis=1).any():
        raise ValueRangeError("every frame must have a marker, got one without.")
    places = np.asarray(rest, dtype=np.float64)
    points = np.where(missing[..., None], 0.0, np.asarray(offsets, dtype=np.float64)) + places
    partner = np.tile(np.arange(M), (T, 1))
    pairs = cKDTree(places).query_pairs(_REACH_MM, output_type="ndarray")
    blocks = precision.reshape(M, 3, M, 3)
    costs, _ = _alone(points - places, missing, precision, blocks)
    busy = np.flatnonzero(costs.max(axis=1) > _SUSPECT)
    for _ in range(_ROUNDS):
        if not len(busy) or not len(pairs):
            break
        gain, best = _best_swap(points[busy] - places, missing[busy], places, pairs, precision, blocks)
        busy, best = busy[gain > _GAIN], best[gain > _GAIN]
        a, b = pairs[best].T
        likely = _fits_after(points[busy] - places, missing[busy], places, a, b, precision)
        busy, a, b = busy[likely], a[likely], b[likely]
        for array in (points, partner):
            array[busy, a], array[busy, b] = array[busy, b], array[busy, a].copy()
    strange, n_stray, stray_mm = _out_of_place(points - places, missing, precision, blocks)
    missing = missing | strange
    left_out = int((missing & ~np.isnan(offsets).any(axis=2)).sum())
    mended = np.where(missing[..., None], np.nan, points - places)
    swapped = int(((partner != np.arange(M)) & ~missing).sum())
    return MendedLabels(mended, partner, swapped, left_out, n_stray, stray_mm)


def _best_swap(
    offsets: Array,
    missing: NDArray[np.bool_],
    places: Array,
    pairs: NDArray[np.intp],
    precision: NDArray[np.floating],
    blocks: NDArray[np.floating],
) -> tuple[Array, NDArray[np.intp]]:
    """Return what the best exchange of each frame gains (F,), and which pair it is (F,)."""
    T, M = offsets.shape[:2]
    known = predict_missing(offsets, missing, precision)
    pull = (known.reshape(T, -1) @ precision).reshape(T, M, 3)
    a, b = pairs.T
    apart = (known[:, b] + places[b]) - (known[:, a] + places[a])
    curvature = blocks[a, :, a] + blocks[b, :, b] - blocks[a, :, b] - blocks[b, :, a]
    change = 2.0 * ((pull[:, a] - pull[:, b]) * apart).sum(axis=2)
    change += np.einsum("tpi,pij,tpj->tp", apart, curvature, apart, optimize=True)
    change[missing[:, a] | missing[:, b]] = 0.0
    best = change.argmin(axis=1)
    return -change[np.arange(T), best], best


def _fits_after(
    offsets: Array,
    missing: NDArray[np.bool_],
    places: Array,
    a: NDArray[np.intp],
    b: NDArray[np.intp],
    precision: NDArray[np.floating],
) -> NDArray[np.bool_]:
    """Return for each frame whether a or b is where the others say once their labels are exchanged (F,).

    A marker far out of place makes many exchanges look like a gain; of three labels in a ring the first exchange mends
    one.
    """
    rows = np.arange(len(offsets))
    swapped = offsets + places
    swapped[rows, a], swapped[rows, b] = swapped[rows, b], swapped[rows, a].copy()
    known = predict_missing(swapped - places, missing, precision)
    pull = (known.reshape(len(rows), precision.shape[0]) @ precision).reshape(known.shape)
    own = np.concatenate([3 * a[:, None] + np.arange(3), 3 * b[:, None] + np.arange(3)], axis=1)
    # offsets of the pair from what all others say, and their covariance
    covariance = np.linalg.inv(precision[own[:, :, None], own[:, None, :]])
    both = np.concatenate([pull[rows, a], pull[rows, b]], axis=1)
    off = np.einsum("fij,fj->fi", covariance, both)
    costs = [
        np.einsum("fi,fi->f", off[:, part], np.linalg.solve(covariance[:, part, part], off[:, part, None])[..., 0])
        for part in (slice(0, 3), slice(3, 6))
    ]
    return np.asarray(np.minimum(*costs) < _OUTLIER)


def _out_of_place(
    offsets: Array, missing: NDArray[np.bool_], precision: NDArray[np.floating], blocks: NDArray[np.floating]
) -> tuple[NDArray[np.bool_], NDArray[np.intp], float]:
    """Return the markers (T, M) far from where all others say they are, the worst of each frame first.

    Also how many of each frame are still so beyond those that may be left out (T,), and how far, by the median.
    """
    T, M = missing.shape
    gone, busy, n_stray = missing.copy(), np.arange(T), np.zeros(T, dtype=np.intp)
    rounds = max(_LEAST_LEFT_OUT, M // _SHARE_LEFT_OUT)
    for number in range(rounds + 1):
        cost, off = _alone(offsets[busy], gone[busy], precision, blocks)
        strange = (cost > _OUTLIER) & (off > _OUTLIER_MM) & ~gone[busy]
        found = strange.any(axis=1)
        busy, cost, strange = busy[found], cost[found], strange[found]
        if not len(busy):
            return gone & ~missing, n_stray, 0.0
        if number < rounds:
            gone[busy] |= strange & (cost >= np.where(strange, cost, 0.0).max(axis=1, keepdims=True))
    n_stray[busy] = strange.sum(axis=1)
    return gone & ~missing, n_stray, float(np.median(off[found][strange]))


def _alone(
    offsets: Array, missing: NDArray[np.bool_], precision: NDArray[np.floating], blocks: NDArray[np.floating]
) -> tuple[Array, Array]:
    """Return how unlikely each marker is given all others (T, M), squared standard deviations, and how far off, mm."""
    T, M = offsets.shape[:2]
    own = np.linalg.inv(blocks[np.arange(M), :, np.arange(M)])
    known = predict_missing(offsets, missing, precision)
    pull = (known.reshape(T, 3 * M) @ precision).reshape(T, M, 3)
    off = np.einsum("mij,tmj->tmi", own, pull)
    return (off * pull).sum(axis=2), np.linalg.norm(off, axis=2)
