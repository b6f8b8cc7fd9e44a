"""Depth maps as points: back-projection, normals, and looking depth up between pixels."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from facewright.camera.pinhole import Intrinsics
from facewright.numeric.check import check_shape


def back_project(depth: NDArray[np.floating], intrinsics: Intrinsics) -> NDArray[np.float64]:
    """Return the point that each pixel sees, in the camera's frame.

    Parameters
    ----------
    depth : ndarray of shape (H, W), millimetres
        Distance along the optical axis; 0 where there is none.
    intrinsics : Intrinsics
        The camera.

    Returns
    -------
    ndarray of shape (H, W, 3), float64, millimetres
        Points; NaN where there is no depth.

    Raises
    ------
    ShapeError
        If `depth` is not (H, W).
    """
    sizes = check_shape("depth", depth, "H", "W")
    z = np.where(depth > 0, depth, np.nan).astype(np.float64)
    x = (np.arange(sizes["W"]) - intrinsics.centre_x) / intrinsics.focal_x
    y = (np.arange(sizes["H"]) - intrinsics.centre_y) / intrinsics.focal_y
    return np.stack([z * x[None, :], z * y[:, None], z], axis=2)


def depth_normals(points: NDArray[np.floating], step_mm: float = 10.0) -> NDArray[np.float64]:
    """Return the unit normal of each pixel of a point map, towards the camera.

    Parameters
    ----------
    points : ndarray of shape (H, W, 3), millimetres
        From `back_project`; NaN where there is none.
    step_mm : float
        Neighbours whose depth differs by more are on another surface.

    Returns
    -------
    ndarray of shape (H, W, 3), float64
        Normals by central differences; NaN at borders, holes and steps of depth.

    Raises
    ------
    ShapeError
        If `points` is not (H, W, 3).
    """
    check_shape("points", points, "H", "W", 3)
    normals = np.full(points.shape, np.nan)
    across = points[1:-1, 2:] - points[1:-1, :-2]
    down = points[2:, 1:-1] - points[:-2, 1:-1]
    step = (np.abs(across[..., 2]) > 2 * step_mm) | (np.abs(down[..., 2]) > 2 * step_mm)
    n = np.cross(down, across)
    with np.errstate(invalid="ignore", divide="ignore"):
        n /= np.linalg.norm(n, axis=2, keepdims=True)
    n[step | ~np.isfinite(points[1:-1, 1:-1, 2])] = np.nan
    normals[1:-1, 1:-1] = n
    return normals
