"""From fitted expression meshes to a person's 46 blendshapes, all parts of the face included."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from facewright.deform.acted_weights import ActingPrior
from facewright.deform.deformation_transfer import DeformationTransfer
from facewright.deform.example_based_rigging import RigFitter
from facewright.faces.attach_parts import parts_attacher
from facewright.faces.blendshape_names import coupled_shapes
from facewright.faces.face import Face
from facewright.numeric.check import check_shape

#: Fitted meshes move by 0.4 to 0.9 mm otherwise than the person (simulated people, detected landmarks), so that what
#: they say of a shape's form counts less than in `deform.example_based_rigging`, whose defaults suit 0.25 mm.
_PRIOR = ActingPrior(surface_noise_mm=0.8)
_BETAS = (0.1, 0.03)


@dataclass(frozen=True, eq=False)
class PersonalRig:
    """A person's meshes and blendshapes with all parts of the face.

    Parameters
    ----------
    meshes : ndarray of shape (S, V, 3), float64, millimetres
        The expressions, the neutral first.
    deltas : ndarray of shape (46, V, 3), float64, millimetres
        Blendshapes as displacements from the neutral.
    weights : ndarray of shape (S, 46), float64
        Blendshape weights that each expression was acted with, zeros for the neutral.
    amplitudes : ndarray of shape (46,), float64
        How far the person goes with each shape relative to the generic one.
    residuals_mm : ndarray of shape (S,), float64
        Root mean square distance of each expression's skin (part ``face``) from the rig in its pose.
    """

    meshes: NDArray[np.float64]
    deltas: NDArray[np.float64]
    weights: NDArray[np.float64]
    amplitudes: NDArray[np.float64]
    residuals_mm: NDArray[np.float64]


def fit_personal_rig(face: Face, skins: NDArray[np.floating[Any]], guide: NDArray[np.floating[Any]]) -> PersonalRig:
    """Recover the blendshapes of a person from skins in one head frame (FaceWarehouse 3.2.3) and attach all parts.

    Parameters
    ----------
    face : Face
        All parts of it.
    skins : ndarray of shape (S, V_skin, 3), millimetres
        Fitted skins, the neutral first.
    guide : ndarray of shape (S, 46)
        Blendshape weights that were asked for, zeros for the neutral.

    Raises
    ------
    ShapeError, ValueRangeError
        If shapes do not fit or values are not finite.
    """
    sizes = check_shape("skins", skins, "S", face.n_skin, 3)
    check_shape("guide", guide, "S", len(face.blendshape_names), **sizes)
    skin = face.skin()
    faces = skin.topology.faces
    mean = skin.mean_shape.astype(np.float64)
    rest = np.asarray(skins[0], dtype=np.float64)
    generic = DeformationTransfer(mean, rest, faces).transfer(mean + skin.blendshape_deltas) - rest
    fitter = RigFitter(rest, generic, faces, coupled=coupled_shapes(face.blendshape_names), prior=_PRIOR)
    rig = fitter.fit(skins[1:], guide[1:], betas=_BETAS)
    weights = np.concatenate([np.zeros((1, len(generic))), rig.weights])
    judged = slice(*skin.topology.parts["face"])
    fitted = rest[judged] + np.tensordot(weights, rig.deltas[:, judged], 1)
    residuals = np.sqrt(((skins[:, judged] - fitted) ** 2).sum(axis=2).mean(axis=1))
    attacher = parts_attacher(face)
    neutral = attacher.neutral(rest)
    deltas = attacher.blendshapes(neutral, rig.deltas, rig.amplitudes)
    meshes = np.stack(
        [neutral] + [attacher.expression(neutral, deltas, s, w, rig.amplitudes) for s, w in zip(skins[1:], weights[1:])]
    )
    return PersonalRig(meshes, deltas, weights, rig.amplitudes, residuals)
