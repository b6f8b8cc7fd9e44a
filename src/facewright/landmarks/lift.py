"""Landmarks of a picture in 3D, by the depth at their pixels."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from facewright.camera.pinhole import Intrinsics
from facewright.landmarks.points import Landmarks
from facewright.landmarks.scheme import load_scheme
from facewright.numeric.check import check_shape

#: Depths of a landmark's surroundings, in pixels each way.
_REACH = 2
#: Of the surroundings, what lies this far behind their front is another surface (teeth behind a lip).
_STEP_MM = 6.0
#: A landmark is lifted where at least this share of its surroundings belongs to its surface.
_SHARE = 0.7


def lift_landmarks(
    landmarks: Landmarks, depth: NDArray[np.floating], intrinsics: Intrinsics
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Find the 3D positions of internal landmarks from a depth map of the same picture (FaceWarehouse 3.2).

    A plane is fitted to the depths within two pixels and read at the landmark. Where a step of depth runs through
    these surroundings (the rim of an open mouth, a wing of the nose against the cheek) or depth is missing, the
    landmark's own depth is not known: it stays 2D. Contour points always stay 2D.

    Parameters
    ----------
    landmarks : Landmarks
        Points of the picture, converted to ``fw74`` where they are of another scheme.
    depth : ndarray of shape (H, W), millimetres
        Distance along the optical axis, 0 where there is none.
    intrinsics : Intrinsics
        The camera of both.

    Returns
    -------
    points : ndarray of shape (74, 3), float64, millimetres
        Positions in the camera's frame; NaN where there is no depth to rely on, and for contour points.
    confidence : ndarray of shape (74,), float64
        The landmarks' own; also of those that stay 2D. 0 for missing points.

    Raises
    ------
    ShapeError
        If `depth` is not (H, W).
    """
    sizes = check_shape("depth", depth, "H", "W")
    found = landmarks if landmarks.scheme == "fw74" else landmarks.convert("fw74")
    pixels = np.where(np.isfinite(found.points), found.points, -1e6)
    steps = np.arange(-_REACH, _REACH + 1)
    dx, dy = (grid.ravel() for grid in np.meshgrid(steps, steps))
    column = np.rint(pixels[:, :1]).astype(np.int64) + dx  # (74, 25)
    row = np.rint(pixels[:, 1:]).astype(np.int64) + dy
    inside = (column >= 0) & (column < sizes["W"]) & (row >= 0) & (row < sizes["H"])
    z = np.where(inside, depth[np.where(inside, row, 0), np.where(inside, column, 0)], 0.0).astype(np.float64)
    valid = z > 0
    front = np.where(valid, z, np.inf).min(axis=1, keepdims=True)
    near = valid & (z <= np.where(np.isfinite(front), front, 0.0) + _STEP_MM)
    offset = np.stack([column - pixels[:, :1], row - pixels[:, 1:], np.ones(z.shape)], axis=2)
    A = np.einsum("lni,lnj,ln->lij", offset, offset, near.astype(np.float64)) + 1e-6 * np.eye(3)
    b = np.einsum("lni,ln->li", offset, np.where(near, z, 0.0))
    at = np.linalg.solve(A, b[..., None])[:, 2, 0]
    lifted = found.present & (near.mean(axis=1) >= _SHARE)
    lifted[load_scheme("fw74").sliding] = False
    points = np.stack(
        [
            (pixels[:, 0] - intrinsics.centre_x) / intrinsics.focal_x * at,
            (pixels[:, 1] - intrinsics.centre_y) / intrinsics.focal_y * at,
            at,
        ],
        axis=1,
    )
    points[~lifted] = np.nan
    return points, found.confidence.copy()
