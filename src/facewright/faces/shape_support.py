"""Where each blendshape moves a face at all: a personal rig's fit noise beyond it is not motion."""

from __future__ import annotations

from functools import lru_cache

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from facewright.faces.face import Face
from facewright.faces.rigid_motion import rigid_vertices

_LEAST = 0.01  # share of the shape's largest displacement that counts as motion
_FULL_MM, _NONE_MM = 2.0, 10.0  # distance from what moves where a shape counts in full, and where it ends
_UPPER = ("brow", "eye")  # shapes that end with the face's front: hair and ears do not follow brows and lids


@lru_cache(maxsize=2)
def shape_support(face: Face) -> NDArray[np.float32]:
    """Return how far each vertex takes part in each of the face's blendshapes, (B, V) float32 in [0, 1].

    1 where the generic shape moves the vertex, or one within 2 mm, by more than a hundredth of its peak; 0 from 10 mm
    on. Brows and lids end within 10 mm of the face's front as well. A part that moves rigidly takes part as a whole,
    or not at all. Measured on the mean shape, by straight distance, so that lips and lids that meet have the same.
    """
    mean, n = face.mean_shape, face.n_skin
    rising = _near(mean, face.topology.masks["face_region"])
    support = np.empty((len(face.blendshape_names), len(mean)), np.float32)
    for k, (name, delta) in enumerate(zip(face.blendshape_names, face.blendshape_deltas, strict=True)):
        length = np.linalg.norm(delta, axis=1)
        moves = length > _LEAST * length[:n].max()
        support[k] = _near(mean, np.flatnonzero(moves))
        if name.startswith(_UPPER):
            support[k] *= rising
        for part in face.rigid_parts:
            ids = rigid_vertices(face, part)
            support[k, ids] = moves[ids].any()
    support.flags.writeable = False
    return support


def _near(vertices: NDArray[np.float32], ids: NDArray[np.integer]) -> NDArray[np.float32]:
    """Return 1 at and near some vertices, falling smoothly to 0 away from them, (V,)."""
    if not len(ids):
        return np.zeros(len(vertices), np.float32)
    away = cKDTree(vertices[ids]).query(vertices, distance_upper_bound=_NONE_MM)[0]
    t = np.clip((_NONE_MM - away) / (_NONE_MM - _FULL_MM), 0, 1)
    return np.asarray(t * t * (3 - 2 * t), dtype=np.float32)
