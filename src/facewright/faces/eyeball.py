"""Keep eyelids outside the eyeball."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

_CLEARANCE_MM = 1.0  # lid triangles are coarser than the cornea, and cut its corners


def push_outside(lid: NDArray[np.float64], eyeball: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return lid vertices (N, 3), moved along rays from the eyeball's centre to clear its surface where they do not.

    Parameters
    ----------
    lid : ndarray of shape (N, 3), millimetres
        Lid vertices. Not modified.
    eyeball : ndarray of shape (M, 3), millimetres
        Vertices of the closed, star-shaped eyeball.
    """
    centre = eyeball.mean(axis=0)
    arms = eyeball - centre
    radius = np.linalg.norm(arms, axis=1)
    rays = lid - centre
    length = np.linalg.norm(rays, axis=1)
    directions = rays / np.maximum(length, 1e-9)[:, None]
    # The largest of a few nearest directions: an eyeball may have an inner layer.
    nearest = cKDTree(arms / np.maximum(radius, 1e-9)[:, None]).query(directions, k=min(6, len(arms)))[1]
    surface = radius[nearest.reshape(len(lid), -1)].max(axis=1)
    return centre + directions * np.maximum(length, surface + _CLEARANCE_MM)[:, None]
