"""The coarse mesh of a face that region-based models are built on: about 400 of its vertices, evenly spread."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from facewright.faces.face import Face
from facewright.faces.performance_region import performance_region
from facewright.mesh.uniform_subsample import subsample_mesh, subsample_mirror

#: As many as in the region-based models' paper, section 4.1.
N_VERTICES = 397


@dataclass(frozen=True, eq=False)
class CoarseFace:
    """N vertices of a face's skin and a mesh among them.

    Parameters
    ----------
    template : str
        Name of the face's topology.
    vertex_ids : ndarray of shape (N,), int32
        Vertices of the face, increasing.
    faces : ndarray of shape (F, 3), int32
        Triangles among the N; mouth and eyes are open.
    positions : ndarray of shape (N, 3), float32, millimetres
        On the mean face.
    mirror : ndarray of shape (N,), int32, or None
        Mirror image of each vertex across x = 0.
    """

    template: str
    vertex_ids: NDArray[np.int32]
    faces: NDArray[np.int32]
    positions: NDArray[np.float32]
    mirror: NDArray[np.int32] | None


@lru_cache(maxsize=8)
def coarse_face(face: Face, n_vertices: int = N_VERTICES) -> CoarseFace:
    """Subsample the acting part of a face (`performance_region`) evenly; the same face always gives the same mesh.

    Raises
    ------
    ValueRangeError
        If so many vertices cannot be joined to a mesh.
    TopologyError
        If the face lacks the landmarks or masks that tell its acting part.
    """
    skin = face.skin()
    topology = skin.topology
    avoid = np.zeros(topology.n_vertices, dtype=bool)
    if "nostril_insides" in topology.masks:
        avoid[topology.masks["nostril_insides"]] = True
    ids, faces = subsample_mesh(
        skin.mean_shape,
        topology.faces,
        n_vertices,
        within=performance_region(face),
        mirror=topology.mirror,
        avoid=avoid,
    )
    mirror = subsample_mirror(ids, topology.mirror)
    return CoarseFace(face.topology.name, ids, faces, skin.mean_shape[ids], mirror)
