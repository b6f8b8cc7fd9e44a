"""Closing lids slide over the eyeballs, where a face has eyeballs."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from facewright.faces.contact import Contact
from facewright.faces.eyeball import clearance, push_outside
from facewright.faces.face import Face
from facewright.faces.rigid_motion import rigid_vertices

LID_GAP = 0.2
"""What is left of the gap of the generic closed lids (1 mm on ICT-FaceKit)."""

_LID_CLEARANCE_MM = 1.0


class _Eye(NamedTuple):
    side: str
    lid: NDArray[np.int32]
    ball: NDArray[np.intp]


class Lids:
    """The upper lids of a face, what they slide over and where they meet the lower ones.

    Parameters
    ----------
    face : Face
        The generic face, whose lids set the example.
    contacts : dict of str to Contact
        Of `face_contacts`.
    """

    def __init__(self, face: Face, contacts: dict[str, Contact]) -> None:
        self._face = face
        self._contacts = contacts
        lids = {side: face.topology.masks.get(f"eyelid_upper_{side}", np.empty(0, int)) for side in ("left", "right")}
        self._eyes = [
            _Eye(side, lids[side], rigid_vertices(face, part))
            for part, kind in face.rigid_parts.items()
            if kind == "eye" and len(lids.get(side := part.rpartition("_")[2], ()))
        ]

    def close(self, lid: str, side: str, rest: NDArray[np.float64], deltas: NDArray[np.float64], shape: int) -> None:
        """Let the upper or lower lid of one side meet the other in blendshape `shape` of `deltas` (B, V, 3)."""
        contact = self._contacts.get(f"{lid}_lid_{side}")
        if contact is not None:
            wanted = LID_GAP * contact.offsets(
                self._face.mean_shape + self._face.blendshape_deltas[shape].astype(float)
            )
            contact.change(deltas[shape], wanted - contact.offsets(rest + deltas[shape]))

    def clear(self, rest: NDArray[np.float64], deltas: NDArray[np.float64]) -> None:
        """Lift the upper lids of closing shapes off the eyeballs, in place.

        Parameters
        ----------
        rest : ndarray of shape (V, 3), millimetres
            The person at rest, all parts.
        deltas : ndarray of shape (46, V, 3), millimetres
            Displacements of the blendshapes, eyeballs included.
        """
        names = self._face.blendshape_names
        for eye in self._eyes:
            for shape in (f"eyeBlink_{eye.side[0].upper()}", "eyesLookDown"):
                if shape in names:
                    i = names.index(shape)
                    generic = self._face.mean_shape + self._face.blendshape_deltas[i].astype(np.float64)
                    deltas[i] = self._lifted(eye, rest + deltas[i], generic) - rest
                    if shape.startswith("eyeBlink"):
                        self.close("lower", eye.side, rest, deltas, i)

    def lifted(self, posed: NDArray[np.float64], generic: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return a posed person (V, 3) whose lids are at least as clear of the eyeballs as the generic face's are.

        Parameters
        ----------
        posed : ndarray of shape (V, 3), millimetres
            The person, all parts.
        generic : ndarray of shape (V, 3), millimetres
            The generic face in the same pose.
        """
        for eye in self._eyes:
            posed = self._lifted(eye, posed, generic)
        return posed

    @staticmethod
    def _lifted(eye: _Eye, posed: NDArray[np.float64], generic: NDArray[np.float64]) -> NDArray[np.float64]:
        # As far outside as the generic lid is; more would tear it from the lower lid.
        wanted = np.minimum(clearance(generic[eye.lid], generic[eye.ball]), _LID_CLEARANCE_MM)
        result = posed.copy()
        result[eye.lid] = push_outside(posed[eye.lid], posed[eye.ball], wanted)
        return result
