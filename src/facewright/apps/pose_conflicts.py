"""Pins that a face cannot meet: one out of reach, or two that contradict each other."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

from facewright.models.region_poser import RegionPoser

#: A pin that is missed by more than this is told, mm.
MISSED_MM = 2.0


def pin_conflicts(
    poser: RegionPoser, pins: Mapping[int, NDArray[np.float64]], zeta: NDArray[np.float64]
) -> tuple[str, ...]:
    """Say in one sentence which pins a pose misses and why; empty where all are met within `MISSED_MM`.

    A pin that is met far better when it is the only one contradicts another; else the model cannot reach it.

    Parameters
    ----------
    poser : RegionPoser
        Its constraints are as before afterwards.
    pins : mapping of int to ndarray of shape (3,), millimetres
    zeta : ndarray of shape (P,)
        The pose.
    """
    if not pins:
        return ()
    vertices = np.array(list(pins), dtype=np.int64)
    targets = np.array([pins[int(v)] for v in vertices])
    missed = np.linalg.norm(poser.positions(zeta)[vertices] - targets, axis=1)
    worst = int(np.argmax(missed))
    if missed[worst] <= MISSED_MM:
        return ()
    vertex = int(vertices[worst])
    if len(vertices) == 1 or _missed_alone(poser, vertex, targets[worst], zeta) > 0.5 * missed[worst]:
        return (f"The pin at vertex {vertex} is out of the face's reach by {missed[worst]:.1f} mm.",)
    away = np.linalg.norm(poser.model.neutral[vertices] - poser.model.neutral[vertex], axis=1)
    away[worst] = np.inf
    other = int(vertices[np.argmin(away)])
    return (
        f"The pins at vertices {vertex} and {other} contradict each other: together they are missed by up to "
        f"{missed[worst]:.1f} mm.",
    )


def _missed_alone(poser: RegionPoser, vertex: int, target: NDArray[np.float64], zeta: NDArray[np.float64]) -> float:
    """Return by how much a pin would be missed if it were the only one, mm."""
    held = poser.constrained.copy()
    poser.set_constraints([vertex])
    alone = poser.solve(target[None], zeta)
    poser.set_constraints(held)
    return float(np.linalg.norm(poser.positions(alone)[vertex] - target))
