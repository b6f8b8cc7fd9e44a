"""What a face is made of: the skin with what is joined to it, pieces that move rigidly, loose geometry."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from facewright.faces.face import Face
from facewright.faces.rigid_motion import RigidMotion, rigid_motions
from facewright.mesh.connectivity import vertex_components

FOLLOW_MM = 4.0
"""Loose geometry (lashes, lacrimal fluid, gums) follows the surface within about this distance, millimetres."""


@dataclass(frozen=True, eq=False)
class FacePieces:
    """How the vertices of a face move.

    Parameters
    ----------
    surface : slice or ndarray of int
        The skin and what its triangles are joined to (mouth cavity, eye sockets): one deforming surface.
    surface_faces : ndarray of shape (F', 3), int
        Triangles of the surface, vertices numbered within the face.
    rigid : list of RigidMotion
        Pieces of `Face.rigid_parts`, in its order, and how each blendshape moves them.
    loose : ndarray of int
        All other vertices.
    """

    surface: slice | NDArray[np.intp]
    surface_faces: NDArray[np.int32]
    rigid: list[RigidMotion]
    loose: NDArray[np.intp]


def face_pieces(face: Face) -> FacePieces:
    """Sort the vertices of a face into surface, rigid pieces and loose geometry."""
    topology = face.topology
    labels = vertex_components(topology.faces, topology.n_vertices)
    surface = np.isin(labels, np.unique(labels[: face.n_skin]))
    ids = np.flatnonzero(surface)
    rigid = rigid_motions(face)
    rigid_ids = np.concatenate([np.empty(0, int), *(motion.vertices for motion in rigid)])
    return FacePieces(
        # A slice where it can be one (skin parts come first), which spares copies of all shapes.
        surface=slice(0, len(ids)) if len(ids) == ids[-1] + 1 else ids,
        surface_faces=topology.faces[surface[topology.faces].all(axis=1)],
        rigid=rigid,
        loose=np.setdiff1d(np.flatnonzero(~surface), rigid_ids),
    )


class Followers:
    """Loose vertices that follow the four nearest points of a surface, less the farther away they are.

    Parameters
    ----------
    surface : ndarray of shape (S, 3), millimetres
        The surface at rest.
    loose : ndarray of shape (L, 3), millimetres
        What follows, at rest.

    Attributes
    ----------
    nearness : ndarray of shape (L,)
        How much of the surface's motion each loose vertex makes: 1 on the surface, 0 far away.
    """

    def __init__(self, surface: NDArray[np.floating], loose: NDArray[np.floating]) -> None:
        distance, self._ids = cKDTree(surface).query(loose, k=4)
        weights = np.exp(-0.5 * (distance / FOLLOW_MM) ** 2)
        nearness = np.exp(-0.5 * (distance[:, :1] / FOLLOW_MM) ** 2) if len(loose) else weights
        self._weights = weights / np.maximum(weights.sum(axis=1, keepdims=True), 1e-12) * nearness
        self.nearness = nearness[:, 0] if len(loose) else np.zeros(0)

    def follow(self, moved: NDArray[np.floating]) -> NDArray[np.float64]:
        """Return how far the loose vertices (..., L, 3) go when the surface moves by `moved` (..., S, 3)."""
        columns = range(self._weights.shape[1])
        return sum(
            (self._weights[:, k, None] * moved[..., self._ids[:, k], :] for k in columns),
            start=np.zeros((*np.shape(moved)[:-2], len(self._ids), 3)),
        )
