"""Rendered clips of simulated people with everything known: coefficients, head motion, gaze, shape."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from facewright.camera.pinhole import Intrinsics, RigidMotion
from facewright.evaluation.simulated_performance import simulate_performance
from facewright.evaluation.textured_background import textured_background
from facewright.faces.appearance import Appearance, albedo_function, sample_appearance, vertex_gloss, visible_faces
from facewright.faces.face import Face
from facewright.faces.simulate import SimulatedPerson, simulate_person
from facewright.fitting.gaze import Eyeballs
from facewright.imaging.render import Lights, render_mesh
from facewright.models.performance import Performance

IMAGE_SIZE = (480, 640)
FRAMES_PER_SECOND = 25.0
#: Height of the head (about 240 mm), at 650 mm, as a share of the picture's height.
_HEAD_SHARE = (0.62, 0.78)
_HEAD_MM, _DISTANCE_MM = 240.0, 650.0
#: Standard deviation of the camera's blur, which softens edges drawn at one sample a pixel, and of its noise, of 255
#: levels.
_BLUR_PIXELS = 0.5
_NOISE_LEVELS = 2.0


@dataclass(frozen=True, eq=False)
class SimulatedVideo:
    """A simulated person who acts before a camera.

    Parameters
    ----------
    face : Face
        All parts of it.
    person : SimulatedPerson
        Who acts; outside the span of any model of the face.
    performance : Performance
        What is acted: the truth.
    rest : ndarray of shape (T,), bool
        Frames in which head and face are still.
    intrinsics : Intrinsics
        The camera.
    appearance : Appearance
        Colours and light.
    background : ndarray of shape (H, W, 3), uint8
        What the person is drawn over, with texture.
    seed : int
        Of the camera's noise.
    """

    face: Face
    person: SimulatedPerson
    performance: Performance
    rest: NDArray[np.bool_]
    intrinsics: Intrinsics
    appearance: Appearance
    background: NDArray[np.uint8]
    seed: int

    @property
    def n_frames(self) -> int:
        """Number of frames T."""
        return self.performance.n_frames

    def vertices(self, frame: int) -> NDArray[np.float64]:
        """Return all parts of the person in a frame, (V, 3), millimetres, in model space, the eyes turned."""
        posed = self.person.pose(self.performance.weights[frame]).astype(np.float64)
        Eyeballs(self.face, self.person.neutral).turn(posed, self.performance.gaze[frame])
        return posed

    def motion(self, frame: int) -> RigidMotion:
        """Return camera_from_model of a frame."""
        return RigidMotion(self.performance.rotations[frame], self.performance.translations[frame])

    def images(self) -> Iterator[NDArray[np.uint8]]:
        """Draw the frames, one after the other: (480, 640, 3), uint8, sRGB."""
        look = self.appearance
        faces = visible_faces(self.face)
        albedo, gloss = albedo_function(self.face, look, faces), vertex_gloss(self.face)
        lights = Lights(look.light_directions, look.light_colours, look.sky, look.ground)
        rng = np.random.default_rng(self.seed)
        wall = _blurred(self.background)
        for frame in range(self.n_frames):
            seen = self.motion(frame).apply(self.vertices(frame))
            pixels = self.intrinsics.project(seen)
            box = _box(pixels, IMAGE_SIZE)
            behind = self.background[box]
            drawn = render_mesh(
                seen,
                pixels - [box[1].start, box[0].start],
                faces,
                (behind.shape[0], behind.shape[1]),
                albedo=albedo,
                lights=lights,
                background=behind,
                shininess=gloss,
                supersample=1,
            ).image
            image = wall.copy()
            image[box] = _blurred(drawn)
            image += _NOISE_LEVELS * rng.standard_normal(image.shape, dtype=np.float32)
            yield np.clip(np.rint(image), 0, 255).astype(np.uint8)


def simulate_video(face: Face, rng: np.random.Generator, seconds: float = 10.0, *, rest_first: bool) -> SimulatedVideo:
    """Draw a person, an appearance and a performance.

    Parameters
    ----------
    face : Face
        All parts of it.
    rng : numpy.random.Generator
        Source of randomness.
    seconds : float
        Length, at 25 frames a second.
    rest_first : bool
        Whether the clip begins at rest; else it begins in the middle of an expression.

    Returns
    -------
    SimulatedVideo
        The clip; frames are drawn when asked for.
    """
    person = simulate_person(face, rng)
    performance, rest = simulate_performance(rng, seconds, FRAMES_PER_SECOND, rest_first=rest_first)
    focal = float(rng.uniform(*_HEAD_SHARE)) * IMAGE_SIZE[0] / _HEAD_MM * _DISTANCE_MM
    look = sample_appearance(rng)
    return SimulatedVideo(
        face=face,
        person=person,
        performance=performance,
        rest=rest,
        intrinsics=Intrinsics.for_image(IMAGE_SIZE, focal),
        appearance=look,
        background=textured_background(look.background, IMAGE_SIZE, rng),
        seed=int(rng.integers(2**31)),
    )


def _blurred(image: NDArray[np.uint8]) -> NDArray[np.float32]:
    blurred: NDArray[np.float32] = ndimage.gaussian_filter(image.astype(np.float32), (_BLUR_PIXELS, _BLUR_PIXELS, 0))
    return blurred


def _box(pixels: NDArray[np.float64], size: tuple[int, int]) -> tuple[slice, slice]:
    """Return the rows and columns of the picture that the mesh may cover."""
    low = np.clip(np.floor(pixels.min(axis=0)).astype(int) - 2, 0, np.array(size[::-1]) - 1)
    high = np.clip(np.ceil(pixels.max(axis=0)).astype(int) + 3, low + 1, size[::-1])
    return slice(int(low[1]), int(high[1])), slice(int(low[0]), int(high[0]))
