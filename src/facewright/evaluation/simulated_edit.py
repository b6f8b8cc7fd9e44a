"""Pictures of simulated people, and the truth of changing their attributes: geometry changed, rendered again."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from facewright.apps.edited_view import same_place
from facewright.apps.true_landmarks import true_landmarks
from facewright.camera.pinhole import Intrinsics, RigidMotion
from facewright.camera.rotation import rotation_from_head_angles
from facewright.evaluation.textured_background import textured_background
from facewright.faces.appearance import Appearance, albedo_function, sample_appearance, vertex_gloss, visible_faces
from facewright.faces.attribute_editor import AttributeEditor
from facewright.faces.expressions import random_expression_weights
from facewright.faces.face import Face
from facewright.faces.simulate import SimulatedPerson, simulate_expressions, simulate_neutrals
from facewright.imaging.rasterise import rasterise
from facewright.imaging.render import Lights, render_mesh
from facewright.landmarks.contour import face_region
from facewright.landmarks.points import Landmarks

IMAGE_SIZE = (512, 512)
#: Limits of the head's pose, degrees, and of the camera's distance from it.
POSE = (20.0, 10.0, 8.0)
DISTANCE_MM = (600.0, 1400.0)
#: Height of the head as a share of the picture's.
HEAD_SHARE = (0.55, 0.75)
_HEAD_MM = 240.0
_N_PEOPLE = 1000


@dataclass(frozen=True, eq=False)
class EditScene:
    """A simulated person before a camera and a textured wall, all of it known.

    Parameters
    ----------
    face : Face
        All parts.
    person : SimulatedPerson
        Who is seen; not in the span of the identity modes.
    personality : int
        Seed of the person's blendshapes.
    weights : ndarray of shape (46,)
        The expression.
    intrinsics : Intrinsics
    camera_from_model : RigidMotion
        Camera and pose.
    look : Appearance
        Colours and light.
    background : ndarray of shape (H, W, 3), uint8
    """

    face: Face
    person: SimulatedPerson
    personality: int
    weights: NDArray[np.float64]
    intrinsics: Intrinsics
    camera_from_model: RigidMotion
    look: Appearance
    background: NDArray[np.uint8]

    def draw(self, change: NDArray[np.floating] | None = None) -> tuple[NDArray[np.uint8], NDArray[np.bool_]]:
        """Render the person, by default as is, else with the neutral changed by (V, 3) mm.

        The changed person's blendshapes are carried over from the generic face to the changed neutral, with the same
        amplitudes and peculiarities as before.

        Returns
        -------
        image : ndarray of shape (H, W, 3), uint8
            Same look, light, camera, expression and place of the head.
        region : ndarray of shape (H, W), bool
            Pixels of the face: in front of the jaw line and ears, with the forehead.
        """
        seen = self._seen(change)
        pixels = self.intrinsics.project(seen)
        faces = visible_faces(self.face)
        look = self.look
        image = render_mesh(
            seen,
            pixels,
            faces,
            IMAGE_SIZE,
            albedo=albedo_function(self.face, look, faces),
            lights=Lights(look.light_directions, look.light_colours, look.sky, look.ground),
            background=self.background,
            shininess=vertex_gloss(self.face),
        ).image
        return image, self._region(seen, pixels)

    def landmarks(self, noise_px: float, rng: np.random.Generator) -> Landmarks:
        """Return the true ``fw74`` landmarks of the unchanged person with Gaussian noise."""
        skin = self.face.skin()
        posed = self.person.pose(self.weights)[: self.face.n_skin]
        exact = true_landmarks(skin.topology, skin.mean_shape, posed, self.intrinsics, self.camera_from_model)
        return Landmarks("fw74", exact.points + rng.normal(0.0, noise_px, exact.points.shape))

    def _seen(self, change: NDArray[np.floating] | None) -> NDArray[np.float64]:
        person, motion = self.person, self.camera_from_model
        if change is not None:
            neutral = person.neutral.astype(np.float64) + change
            person = simulate_expressions(self.face, neutral, np.random.default_rng(self.personality))
            motion = motion.after(same_place(neutral, self.person.neutral, self.face.topology))
        return motion.apply(person.pose(self.weights).astype(np.float64))

    def _region(self, seen: NDArray[np.float64], pixels: NDArray[np.float64]) -> NDArray[np.bool_]:
        skin = self.face.skin()
        inside = np.zeros(self.face.topology.n_vertices, dtype=bool)
        inside[face_region(skin.topology, skin.mean_shape)] = True
        inside[self.face.n_skin :] = True  # eyes and teeth
        faces = visible_faces(self.face)
        shown = rasterise(pixels, seen[:, 2], faces, IMAGE_SIZE)
        region = np.zeros(IMAGE_SIZE, dtype=bool)
        region[shown.covered] = inside[faces].all(axis=1)[shown.face_index[shown.covered]]
        return region


def simulate_scene(face: Face, rng: np.random.Generator) -> EditScene:
    """Draw a person, an expression, a pose, a camera, a look and a wall.

    Yaw within 20, pitch within 10, roll within 8 degrees; the head takes up 55 to 75 % of the picture's height.
    """
    personality = int(rng.integers(2**31))
    neutral = simulate_neutrals(face, 1, rng)[0]
    person = simulate_expressions(face, neutral, np.random.default_rng(personality))
    weights = random_expression_weights(rng, 1)[0]
    height = IMAGE_SIZE[0]
    distance = float(np.exp(rng.uniform(*np.log(DISTANCE_MM))))
    focal = float(rng.uniform(*HEAD_SHARE)) * height / _HEAD_MM * distance
    rotation = rotation_from_head_angles(*(rng.uniform(-1.0, 1.0, 3) * POSE).tolist())
    middle = np.array([0.0, 10.0, 40.0])  # of the head with its neck
    shift = rng.uniform(-0.05, 0.05, 2) * height / focal * distance
    look = sample_appearance(rng)
    return EditScene(
        face,
        person,
        personality,
        weights,
        Intrinsics.for_image(IMAGE_SIZE, focal),
        RigidMotion(rotation, np.array([*shift, distance]) - rotation @ middle),
        look,
        textured_background(look.background, IMAGE_SIZE, rng),
    )


class TrueAttributes:
    """What attributes do to people in the space that they are drawn from: all identity modes, N(0, 1) each."""

    def __init__(self, face: Face) -> None:
        self.face = face
        self._people = np.random.default_rng(0).normal(size=(_N_PEOPLE, len(face.identity_basis)))
        editor = AttributeEditor(face.topology, face.mean_shape, face.identity_basis, self._people)
        self.names, self.standard_deviation = editor.names, editor.standard_deviation

    def change(self, neutral: NDArray[np.floating], deviations: Mapping[str, float]) -> NDArray[np.float64]:
        """Return how a person's neutral (V, 3) changes with attributes, mm: the least change in the person's own space.

        `deviations` are in standard deviations of the space, other attributes held as `AttributeEditor` does.
        """
        basis = self.face.identity_basis
        editor = AttributeEditor(self.face.topology, neutral, basis, self._people)
        scale = dict(zip(self.names, self.standard_deviation / editor.standard_deviation))
        asked = {name: value * scale[name] for name, value in deviations.items()}
        weights = editor.change(np.zeros(len(basis)), asked).weights
        return np.asarray(np.tensordot(weights, basis.astype(np.float64), 1))
