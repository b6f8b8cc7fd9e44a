"""Pictures of simulated people with everything known: shape, camera, landmarks, and a rendering for detectors."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from facewright.apps.true_landmarks import true_landmarks
from facewright.camera.pinhole import Intrinsics, RigidMotion
from facewright.camera.rotation import rotation_from_head_angles
from facewright.faces.expressions import random_expression_weights
from facewright.faces.face import Face
from facewright.faces.simulate import simulate_person
from facewright.landmarks.points import Landmarks

#: Limits of the head's pose, degrees, and of the camera, from its centre to the head's.
YAW, PITCH, ROLL = 35.0, 20.0, 20.0
DISTANCE_MM = (450.0, 1500.0)
#: Height of the head (about 240 mm) as a share of the picture's height.
HEAD_SHARE = (0.45, 0.75)
IMAGE_SIZE = (640, 640)
_HEAD_MM = 240.0


@dataclass(frozen=True, eq=False)
class SimulatedPhoto:
    """A simulated person before a camera.

    Parameters
    ----------
    vertices : ndarray of shape (V, 3), float32, millimetres
        The posed person, all parts of the face, in model space.
    intrinsics : Intrinsics
        The camera.
    camera_from_model : RigidMotion
        The head's pose.
    landmarks : Landmarks
        True ``fw74`` landmarks: vertices projected, contour points on the outline of the face's region.
    image_size : (height, width)
        Size of the picture.
    blendshape_weights : ndarray of shape (46,)
        The expression.
    """

    vertices: NDArray[np.float32]
    intrinsics: Intrinsics
    camera_from_model: RigidMotion
    landmarks: Landmarks
    image_size: tuple[int, int]
    blendshape_weights: NDArray[np.float64]

    def noisy_landmarks(self, noise_px: float, rng: np.random.Generator) -> Landmarks:
        """Return the landmarks with Gaussian noise of `noise_px` per coordinate."""
        points = self.landmarks.points
        return Landmarks(self.landmarks.scheme, points + rng.normal(0.0, noise_px, points.shape))


def simulate_photo(face: Face, rng: np.random.Generator) -> SimulatedPhoto:
    """Draw a person, an expression, a pose and a perspective camera.

    Parameters
    ----------
    face : Face
        All parts of it, if the picture shall be rendered.
    rng : numpy.random.Generator
        Source of randomness.

    Returns
    -------
    SimulatedPhoto
        Yaw within 35, pitch and roll within 20 degrees; distance 0.45 to 1.5 m; the head takes up 45 to 75 % of the
        picture's height, off centre by up to 10 % of it.
    """
    person = simulate_person(face, rng)
    weights = random_expression_weights(rng, 1)[0]
    vertices = person.pose(weights)
    height = IMAGE_SIZE[0]
    distance = float(np.exp(rng.uniform(*np.log(DISTANCE_MM))))
    focal = float(rng.uniform(*HEAD_SHARE)) * height / _HEAD_MM * distance
    intrinsics = Intrinsics.for_image(IMAGE_SIZE, focal)
    rotation = rotation_from_head_angles(*(float(rng.uniform(-limit, limit)) for limit in (YAW, PITCH, ROLL)))
    middle = np.array([0.0, 0.0, 40.0])
    shift = rng.uniform(-0.1, 0.1, 2) * height / focal * distance
    motion = RigidMotion(rotation, np.array([*shift, distance]) - rotation @ middle)
    skin = face.skin().topology
    landmarks = true_landmarks(skin, face.skin().mean_shape, vertices[: skin.n_vertices], intrinsics, motion)
    return SimulatedPhoto(vertices, intrinsics, motion, landmarks, IMAGE_SIZE, weights)
