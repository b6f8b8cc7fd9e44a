"""Bring all expressions of a person into one head frame: what belongs to the skull holds still."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from facewright.camera.pinhole import RigidMotion
from facewright.errors import DegenerateError
from facewright.faces.face import Face
from facewright.mesh.normals import vertex_normals
from facewright.numeric.check import check_shape
from facewright.numeric.similarity import estimate_similarity

#: A vertex that the expression moves by more than about this tells little of the skull, mm.
_STILL_MM = 0.5
#: Fitted surfaces of the same still skin differ by about this, mm.
_NOISE_MM = 0.4
_ROUNDS = 8


class HeadFrame:
    """Aligns expression meshes with the neutral on forehead, nose bridge and whatever else holds still.

    Parameters
    ----------
    face : Face
        Its skin is used.
    """

    def __init__(self, face: Face) -> None:
        skin = face.skin()
        topology = skin.topology
        self._faces = topology.faces
        self._weights = np.zeros(topology.n_vertices)
        front = topology.masks.get("face_region", np.arange(*topology.parts["face"]))
        self._weights[front] = 1.0
        for name, ids in topology.masks.items():
            if name.startswith(("lips", "eyelid", "lash", "lip_", "lid_")):
                self._weights[ids] = 0.0

    def align(
        self,
        neutral: NDArray[np.float64],
        expression: NDArray[np.float64],
        moved: NDArray[np.float64],
    ) -> RigidMotion:
        """Return the motion that takes an expression mesh into the neutral's head frame.

        Parameters
        ----------
        neutral : ndarray of shape (V, 3), millimetres
            The skin at rest.
        expression : ndarray of shape (V, 3), millimetres
            The skin in the expression, about in place.
        moved : ndarray of shape (V, 3), millimetres
            How the expression is expected to move each vertex: those that it moves count less.

        Raises
        ------
        DegenerateError
            If hardly any vertex holds still.
        """
        check_shape("neutral", neutral, len(self._weights), 3)
        check_shape("expression", expression, len(self._weights), 3)
        check_shape("moved", moved, len(self._weights), 3)
        still = self._weights / (1.0 + (np.linalg.norm(moved, axis=1) / _STILL_MM) ** 2) ** 2
        used = np.flatnonzero(still > 1e-3)
        if still.sum() < 50:
            raise DegenerateError("an expression must leave some of the face still to tell the head's motion.")
        normals = vertex_normals(neutral, self._faces)[used]
        goal = neutral[used] + moved[used]
        source = expression[used]
        motion = estimate_similarity(source, goal, weights=still[used], with_scale=False)
        for _ in range(_ROUNDS):
            off = np.einsum("vc,vc->v", motion.apply(source) - goal, normals)
            robust = 1.0 / (1.0 + (off / _NOISE_MM) ** 2)
            motion = estimate_similarity(source, goal, weights=still[used] * robust, with_scale=False)
        return RigidMotion(motion.rotation, motion.translation)
