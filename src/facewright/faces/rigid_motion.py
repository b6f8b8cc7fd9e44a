"""Teeth and eyeballs move rigidly: rotation and translation of each generic blendshape, replayed at any amplitude."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from facewright.faces.face import Face

_STILL_MM = 1e-3


@dataclass(frozen=True, eq=False)
class RigidMotion:
    """One rigid piece and how each blendshape moves it.

    Parameters
    ----------
    vertices : ndarray of shape (N,), int
        The piece's vertices.
    rotations : ndarray of shape (46, 3), float64, radians
        Rotation vector of each blendshape about the piece's centre.
    translations : ndarray of shape (46, 3), float64, millimetres
        Motion of the centre.
    """

    vertices: NDArray[np.intp]
    rotations: NDArray[np.float64]
    translations: NDArray[np.float64]

    def deltas(self, rest: NDArray[np.float64], amplitudes: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return displacements (46, N, 3) of the piece at `rest` (N, 3), each shape at its amplitude."""
        arms = rest - rest.mean(axis=0)
        turns = Rotation.from_rotvec(self.rotations * amplitudes[:, None]).as_matrix()
        turned = np.einsum("bij,nj->bni", turns, arms)
        return turned - arms + (self.translations * amplitudes[:, None])[:, None]


def rigid_vertices(face: Face, name: str) -> NDArray[np.intp]:
    """Return the vertices of a rigid piece: a part, or a mask, of that name."""
    if name in face.topology.parts:
        return np.arange(*face.topology.parts[name])
    return face.topology.masks[name].astype(np.intp)


def rigid_motions(face: Face) -> list[RigidMotion]:
    """Measure the rigid motion of each piece in `face.rigid_parts` from the generic blendshapes (least squares)."""
    return [_measure(face, rigid_vertices(face, name)) for name in face.rigid_parts]


def _measure(face: Face, vertices: NDArray[np.intp]) -> RigidMotion:
    rest = face.mean_shape[vertices].astype(np.float64)
    deltas = face.blendshape_deltas[:, vertices].astype(np.float64)
    arms = rest - rest.mean(axis=0)
    translations = deltas.mean(axis=1)
    rotations = np.zeros_like(translations)
    for i in np.flatnonzero(np.abs(deltas).max(axis=(1, 2)) > _STILL_MM):
        rotations[i] = Rotation.align_vectors(arms + deltas[i] - translations[i], arms)[0].as_rotvec()
    return RigidMotion(vertices, rotations, translations)
