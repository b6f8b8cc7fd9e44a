"""A fused depth map and its landmarks as something a template is fitted to."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from facewright.camera.depth_map import back_project, depth_normals
from facewright.camera.pinhole import Intrinsics
from facewright.errors import NoFaceError
from facewright.fitting.scan_target import ScanTarget
from facewright.landmarks.lift import lift_landmarks
from facewright.landmarks.points import Landmarks
from facewright.numeric.check import check_shape

#: The part of the picture that is kept: the landmarks' box, wider by these shares of its size at each side (room for
#: the cheeks), above (the forehead) and below.
_MARGIN_SIDES, _MARGIN_ABOVE, _MARGIN_BELOW = 0.2, 0.45, 0.15
#: Points further than this from the landmarks' median depth are not the head.
_HEAD_MM = 180.0
#: Neighbours whose depths differ by more are not joined by a triangle.
_STEP_MM = 6.0
_LEAST_POINTS = 500


def depth_target(depth: NDArray[np.floating], intrinsics: Intrinsics, landmarks: Landmarks) -> ScanTarget:
    """Make a target of a depth map: points, normals and triangles in the camera's frame, landmarks lifted by the depth.

    Parameters
    ----------
    depth : ndarray of shape (H, W), millimetres
        Smooth depth along the optical axis; 0 where there is none.
    intrinsics : Intrinsics
        Camera of the depth map and of the landmarks.
    landmarks : Landmarks
        Of the reference picture, in any scheme that converts to ``fw74``.

    Returns
    -------
    ScanTarget
        With `contour_pixels` holding all 2D landmarks, so that those without depth still count in the picture.

    Raises
    ------
    ShapeError
        If `depth` is not (H, W).
    NoFaceError
        If there are no landmarks, or hardly any depth at them.
    """
    sizes = check_shape("depth", depth, "H", "W")
    found = landmarks if landmarks.scheme == "fw74" else landmarks.convert("fw74")
    if found.present.sum() < 4:
        raise NoFaceError(f"at least 4 landmarks must be found in the picture, got {int(found.present.sum())}.")
    points3d, confidence = lift_landmarks(found, depth, intrinsics)
    left, top, right, bottom = found.box
    wide, high = _MARGIN_SIDES * (right - left), bottom - top
    x0, x1 = max(int(left - wide), 0), min(int(right + wide) + 1, sizes["W"])
    y0, y1 = max(int(top - _MARGIN_ABOVE * high), 0), min(int(bottom + _MARGIN_BELOW * high) + 1, sizes["H"])
    part = np.zeros((max(y1 - y0, 0), max(x1 - x0, 0))) if y1 <= y0 or x1 <= x0 else depth[y0:y1, x0:x1]
    middle = np.median(points3d[:, 2][np.isfinite(points3d[:, 2])]) if np.isfinite(points3d).any() else np.nan
    grid = back_project(
        np.where(np.abs(part - middle) <= _HEAD_MM, part, 0.0),
        Intrinsics(intrinsics.focal_x, intrinsics.focal_y, intrinsics.centre_x - x0, intrinsics.centre_y - y0),
    )
    normals = depth_normals(grid) if min(part.shape) >= 3 else np.full(grid.shape, np.nan)
    valid = np.isfinite(normals[..., 0]) & np.isfinite(grid[..., 2])
    if int(valid.sum()) < _LEAST_POINTS:
        raise NoFaceError(
            f"the depth map must show a face at the landmarks, got {int(valid.sum())} points there "
            f"(at least {_LEAST_POINTS} are needed): check that depth and picture belong together."
        )
    number = np.cumsum(valid.ravel()).reshape(valid.shape) - 1
    return ScanTarget(
        points=grid[valid],
        normals=normals[valid],
        faces=_grid_triangles(valid, grid[..., 2], number),
        landmarks=points3d,
        confidence=confidence,
        contour_pixels=found.points.copy(),
        intrinsics=intrinsics,
    )


def _grid_triangles(valid: NDArray[np.bool_], z: NDArray[np.float64], number: NDArray[np.int64]) -> NDArray[np.int32]:
    """Join neighbouring pixels on one surface: (F, 3) rows into the valid pixels, front side towards the camera."""
    corners = [np.s_[:-1, :-1], np.s_[1:, :-1], np.s_[1:, 1:], np.s_[:-1, 1:]]  # counter-clockwise as seen
    known = [valid[c] for c in corners]
    depth = [np.where(valid[c], z[c], 0.0) for c in corners]
    ids = [number[c] for c in corners]
    triangles = []
    for a, b, c in ((0, 1, 2), (0, 2, 3)):
        spread = np.maximum(np.maximum(depth[a], depth[b]), depth[c]) - np.minimum(
            np.minimum(depth[a], depth[b]), depth[c]
        )
        keep = known[a] & known[b] & known[c] & (spread <= _STEP_MM)
        triangles.append(np.stack([ids[a][keep], ids[b][keep], ids[c][keep]], axis=1))
    return np.ascontiguousarray(np.concatenate(triangles), dtype=np.int32)
