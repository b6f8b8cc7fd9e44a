"""Pairs of pictures of one simulated person, and the truth of carrying a face component from one into the other."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from facewright.apps.true_landmarks import true_landmarks
from facewright.camera.pinhole import Intrinsics, RigidMotion
from facewright.camera.rotation import rotation_from_head_angles
from facewright.evaluation.textured_background import textured_background
from facewright.faces.appearance import Appearance, albedo_function, sample_appearance, vertex_gloss, visible_faces
from facewright.faces.expressions import random_expression_weights
from facewright.faces.face import Face
from facewright.faces.simulate import SimulatedPerson
from facewright.imaging.component_mask import SkinPixels, component_level, component_pixels, component_shapes
from facewright.imaging.mesh_view import MeshView
from facewright.imaging.render import Lights, render_mesh
from facewright.landmarks.points import Landmarks

IMAGE_SIZE = (512, 512)
#: Standard deviation of the landmarks' noise, pixels.
NOISE_PX = 1.0
#: Limits of the head's pose in the target and of what the reference's differs by, degrees.
POSE, POSE_CHANGE = (15.0, 8.0, 6.0), (12.0, 7.0, 6.0)
DISTANCE_MM = (600.0, 1400.0)
#: Height of the head as a share of the picture's: the reference's is another one.
HEAD_SHARE = (0.7, 0.9)
_HEAD_MM = 240.0
#: How far the component's coefficients must differ in size between the two pictures, at least.
_DIFFERENCE = 0.5
#: A mouth pulled to one side, as far as the generic face goes: what symmetric shapes cannot make.
_ONE_SIDED = {
    "L": {"mouthSmile_L": 0.9, "mouthLeft": 0.7, "mouthUpperUp_L": 0.5, "mouthDimple_L": 0.4, "jawLeft": 0.4},
    "R": {"mouthSmile_R": 0.9, "mouthRight": 0.7, "mouthUpperUp_R": 0.5, "mouthDimple_R": 0.4, "jawRight": 0.4},
}


@dataclass(frozen=True, eq=False)
class Shot:
    """A picture of a simulated person and what is known about it.

    Parameters
    ----------
    image : ndarray of shape (H, W, 3), uint8
        The picture.
    landmarks : Landmarks
        Scheme ``fw74``, with noise.
    view : MeshView
        The true mesh, all parts, as the camera sees it.
    """

    image: NDArray[np.uint8]
    landmarks: Landmarks
    view: MeshView


@dataclass(frozen=True, eq=False)
class SimulatedPair:
    """Target, reference and what the target should become.

    Parameters
    ----------
    target, reference : Shot
        One person, two expressions; pose, distance, size and light differ.
    truth : ndarray of shape (H, W, 3), uint8
        The target's camera, pose and light with the reference's expression of the component.
    region : ndarray of shape (H, W), bool
        Pixels of the component in `truth`.
    component : str
        One of `facewright.imaging.component_mask.COMPONENTS`.
    """

    target: Shot
    reference: Shot
    truth: NDArray[np.uint8]
    region: NDArray[np.bool_]
    component: str


def simulate_pair(
    face: Face, person: SimulatedPerson, component: str, rng: np.random.Generator, *, one_sided: bool = False
) -> SimulatedPair:
    """Draw a pair of pictures.

    Parameters
    ----------
    face : Face
        All parts of it.
    person : SimulatedPerson
        Who is seen.
    component : str
        What is carried over; the two expressions differ at least there.
    rng : numpy.random.Generator
        Source of randomness.
    one_sided : bool
        Give the reference a mouth pulled to one side.

    Returns
    -------
    SimulatedPair
        Yaw within 15, pitch within 8, roll within 6 degrees in the target; up to 12, 7 and 6 more or less in the
        reference; distances of 0.6 to 1.4 m, and independent lights.
    """
    look, other = sample_appearance(rng), sample_appearance(rng)
    elsewhere = _relit(look, other, rng)
    target_weights, reference_weights = _expressions(component, rng, one_sided)
    moves = component_shapes(component, face.blendshape_names)
    wanted = np.where(moves, reference_weights, target_weights)
    angles = rng.uniform(-1.0, 1.0, 3) * POSE
    turned = angles + rng.uniform(-1.0, 1.0, 3) * POSE_CHANGE
    first, second = _camera(angles, rng), _camera(turned, rng)
    grounds = [textured_background(each.background, IMAGE_SIZE, rng) for each in (look, other)]
    target = _shoot(face, person.pose(target_weights), first, look, grounds[0], rng)
    reference = _shoot(face, person.pose(reference_weights), second, elsewhere, grounds[1], rng)
    truth = _shoot(face, person.pose(wanted), first, look, grounds[0], rng)
    pixels = SkinPixels.of(face, truth.view, IMAGE_SIZE)
    region = component_pixels(pixels, component_level(face, component)) > 0.5
    return SimulatedPair(target, reference, truth.image, region, component)


def _relit(look: Appearance, other: Appearance, rng: np.random.Generator) -> Appearance:
    """Return a person in another one's light, exposed for the person to within a quarter of a stop."""
    exposure = 2 ** rng.uniform(-0.25, 0.25) * np.sum(look.light_colours) / np.sum(other.light_colours)
    sky, ground = ((exposure * np.array(light)).tolist() for light in (other.sky, other.ground))
    return replace(
        look,
        light_directions=other.light_directions,
        light_colours=exposure * other.light_colours,
        sky=(sky[0], sky[1], sky[2]),
        ground=(ground[0], ground[1], ground[2]),
        background=other.background,
    )


def _expressions(
    component: str, rng: np.random.Generator, one_sided: bool
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Draw two expressions that differ in the component."""
    from facewright.faces.blendshape_names import BLENDSHAPE_NAMES, blendshape_index

    moves = component_shapes(component, BLENDSHAPE_NAMES)
    while True:
        target, reference = random_expression_weights(rng, 2)
        if np.abs(target[moves] - reference[moves]).max() >= _DIFFERENCE:
            break
    if one_sided:
        reference[moves] = 0.0
        for name, weight in _ONE_SIDED["L" if rng.random() < 0.5 else "R"].items():
            reference[blendshape_index(name)] = weight * rng.uniform(0.8, 1.0)
    return target, reference


def _camera(angles: NDArray[np.float64], rng: np.random.Generator) -> tuple[Intrinsics, RigidMotion]:
    height = IMAGE_SIZE[0]
    distance = float(np.exp(rng.uniform(*np.log(DISTANCE_MM))))
    focal = float(rng.uniform(*HEAD_SHARE)) * height / _HEAD_MM * distance
    rotation = rotation_from_head_angles(*angles.tolist())
    shift = rng.uniform(-0.05, 0.05, 2) * height / focal * distance
    middle = np.array([0.0, -10.0, 40.0])
    return Intrinsics.for_image(IMAGE_SIZE, focal), RigidMotion(
        rotation, np.array([*shift, distance]) - rotation @ middle
    )


def _shoot(
    face: Face,
    vertices: NDArray[np.float32],
    camera: tuple[Intrinsics, RigidMotion],
    look: Appearance,
    background: NDArray[np.uint8],
    rng: np.random.Generator,
) -> Shot:
    """Render a posed person and find the landmarks."""
    intrinsics, motion = camera
    seen = motion.apply(vertices)
    view = MeshView(intrinsics.project(seen), seen)
    faces = visible_faces(face)
    image = render_mesh(
        seen,
        view.pixels,
        faces,
        IMAGE_SIZE,
        albedo=albedo_function(face, look, faces),
        lights=Lights(look.light_directions, look.light_colours, look.sky, look.ground),
        background=background,
        shininess=vertex_gloss(face),
    ).image
    skin = face.skin()
    exact = true_landmarks(skin.topology, skin.mean_shape, vertices[: face.n_skin], intrinsics, motion)
    noisy = Landmarks("fw74", exact.points + rng.normal(0.0, NOISE_PX, exact.points.shape))
    return Shot(image, noisy, view)
