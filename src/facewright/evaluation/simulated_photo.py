"""Pictures of simulated people with everything known: shape, camera, landmarks, and a rendering for detectors."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from facewright.camera.pinhole import Intrinsics, RigidMotion
from facewright.camera.rotation import rotation_from_head_angles
from facewright.errors import TopologyError
from facewright.faces.expressions import random_expression_weights
from facewright.faces.face import Face
from facewright.faces.simulate import simulate_person
from facewright.imaging.rasterise import rasterise
from facewright.landmarks.contour import face_region
from facewright.landmarks.points import Landmarks
from facewright.landmarks.scheme import load_scheme
from facewright.mesh.topology import Topology

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


def true_landmarks(
    topology: Topology,
    mean_shape: NDArray[np.floating],
    vertices: NDArray[np.floating],
    intrinsics: Intrinsics,
    motion: RigidMotion,
) -> Landmarks:
    """Return the ``fw74`` landmarks of a known mesh in a known camera.

    The contour is found as a person with a pen would: along 15 rays from the middle of the face, evenly spread from the
    right temple over the chin to the left temple, the last place at which the face's region is seen. It knows nothing
    of the strips of vertices that the fit slides along.
    """
    scheme = load_scheme("fw74")
    ids = topology.landmarks.get("fw74")
    jaw = topology.landmarks.get("ibug68")
    if ids is None or jaw is None:
        raise TopologyError(f"topology {topology.name!r} must mark the 'fw74' and 'ibug68' landmarks.")
    seen = motion.apply(np.asarray(vertices, dtype=np.float64))
    pixels = intrinsics.project(seen)
    points = np.full((scheme.n_points, 2), np.nan)
    points[scheme.fixed] = pixels[ids[scheme.fixed]]
    points[scheme.sliding] = _outline_points(
        topology, mean_shape, pixels, seen[:, 2], pixels[jaw[[0, 8, 16]]], points, len(scheme.sliding)
    )
    return Landmarks("fw74", points)


def _outline_points(
    topology: Topology,
    mean_shape: NDArray[np.floating],
    pixels: NDArray[np.float64],
    depth: NDArray[np.float64],
    ends: NDArray[np.float64],
    points: NDArray[np.float64],
    n: int,
) -> NDArray[np.float64]:
    zoom = 3  # samples a pixel
    region = np.zeros(topology.n_vertices, dtype=bool)
    region[face_region(topology, mean_shape)] = True
    faces = topology.faces[region[topology.faces].all(axis=1)]
    low = np.floor(pixels[region].min(axis=0)) - 2
    fine = (pixels - low) * zoom
    size = np.ceil(fine[region].max(axis=0)).astype(int) + 3
    seen = rasterise(fine, depth, faces, (int(size[1]), int(size[0]))).covered
    groups = load_scheme("fw74").groups
    eyes = points[np.concatenate([groups["right_eye"], groups["left_eye"]])].mean(axis=0)
    mouth = points[groups["outer_mouth"]].mean(axis=0)
    middle = 0.5 * (eyes + mouth)
    # angles of the rays, measured from the direction of the chin so that they do not wrap
    down = np.arctan2(*(mouth - eyes)[::-1])
    right, _, left = ((np.arctan2(*(end - middle)[::-1]) - down + np.pi) % (2 * np.pi) - np.pi for end in ends)
    angles = down + np.linspace(right, left, n)
    reach = np.arange(0.0, float(np.hypot(*size)), 0.5)
    along = (middle - low) * zoom + reach[:, None, None] * np.stack([np.cos(angles), np.sin(angles)], axis=1)
    column, row = np.rint(along[..., 0]).astype(int), np.rint(along[..., 1]).astype(int)
    inside = (column >= 0) & (column < size[0]) & (row >= 0) & (row < size[1])
    hit = np.zeros(inside.shape, dtype=bool)
    hit[inside] = seen[row[inside], column[inside]]
    last = len(reach) - 1 - np.argmax(hit[::-1], axis=0)
    return along[last, np.arange(n)] / zoom + low
