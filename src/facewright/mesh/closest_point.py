"""Closest points on a triangle mesh."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from facewright.errors import DegenerateError, ValueRangeError
from facewright.numeric.check import check_finite, check_indices, check_shape
from facewright.numeric.threads import for_blocks

_LEAF_SIZE = 4
_POINT_BLOCK = 1024


class SurfacePoints(NamedTuple):
    """Points on a mesh: triangle (N,), barycentric coordinates (N, 3), position (N, 3), distance (N,) mm."""

    faces: NDArray[np.int64]
    barycentric: NDArray[np.float64]
    points: NDArray[np.float64]
    distances: NDArray[np.float64]


class ClosestPoints:
    """Search closest points on a mesh, with a bounding volume hierarchy that is built once.

    Parameters
    ----------
    vertices : ndarray of shape (V, 3), millimetres
        Positions.
    faces : ndarray of shape (F, 3), int
        Triangles, at least one; flat ones are allowed.

    Raises
    ------
    ShapeError, ValueRangeError
        If shapes are wrong, positions are not finite or an index is outside [0, V).
    DegenerateError
        If there are no triangles.
    """

    def __init__(self, vertices: NDArray[np.floating[Any]], faces: NDArray[np.integer[Any]]) -> None:
        from facewright.mesh._closest_kernels import build_tree

        V = check_shape("vertices", vertices, "V", 3)["V"]
        check_shape("faces", faces, "F", 3)
        check_indices("faces", faces, V)
        check_finite("vertices", vertices)
        if not len(faces):
            raise DegenerateError("faces must hold at least one triangle, got none.")
        self._corners = np.ascontiguousarray(np.asarray(vertices, dtype=np.float64)[faces])
        low, high = self._corners.min(axis=1), self._corners.max(axis=1)
        self._order = np.arange(len(faces))
        boxes = np.concatenate([low, high], axis=1)
        self._nodes, self._ranges = build_tree(boxes, self._corners.mean(axis=1), self._order, _LEAF_SIZE)

    def query(self, points: NDArray[np.floating[Any]], limit_mm: float = np.inf) -> SurfacePoints:
        """Return the point of the mesh nearest to each point.

        Parameters
        ----------
        points : ndarray of shape (N, 3), millimetres
            Where to search from.
        limit_mm : float
            Look no further, mm: faster where only near points matter.

        Returns
        -------
        SurfacePoints
            `faces` is -1, `points` NaN and `distances` infinite where nothing lies within the limit.

        Raises
        ------
        ShapeError, ValueRangeError
            If `points` is not (N, 3) or not finite, or the limit is not positive.
        """
        from facewright.mesh._closest_kernels import query_tree

        N = check_shape("points", points, "N", 3)["N"]
        check_finite("points", points)
        if not limit_mm > 0:
            raise ValueRangeError(f"limit_mm must be positive, got {limit_mm}.")
        targets = np.ascontiguousarray(points, dtype=np.float64)
        faces = np.full(N, -1, dtype=np.int64)
        weights = np.zeros((N, 3))
        squared = np.full(N, float(limit_mm) ** 2)

        def query_block(start: int, stop: int) -> None:
            part = slice(start, stop)
            query_tree(
                self._nodes,
                self._ranges,
                self._order,
                self._corners,
                targets[part],
                faces[part],
                weights[part],
                squared[part],
            )

        for_blocks(N, _POINT_BLOCK, query_block)
        found = faces >= 0
        positions = np.einsum("nk,nkx->nx", weights, self._corners[faces])
        positions[~found] = np.nan
        return SurfacePoints(faces, weights, positions, np.where(found, np.sqrt(squared), np.inf))


def closest_points(
    vertices: NDArray[np.floating[Any]],
    faces: NDArray[np.integer[Any]],
    points: NDArray[np.floating[Any]],
) -> SurfacePoints:
    """Return the points of a mesh nearest to `points` (N, 3) once; see `ClosestPoints`."""
    return ClosestPoints(vertices, faces).query(points)
