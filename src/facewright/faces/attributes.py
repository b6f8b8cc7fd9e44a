"""Attributes of a face that people have words for, measured from its geometry."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from facewright.errors import TopologyError, ValueRangeError
from facewright.mesh.topology import Topology
from facewright.numeric.check import check_shape

Points = NDArray[np.float64]

# After the 74 points of the fw74 scheme: the centres of these vertex sets, as many as the topology names.
_CENTRES = {"forehead": 74, "cheeks_left": 75, "cheeks_right": 76}
_N_POINTS = 77

_LEFT_EYE, _RIGHT_EYE = (35, 36, 37, 38, 39, 40, 41, 42), (27, 28, 29, 30, 31, 32, 33, 34)


def _distance(p: Points, i: int, j: int) -> NDArray[np.float64]:
    return np.asarray(np.linalg.norm(p[:, i] - p[:, j], axis=-1))


def _distances(*pairs: tuple[int, int]) -> Callable[[Points], NDArray[np.float64]]:
    """Return the mean distance of some pairs of points."""
    return lambda p: np.mean([_distance(p, i, j) for i, j in pairs], axis=0)


def _nose_height(p: Points) -> NDArray[np.float64]:
    return _along(p, 2, p[:, 45] - 0.5 * (p[:, 47] + p[:, 51]))


def _brow_height(p: Points) -> NDArray[np.float64]:
    brows = p[:, [16, 17, 18, 19, 22, 23, 24, 25]].mean(axis=1)
    return _along(p, 1, brows - p[:, [27, 31, 35, 39]].mean(axis=1))


def _forehead_height(p: Points) -> NDArray[np.float64]:
    # the centre of the forehead's skin is about half as far above the bridge as the hairline
    return 2.0 * _along(p, 1, p[:, _CENTRES["forehead"]] - p[:, 43])


def _eye_size(p: Points) -> NDArray[np.float64]:
    return np.asarray(np.mean([np.sqrt(_area(p[:, eye])) for eye in (_LEFT_EYE, _RIGHT_EYE)], axis=0))


def _cheek_fullness(p: Points) -> NDArray[np.float64]:
    left = _above_plane(p[:, _CENTRES["cheeks_left"]], p[:, 35], p[:, 60], p[:, 12])
    right = _above_plane(p[:, _CENTRES["cheeks_right"]], p[:, 27], p[:, 2], p[:, 54])
    return 0.5 * (left + right)


_MEASURES: dict[str, Callable[[Points], NDArray[np.float64]]] = {
    "face length": _distances((43, 7)),
    "face width": _distances((1, 13), (2, 12)),
    "jaw width": _distances((4, 10), (5, 9)),
    "chin height": _distances((63, 7)),
    "forehead height": _forehead_height,
    "mouth width": _distances((54, 60)),
    "lip thickness": _distances((57, 68), (63, 72)),
    "nose length": _distances((43, 49)),
    "nose width": _distances((46, 52)),
    "nose height": _nose_height,
    "eye size": _eye_size,
    "eye spacing": _distances((31, 39)),
    "brow height": _brow_height,
    "cheek fullness": _cheek_fullness,
}
_NEEDS_MASKS: dict[str, tuple[str, ...]] = {
    "forehead height": ("forehead",),
    "cheek fullness": ("cheeks_left", "cheeks_right"),
}

ATTRIBUTE_NAMES: tuple[str, ...] = tuple(_MEASURES)

#: What each attribute is, for people.
ATTRIBUTE_MEANINGS: dict[str, str] = {
    "face length": "from the bridge of the nose to the chin",
    "face width": "between the ears and between the upper cheeks",
    "jaw width": "between the angles of the jaw",
    "chin height": "from the lower lip to the chin",
    "forehead height": "from the bridge of the nose towards the hair",
    "mouth width": "between the corners of the mouth",
    "lip thickness": "of the red of both lips",
    "nose length": "from its bridge to its base",
    "nose width": "between the wings of the nose",
    "nose height": "how far the tip stands out from the face",
    "eye size": "root of the area between the lids",
    "eye spacing": "between the inner corners of the eyes",
    "brow height": "of the brows above the eyes",
    "cheek fullness": "how far the cheeks stand out from eye, mouth and ear",
}


def attribute_names(topology: Topology) -> tuple[str, ...]:
    """Return the attributes that meshes of a topology can be measured for, in the order of `ATTRIBUTE_NAMES`.

    Two of them (forehead, cheeks) need named vertex sets that not every topology has.
    """
    there = {name for name, ids in topology.masks.items() if len(ids)}
    return tuple(name for name in ATTRIBUTE_NAMES if there.issuperset(_NEEDS_MASKS.get(name, ())))


def attribute_points(vertices: NDArray[np.floating], topology: Topology) -> NDArray[np.float64]:
    """Return the points that attributes are measured between: linear in the vertices.

    Parameters
    ----------
    vertices : ndarray of shape (V, 3) or (N, V, 3), millimetres
        Meshes of the topology, or displacements of them.
    topology : Topology
        With landmarks of the ``"fw74"`` scheme.

    Returns
    -------
    ndarray of shape (77, 3) or (N, 77, 3), float64, millimetres
        The 74 landmarks, then the centres of forehead and cheeks, 0 where the topology does not name them.

    Raises
    ------
    TopologyError
        If the topology does not carry the fw74 landmarks.
    ShapeError
        If `vertices` is not of this topology.
    """
    ids = topology.landmarks.get("fw74")
    if ids is None or (np.asarray(ids) < 0).any():
        raise TopologyError(f"topology {topology.name!r} must have vertices for the fw74 landmarks, got none or gaps.")
    batch = vertices if vertices.ndim == 3 else vertices[None]
    check_shape("vertices", batch, "N", topology.n_vertices, 3)
    points = np.zeros((len(batch), _N_POINTS, 3))
    points[:, : len(ids)] = batch[:, ids]
    for name, row in _CENTRES.items():
        mask = topology.masks.get(name)
        if mask is not None and len(mask):
            points[:, row] = batch[:, mask].mean(axis=1, dtype=np.float64)
    return points if vertices.ndim == 3 else points[0]


def measure_points(points: NDArray[np.floating], names: tuple[str, ...]) -> NDArray[np.float64]:
    """Measure attributes between points made by `attribute_points`.

    Parameters
    ----------
    points : ndarray of shape (N, 77, 3), millimetres
        Points of neutral faces; where and how the head stands does not matter.
    names : tuple of str
        The A attributes wanted.

    Returns
    -------
    ndarray of shape (N, A), float64, millimetres

    Raises
    ------
    ShapeError, ValueRangeError
        If `points` is of another shape or a name is unknown.
    """
    check_shape("points", points, "N", _N_POINTS, 3)
    unknown = [name for name in names if name not in _MEASURES]
    if unknown:
        raise ValueRangeError(f"attribute must be one of {', '.join(ATTRIBUTE_NAMES)}, got {unknown[0]!r}.")
    p = np.asarray(points, dtype=np.float64)
    return np.stack([_MEASURES[name](p) for name in names], axis=-1)


def measure_attributes(vertices: NDArray[np.floating], topology: Topology) -> NDArray[np.float64]:
    """Measure the attributes of neutral meshes.

    Parameters
    ----------
    vertices : ndarray of shape (V, 3) or (N, V, 3), millimetres
        Neutral meshes; where and how the head stands does not matter.
    topology : Topology
        With landmarks of the ``"fw74"`` scheme.

    Returns
    -------
    ndarray of shape (A,) or (N, A), float64, millimetres
        One column per name of ``attribute_names(topology)``.

    Raises
    ------
    TopologyError
        If the topology does not carry the fw74 landmarks.
    ShapeError
        If `vertices` is not of this topology.
    """
    points = attribute_points(vertices, topology)
    measured = measure_points(points if points.ndim == 3 else points[None], attribute_names(topology))
    return measured if vertices.ndim == 3 else measured[0]


def _along(p: Points, axis: int, offset: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the part of `offset` (N, 3) along an axis of the head: 0 to its left, 1 up, 2 forwards.

    Left is from eye to eye, up from the mouth's corners to the eyes: measures do not depend on the head's pose.
    """
    left = _unit(p[:, [35, 39]].mean(axis=1) - p[:, [27, 31]].mean(axis=1))
    up = p[:, [27, 31, 35, 39]].mean(axis=1) - p[:, [54, 60]].mean(axis=1)
    up = _unit(up - (up * left).sum(axis=1, keepdims=True) * left)
    direction = (left, up, np.cross(left, up))[axis]
    return np.asarray((offset * direction).sum(axis=1))


def _above_plane(point: Points, a: Points, b: Points, c: Points) -> NDArray[np.float64]:
    """Return the distance (N,) of points (N, 3) in front of a plane of three, seen counter-clockwise from there."""
    return np.asarray(((point - a) * _unit(np.cross(b - a, c - a))).sum(axis=1))


def _area(ring: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the area (N,) that closed polygons (N, n, 3) enclose."""
    following = np.roll(ring, -1, axis=1)
    return np.asarray(0.5 * np.linalg.norm(np.cross(ring, following).sum(axis=1), axis=-1))


def _unit(vectors: NDArray[np.float64]) -> NDArray[np.float64]:
    return np.asarray(vectors / np.linalg.norm(vectors, axis=-1, keepdims=True))
