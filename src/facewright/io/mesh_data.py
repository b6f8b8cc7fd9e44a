"""What a mesh file holds: positions, polygons, texture coordinates, colours, the name of a texture."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from facewright.numeric.check import check_indices, check_shape


@dataclass(frozen=True, eq=False)
class MeshData:
    """One mesh as a file gives it; vertices keep the file's order and the file's unit.

    Parameters
    ----------
    vertices : ndarray of shape (V, 3), float32 or float64
        Positions in file order; nothing is merged, split or dropped.
    faces : ndarray of shape (F, 3), int32
        Triangles; polygons of the file are cut into fans from their first corner.
    polygons : ndarray of shape (P, K), int32, or None
        The polygons as written, rows padded with -1 to the longest; None where all are triangles.
    uv : ndarray of shape (U, 2), float32, or None
        Texture coordinates, v upwards.
    uv_faces : ndarray of shape (F, 3), int32, or None
        Indices into `uv` of each row of `faces`.
    uv_polygons : ndarray of shape (P, K), int32, or None
        Indices into `uv` of each row of `polygons`.
    normals : ndarray of shape (V, 3), float32, or None
        Unit normals, where the file gives one per vertex.
    vertex_colors : ndarray of shape (V, 3), uint8, or None
        sRGB colours.
    texture : Path or None
        The picture that the material names; it need not exist.
    """

    vertices: NDArray[np.floating[Any]]
    faces: NDArray[np.int32]
    polygons: NDArray[np.int32] | None = None
    uv: NDArray[np.float32] | None = None
    uv_faces: NDArray[np.int32] | None = None
    uv_polygons: NDArray[np.int32] | None = None
    normals: NDArray[np.float32] | None = None
    vertex_colors: NDArray[np.uint8] | None = None
    texture: Path | None = None

    def __post_init__(self) -> None:
        sizes = check_shape("vertices", self.vertices, "V", 3)
        check_shape("faces", self.faces, "F", 3)
        check_indices("faces", self.faces, sizes["V"])
        if self.uv is not None:
            n_uv = check_shape("uv", self.uv, "U", 2)["U"]
            if self.uv_faces is not None:
                check_shape("uv_faces", self.uv_faces, len(self.faces), 3)
                check_indices("uv_faces", self.uv_faces, n_uv)
        for name in ("normals", "vertex_colors"):
            if getattr(self, name) is not None:
                check_shape(name, getattr(self, name), sizes["V"], 3)

    @property
    def n_vertices(self) -> int:
        """Number of vertices V."""
        return len(self.vertices)


def fan_triangles(counts: NDArray[np.int64]) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Cut polygons of `counts` corners into fans.

    Parameters
    ----------
    counts : ndarray of shape (P,), int
        Corners of each polygon, at least 3, stored one polygon after another.

    Returns
    -------
    corners : ndarray of shape (F, 3), int64
        Positions, in the flat list of all corners, of each triangle's corners.
    polygon : ndarray of shape (F,), int64
        The polygon that each triangle comes from.

    Examples
    --------
    >>> fan_triangles(np.array([3, 4]))[0].tolist()
    [[0, 1, 2], [3, 4, 5], [3, 5, 6]]
    """
    starts = np.cumsum(counts) - counts
    n_triangles = counts - 2
    polygon = np.repeat(np.arange(len(counts)), n_triangles)
    rank = np.arange(len(polygon)) - np.repeat(np.cumsum(n_triangles) - n_triangles, n_triangles)
    first = starts[polygon]
    return np.stack([first, first + rank + 1, first + rank + 2], axis=1), polygon


def pad_polygons(corners: NDArray[np.int64], counts: NDArray[np.int64]) -> NDArray[np.int32]:
    """Arrange a flat list of corners as one row per polygon, padded with -1; the inverse drops the -1.

    Examples
    --------
    >>> pad_polygons(np.array([5, 6, 7, 0, 1, 2, 3]), np.array([3, 4])).tolist()
    [[5, 6, 7, -1], [0, 1, 2, 3]]
    """
    width = int(counts.max(initial=3))
    rows = np.full((len(counts), width), -1, dtype=np.int32)
    rows[np.arange(width) < counts[:, None]] = corners
    return rows
