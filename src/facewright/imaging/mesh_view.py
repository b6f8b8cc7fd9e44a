"""A mesh as one camera sees it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from facewright.numeric.check import check_finite, check_shape


@dataclass(frozen=True, eq=False)
class MeshView:
    """Where the vertices of a mesh lie in a picture, and how far away.

    Parameters
    ----------
    pixels : ndarray of shape (V, 2), float64, pixels
        Projected vertices; x right, y down, the centre of the first pixel is (0, 0).
    camera_vertices : ndarray of shape (V, 3), float64, millimetres
        Vertices in the camera's axes (x right, y down, z away): for visibility and shading.
    perspective : bool
        Whether `pixels` come from a pinhole (else weak perspective).

    Raises
    ------
    ShapeError, ValueRangeError
        If the arrays do not match or hold a value that is not finite.
    """

    pixels: NDArray[np.float64]
    camera_vertices: NDArray[np.float64]
    perspective: bool = True

    def __post_init__(self) -> None:
        sizes = check_shape("pixels", self.pixels, "V", 2)
        check_shape("camera_vertices", self.camera_vertices, "V", 3, **sizes)
        check_finite("pixels", self.pixels)
        check_finite("camera_vertices", self.camera_vertices)

    @property
    def depth(self) -> NDArray[np.float64]:
        """Distance of each vertex along the optical axis, (V,), millimetres."""
        return self.camera_vertices[:, 2]
