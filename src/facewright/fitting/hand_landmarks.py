"""Landmarks that somebody placed on a scan, of several schemes, as ``fw74``."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from facewright.errors import FacewrightError, NoFaceError, ShapeError
from facewright.faces.face import Face
from facewright.fitting.registration import bend_by_landmarks
from facewright.fitting.scan_placement import Placement, place_points
from facewright.landmarks.scheme import load_scheme
from facewright.numeric.check import check_finite, check_shape

Array = NDArray[np.float64]

_NOSE_TIP, _MOUTH = 45, (54, 60)
#: What the first two of five points may be: inner corners, centres, outer corners of the eyes (the person's right one
#: first), as points of ``fw74`` to average.
_EYES = (([31], [39]), (list(range(27, 35)), list(range(35, 43))), ([27], [35]))
#: A landmark this far from those that it is interpolated from has half their weight.
_INTERPOLATED_MM = 3.0
#: Weight of the points that five given ones only imply.
_IMPLIED = 0.05


def landmarks_from_points(
    face: Face, points: NDArray[np.floating], confidence: NDArray[np.floating] | None = None
) -> tuple[Array, Array]:
    """Return ``fw74`` landmarks of 74 (``fw74``), 68 (``ibug68``) or 5 points on a scan.

    Parameters
    ----------
    face : Face
        The template, with ``fw74`` landmarks.
    points : ndarray of shape (74, 3), (68, 3) or (5, 3), the scan's unit
        Points on the surface; NaN where missing (never of five). Five are two of the eyes (both inner corners, both
        centres or both outer corners), the tip of the nose, and the corners of the mouth; the person's right or left
        one first, alike for eyes and mouth.
    confidence : ndarray of shape (L,), optional
        Their weights; all 1 where absent.

    Returns
    -------
    landmarks : ndarray of shape (74, 3), the scan's unit
        NaN where there is none.
    confidence : ndarray of shape (74,)
        0 where there is none.

    Raises
    ------
    ShapeError
        If there is another number of points.
    NoFaceError, ValueRangeError
        If five points are not those of a face.
    """
    array = np.asarray(points, dtype=np.float64)
    n = len(array)
    if array.ndim != 2 or array.shape[1] != 3 or n not in (74, 68, 5):
        raise ShapeError(
            f"landmarks of a scan must be 74 (fw74), 68 (ibug68) or 5 points of three coordinates, got {array.shape}."
        )
    weights = np.ones(n) if confidence is None else np.asarray(confidence, dtype=np.float64)
    check_shape("confidence", weights, n)
    if n == 5:
        return _from_five(face, array)
    weights = np.where(np.isfinite(array).all(axis=1), weights, 0.0)
    if n == 68:
        return _from_68(face, array, weights)
    return np.where(weights[:, None] > 0, array, np.nan), weights


def _from_68(face: Face, points: Array, weights: Array) -> tuple[Array, Array]:
    """Return ``fw74`` landmarks of ``ibug68`` ones: where the mean face has them, bent by those that are given.

    Of the two schemes only some points have the same place on the face; the others lie millimetres apart.
    """
    ids = face.topology.landmarks["ibug68"]
    fixed = load_scheme("ibug68").fixed
    given = fixed[(weights[fixed] > 0) & (ids[fixed] >= 0)]
    mean = face.mean_shape.astype(np.float64)
    placement = place_points(mean[ids[given]], points[given], weights[given])
    to_model = placement.scan_from_model.inverse()
    wanted = face.topology.landmarks["fw74"]
    known = wanted >= 0
    known[load_scheme("fw74").sliding] = False
    corners = np.concatenate([mean[ids[given]], mean[wanted[known]]]) * placement.size
    # inner mouth corners may share a vertex with outer ones
    _, distinct = np.unique(ids[given], return_index=True)
    bent = bend_by_landmarks(corners, distinct, to_model.apply(points[given][distinct]))[len(given) :]
    away = np.linalg.norm(corners[len(given) :, None] - corners[None, : len(given)], axis=2)
    landmarks, confidence = np.full((74, 3), np.nan), np.zeros(74)
    landmarks[known] = placement.scan_from_model.apply(bent)
    nearest = away.argmin(axis=1)
    confidence[known] = weights[given][nearest] / (1.0 + (away.min(axis=1) / _INTERPOLATED_MM) ** 2)
    return landmarks, confidence


def _from_five(face: Face, points: Array) -> tuple[Array, Array]:
    """Return ``fw74`` landmarks of five points, whatever of the eyes and whichever side comes first."""
    check_finite("landmarks", points)
    ids = face.topology.landmarks["fw74"]
    model = face.mean_shape[np.maximum(ids, 0)].astype(np.float64)
    model[ids < 0] = np.nan
    placement, eyes, ordered = _best_of_five(model, points)
    if _rms_upside_down(model, points) < placement.landmark_rms_mm:
        raise NoFaceError(
            "five landmarks must be two of the eyes, the tip of the nose and two of the mouth, in this order; "
            "these fit better with eyes and mouth exchanged."
        )
    landmarks = placement.scan_from_model.apply(model * placement.size)
    confidence = np.where(np.isfinite(landmarks).all(axis=1), _IMPLIED, 0.0)
    confidence[load_scheme("fw74").sliding] = 0.0
    if len(eyes[0]) == 1:  # corners, which are landmarks themselves
        landmarks[[eyes[0][0], eyes[1][0]]] = ordered[:2]
        confidence[[eyes[0][0], eyes[1][0]]] = 1.0
    landmarks[[_NOSE_TIP, *_MOUTH]] = ordered[2:]
    confidence[[_NOSE_TIP, *_MOUTH]] = 1.0
    landmarks[confidence == 0] = np.nan
    return landmarks, confidence


def _best_of_five(model: Array, points: Array) -> tuple[Placement, tuple[list[int], list[int]], Array]:
    """Return the placement of the best reading of five points, which points of the eyes it takes, and their order."""
    best: tuple[Placement, tuple[list[int], list[int]], Array] | None = None
    failure: FacewrightError | None = None
    for eyes in _EYES:
        five = np.stack([model[eyes[0]].mean(axis=0), model[eyes[1]].mean(axis=0), *model[[_NOSE_TIP, *_MOUTH]]])
        for order in ([0, 1, 2, 3, 4], [1, 0, 2, 4, 3]):
            try:
                placement = place_points(five, points[order], np.ones(5))
            except FacewrightError as error:
                failure = failure or error
                continue
            if best is None or placement.landmark_rms_mm < best[0].landmark_rms_mm:
                best = placement, eyes, points[order]
    if best is None:
        assert failure is not None
        raise failure
    return best


def _rms_upside_down(model: Array, points: Array) -> float:
    """Return how well the points fit with eyes and mouth exchanged, mm; infinite where not at all."""
    try:
        return _best_of_five(model, points[[3, 4, 2, 0, 1]])[0].landmark_rms_mm
    except FacewrightError:
        return np.inf
