"""What a template is fitted to: points with normals of one scan, and its landmarks in 3D and 2D."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from facewright.camera.pinhole import Intrinsics
from facewright.numeric.check import check_finite, check_shape


@dataclass(frozen=True, eq=False)
class ScanTarget:
    """One scan in its own frame (the camera's, for a depth map), in millimetres.

    Parameters
    ----------
    points : ndarray of shape (N, 3), float64, millimetres
        Points of the surface, finite.
    normals : ndarray of shape (N, 3), float64
        Their unit normals, outwards (towards the camera).
    faces : ndarray of shape (F, 3), int32
        Triangles between the points, so that closest points lie on the surface and not only at its samples.
    landmarks : ndarray of shape (74, 3), float64, millimetres
        ``fw74`` landmarks; NaN where there is none in 3D, as for contour points.
    confidence : ndarray of shape (74,), float64
        Weight of each landmark in [0, 1], 3D or 2D; 0 where there is none.
    contour_pixels : ndarray of shape (74, 2), float64, pixels, or None
        2D landmarks of the picture (NaN where missing), for the sliding contour term; None for a plain scan.
    intrinsics : Intrinsics or None
        Camera of `contour_pixels` (z forward, y down); None for a plain scan.
    """

    points: NDArray[np.float64]
    normals: NDArray[np.float64]
    faces: NDArray[np.int32]
    landmarks: NDArray[np.float64]
    confidence: NDArray[np.float64]
    contour_pixels: NDArray[np.float64] | None = None
    intrinsics: Intrinsics | None = None

    def __post_init__(self) -> None:
        sizes = check_shape("points", self.points, "N", 3)
        check_shape("normals", self.normals, "N", 3, **sizes)
        check_shape("faces", self.faces, "F", 3)
        check_shape("landmarks", self.landmarks, 74, 3)
        check_shape("confidence", self.confidence, 74)
        if self.contour_pixels is not None:
            check_shape("contour_pixels", self.contour_pixels, 74, 2)
        check_finite("points", self.points)
        check_finite("normals", self.normals)
