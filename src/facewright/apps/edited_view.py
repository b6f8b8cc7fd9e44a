"""How a photo's camera sees its person after a change of attributes."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from facewright.camera.pinhole import RigidMotion
from facewright.mesh.topology import Topology
from facewright.numeric.similarity import estimate_similarity

if TYPE_CHECKING:
    from facewright.apps.photo_subject import PhotoSubject
    from facewright.imaging.mesh_view import MeshView

# Points of fw74 that stay where they are as well as a rigid motion can: temples, ears, eye corners, bridge of the nose.
_ANCHORS = (0, 1, 13, 14, 27, 31, 35, 39, 43)

_WITH_LIPS = ("teeth", "gums_and_tongue")
_RIDGE_MM = 2.0


def edited_view(subject: PhotoSubject, identity_weights: NDArray[np.floating]) -> MeshView:
    """Return the view of a photo's person with other identity weights: same expression, gaze, camera and place.

    The new head is put where the old one is by its eyes, ears and temples, so that a longer face has its chin lower
    and not its eyes higher; where the model's own frame puts it would move everything a little.

    Parameters
    ----------
    subject : PhotoSubject
        The person.
    identity_weights : ndarray of shape (I,)
        The new ones.
    """
    if np.array_equal(identity_weights, subject.fit.identity_weights):
        return subject.source  # no change gives the photo back to the last bit
    rest = np.zeros_like(subject.weights)
    neutral = subject.vertices(identity_weights=identity_weights, weights=rest)
    place = same_place(neutral, subject.rig.neutral, subject.face.topology)
    vertices = teeth_with_lips(
        subject.vertices(identity_weights=identity_weights), subject.vertices(), subject.face.topology
    )
    return subject.view(vertices, subject.camera_from_model.after(place))


def teeth_with_lips(new: NDArray[np.floating], old: NDArray[np.floating], topology: Topology) -> NDArray[np.float64]:
    """Return changed vertices (V, 3) whose teeth, gums and tongue follow the lips' inner rims affinely.

    Teeth of their own place would show between the same lips a dark gap below them, or gums above, which the photo
    does not; the expression, and with it what a mouth shows, is not what was asked to change.
    """
    result = np.array(new, dtype=np.float64)
    lips = np.concatenate(
        [topology.masks.get(f"lip_contact_{side}", np.zeros(0, np.int32)) for side in ("upper", "lower")]
    )
    inside = [slice(*span) for name, span in topology.parts.items() if name.startswith(_WITH_LIPS)]
    if not len(lips) or not inside:
        return result
    middle, target = old[lips].mean(axis=0), result[lips].mean(axis=0)
    before, after = old[lips] - middle, result[lips] - target
    # towards the unchanged shape where the lips, thin as they are, do not tell
    ridge = _RIDGE_MM**2 * len(lips) * np.eye(3)
    linear = np.linalg.solve(before.T @ before + ridge, before.T @ after + ridge)
    for part in inside:
        result[part] = (old[part] - middle) @ linear + target
    return result


def same_place(new: NDArray[np.floating], old: NDArray[np.floating], topology: Topology) -> RigidMotion:
    """Return the motion that puts a neutral face (V, 3) where another of its topology is, by eyes, ears and temples."""
    ids = topology.landmarks["fw74"][list(_ANCHORS)]
    fit = estimate_similarity(new[ids], old[ids], with_scale=False)
    return RigidMotion(fit.rotation, fit.translation)
