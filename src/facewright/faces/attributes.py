"""Attributes of a face that people have words for, measured from its geometry."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from facewright.errors import TopologyError
from facewright.mesh.topology import Topology
from facewright.numeric.check import check_shape

Points = NDArray[np.floating]


def _distance(i: int, j: int) -> Callable[[Points], NDArray[np.floating]]:
    return lambda p: np.linalg.norm(p[..., i, :] - p[..., j, :], axis=-1)


def _mean(*measures: Callable[[Points], NDArray[np.floating]]) -> Callable[[Points], NDArray[np.floating]]:
    return lambda p: np.mean([m(p) for m in measures], axis=0)


# points of the fw74 scheme; distances in millimetres on the neutral mesh
_MEASURES: dict[str, Callable[[Points], NDArray[np.floating]]] = {
    "face length": _distance(43, 7),
    "face width": _distance(1, 13),
    "jaw width": _distance(4, 10),
    "chin height": _distance(63, 7),
    "mouth width": _distance(54, 60),
    "lip thickness": _mean(_distance(57, 68), _distance(63, 72)),
    "nose length": _distance(43, 49),
    "nose width": _distance(46, 52),
    "nose height": lambda p: p[..., 45, 2] - 0.5 * (p[..., 47, 2] + p[..., 51, 2]),
    "eye size": _mean(_distance(27, 31), _distance(35, 39)),
    "eye spacing": _distance(31, 39),
    "brow height": lambda p: 0.5 * (p[..., [19, 25], 1].sum(-1)) - 0.5 * (p[..., [29, 37], 1].sum(-1)),
}

ATTRIBUTE_NAMES: tuple[str, ...] = tuple(_MEASURES)


def measure_attributes(vertices: NDArray[np.floating], topology: Topology) -> NDArray[np.float64]:
    """Measure the named attributes (`ATTRIBUTE_NAMES`) of neutral meshes.

    Parameters
    ----------
    vertices : ndarray of shape (V, 3) or (N, V, 3), millimetres
        Neutral meshes in model space.
    topology : Topology
        With landmarks of the ``"fw74"`` scheme.

    Returns
    -------
    ndarray of shape (A,) or (N, A), float64, millimetres
        One column per name of `ATTRIBUTE_NAMES`.

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
    points = np.asarray(batch[:, ids], dtype=np.float64)
    measured = np.stack([np.asarray(measure(points)) for measure in _MEASURES.values()], axis=-1)
    return measured if vertices.ndim == 3 else measured[0]
