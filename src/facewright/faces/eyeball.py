"""Keep eyelids outside the eyeball."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree


def clearance(points: NDArray[np.float64], eyeball: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return how far points (N, 3) lie outside the eyeball along rays from its centre, mm; negative inside.

    Parameters
    ----------
    points : ndarray of shape (N, 3), millimetres
        Any points but the centre.
    eyeball : ndarray of shape (M, 3), millimetres
        Vertices of the closed, star-shaped eyeball.
    """
    centre = eyeball.mean(axis=0)
    arms, rays = eyeball - centre, points - centre
    radius, length = np.linalg.norm(arms, axis=1), np.linalg.norm(rays, axis=1)
    tree = cKDTree(arms / np.maximum(radius, 1e-9)[:, None])
    # The largest of a few nearest directions: an eyeball may have an inner layer.
    nearest = tree.query(rays / np.maximum(length, 1e-9)[:, None], k=min(6, len(arms)))[1]
    return length - radius[nearest.reshape(len(points), -1)].max(axis=1)


def push_outside(
    points: NDArray[np.float64], eyeball: NDArray[np.float64], wanted_mm: NDArray[np.float64] | float
) -> NDArray[np.float64]:
    """Return points (N, 3), those with less than the wanted clearance moved out along rays from the centre."""
    rays = points - eyeball.mean(axis=0)
    lack = np.maximum(wanted_mm - clearance(points, eyeball), 0.0)
    return points + rays * (lack / np.maximum(np.linalg.norm(rays, axis=1), 1e-9))[:, None]
