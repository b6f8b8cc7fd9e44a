"""How far each eye is closed, measured against the clip's own open eyes."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from facewright.numeric.check import check_shape

#: Points of ``mediapipe478``: middle of the upper lid, of the lower lid, and the corners, of the right and left eye.
_UPPER = ((160, 159, 158), (387, 386, 385))
_LOWER = ((144, 145, 153), (373, 374, 380))
_CORNERS = ((33, 133), (263, 362))
#: The open eye: this quantile of the clip's apertures.
_OPEN_QUANTILE = 0.8
#: Share of the open aperture that the detector has lost, and how far the lid is then closed: it sees the beginning of a
#: blink too small (renders of 44 simulated people).
_LOST = (0.0, 0.08, 0.18, 0.30, 0.50, 0.66)
_CLOSED = (0.0, 0.1, 0.4, 0.6, 0.8, 1.0)


def lid_aperture(points: NDArray[np.floating]) -> NDArray[np.float64]:
    """Return the height of the right and the left eye as a share of its width, (T, 2), of points (T, 478, 2)."""
    check_shape("points", points, "T", 478, 2)
    apertures = []
    for upper, lower, (outer, inner) in zip(_UPPER, _LOWER, _CORNERS, strict=True):
        height = np.linalg.norm(points[:, upper].mean(axis=1) - points[:, lower].mean(axis=1), axis=1)
        apertures.append(height / np.maximum(np.linalg.norm(points[:, outer] - points[:, inner], axis=1), 1e-9))
    return np.stack(apertures, axis=1).astype(np.float64)


def open_aperture(points: NDArray[np.floating]) -> NDArray[np.float64]:
    """Return the aperture of the clip's open eyes, right and left, (2,), of the tracked frames' points (T, 478, 2)."""
    return np.quantile(lid_aperture(points), _OPEN_QUANTILE, axis=0)


def lid_closure(points: NDArray[np.floating], opened: NDArray[np.floating]) -> NDArray[np.float64]:
    """Return how far the right and the left eye are closed, (T, 2) in [0, 1], of points (T, 478, 2)."""
    lost = 1.0 - lid_aperture(points) / np.maximum(opened, 1e-9)
    return np.interp(lost, _LOST, _CLOSED)
