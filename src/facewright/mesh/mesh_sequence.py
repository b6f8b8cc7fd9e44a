"""A mesh of one topology that moves: one array of vertices for each moment."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from facewright.errors import ValueRangeError
from facewright.numeric.check import check_finite, check_indices, check_shape


@dataclass(frozen=True, eq=False)
class MeshSequence:
    """T meshes of one topology.

    Parameters
    ----------
    times : ndarray of shape (T,), float64, seconds
        Strictly increasing.
    vertices : ndarray of shape (T, N, 3), float32, millimetres
    faces : ndarray of shape (F, 3), int32

    Raises
    ------
    ShapeError, ValueRangeError
        If arrays do not match, a value is not finite, an index is out of range or times do not increase.
    """

    times: NDArray[np.float64]
    vertices: NDArray[np.float32]
    faces: NDArray[np.int32]

    def __post_init__(self) -> None:
        sizes = check_shape("times", self.times, "T")
        sizes = check_shape("vertices", self.vertices, "T", "N", 3, **sizes)
        check_shape("faces", self.faces, "F", 3)
        check_finite("times", self.times)
        check_finite("vertices", self.vertices)
        check_indices("faces", self.faces, sizes["N"])
        if (np.diff(self.times) <= 0).any():
            raise ValueRangeError("times must increase from frame to frame, got one that does not.")

    @property
    def n_frames(self) -> int:
        """Number of moments T."""
        return len(self.times)
