"""Distances between face meshes: to the surface, and between corresponding vertices, after alignment."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from facewright.mesh.closest_point import closest_points
from facewright.numeric.check import check_indices, check_shape
from facewright.numeric.similarity import estimate_similarity


class MeshDistance(NamedTuple):
    """Mean distances of a mesh from the truth, millimetres.

    Parameters
    ----------
    surface_mm : float
        From the mesh's vertices to the nearest point of the true surface, after the best rigid motion.
    correspondence_mm : float
        Between corresponding vertices, after the same rigid motion.
    similarity_surface_mm, similarity_correspondence_mm : float
        The same after the best similarity: what is left when size, too, is taken from the truth.
    """

    surface_mm: float
    correspondence_mm: float
    similarity_surface_mm: float
    similarity_correspondence_mm: float


def mesh_distance(
    vertices: NDArray[np.floating],
    truth: NDArray[np.floating],
    faces: NDArray[np.integer],
    region: NDArray[np.integer],
) -> MeshDistance:
    """Measure how far a mesh is from the truth over a region.

    Parameters
    ----------
    vertices, truth : ndarray of shape (V, 3), millimetres
        Meshes of one topology.
    faces : ndarray of shape (F, 3)
        Its triangles.
    region : ndarray of int
        Vertices that are aligned and measured.

    Returns
    -------
    MeshDistance
        Means over the region.
    """
    sizes = check_shape("vertices", vertices, "V", 3)
    check_shape("truth", truth, "V", 3, **sizes)
    check_indices("region", region, sizes["V"])
    ours, true = vertices[region].astype(np.float64), truth[region].astype(np.float64)
    distances = []
    for with_scale in (False, True):
        moved = estimate_similarity(ours, true, with_scale=with_scale).apply(ours)
        distances.append(float(closest_points(truth, faces, moved).distances.mean()))
        distances.append(float(np.linalg.norm(moved - true, axis=1).mean()))
    return MeshDistance(*distances)
