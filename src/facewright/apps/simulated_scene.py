"""The scene before a simulated Kinect: a person with hair and glasses, a torso, a wall; painted and with depth."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from facewright.apps.simulated_props import Prop, outward_normals
from facewright.apps.simulated_subject import SimulatedCaptureSubject
from facewright.camera.pinhole import Intrinsics, RigidMotion
from facewright.capture.simulated_kinect import KINECT_SIZE
from facewright.faces.appearance import albedo_function, vertex_gloss, visible_faces
from facewright.imaging.colour import linear_from_srgb, srgb_from_linear
from facewright.imaging.rasterise import Fragments, rasterise
from facewright.imaging.render import Lights, shade_fragments

_NECK_RIGID_MM, _NECK_BENDS_MM = 12.0, 75.0  # below the chin: where the neck begins to bend, and over what length
_GRAIN = 2.6  # standard deviation of a picture's noise, of 255


class Look(NamedTuple):
    """One view of a scene: what a perfect sensor would see."""

    color: NDArray[np.float32]
    """(H, W, 3), sRGB times 255, before noise."""
    depth: NDArray[np.float32]
    """(H, W), mm."""
    absorbed: NDArray[np.float32]
    """(H, W), share of depth measurements that fail."""


class CaptureScene:
    """A posed person before a camera; what does not move is painted once."""

    def __init__(
        self,
        subject: SimulatedCaptureSubject,
        vertices: NDArray[np.floating],
        intrinsics: Intrinsics,
        camera_from_torso: RigidMotion,
        seed: int,
    ) -> None:
        face = subject.face
        rng = np.random.default_rng((seed, 1 << 20))
        look = subject.appearance
        self.intrinsics, self.camera_from_torso = intrinsics, camera_from_torso
        self.lights = Lights(look.light_directions, look.light_colours, look.sky, look.ground)
        own = visible_faces(face)
        V = face.topology.n_vertices
        posed = np.asarray(vertices, dtype=np.float64)
        props: list[Prop] = []
        skin_faces = face.topology.faces[(face.topology.faces < face.n_skin).all(axis=1)]
        if subject.hair is not None:
            skin = posed[: face.n_skin]
            props.append(subject.hair.over(skin, outward_normals(skin, skin_faces)))
        self.n_hair = len(props[0].faces) if props else 0
        if subject.glasses is not None:
            props.append(subject.glasses[0])
        starts = np.cumsum([V] + [len(prop.vertices) for prop in props])
        self.vertices = np.concatenate([posed] + [prop.vertices for prop in props])
        self.faces = np.concatenate([own] + [prop.faces + start for prop, start in zip(props, starts)]).astype(np.int32)
        self.n_own = len(own)
        self.colours = np.concatenate([np.zeros((V, 3), np.float32)] + [prop.colours for prop in props])
        gloss = [vertex_gloss(face)] + [np.full(len(prop.vertices), 0.06, np.float32) for prop in props]
        self.gloss = np.concatenate(gloss)
        self.paint = albedo_function(face, look, own)
        self.lenses = None if subject.glasses is None else subject.glasses[1]
        self.hair_absorbs = 0.45 * float(np.clip(1.0 - np.mean(look.hair) / 0.45, 0.0, 1.0))
        self.bend = self._neck_bend(subject)
        self.grain = rng.standard_normal((KINECT_SIZE[0] + 64, KINECT_SIZE[1] + 64, 3)).astype(np.float32)
        self._paint_background(subject, rng)

    def _neck_bend(self, subject: SimulatedCaptureSubject) -> NDArray[np.float64]:
        """Return for each vertex how far it follows the head, 1, or the torso, 0: the neck is in between."""
        face, neutral = subject.face, subject.person.neutral
        below = neutral[face.topology.landmarks["ibug68"][8], 1] - _NECK_RIGID_MM - neutral[: face.n_skin, 1]
        bend = np.ones(len(self.vertices))
        t = np.clip(below / _NECK_BENDS_MM, 0.0, 1.0)
        bend[: face.n_skin] = 1.0 - t * t * (3.0 - 2.0 * t)
        return bend

    def _paint_background(self, subject: SimulatedCaptureSubject, rng: np.random.Generator) -> None:
        """Paint wall and torso, which stand still."""
        K, (height, width) = self.intrinsics, KINECT_SIZE
        u = ((np.arange(width) - K.centre_x) / K.focal_x)[None, :]
        v = ((np.arange(height) - K.centre_y) / K.focal_y)[:, None]
        wall = np.broadcast_to(subject.wall_mm / (1.0 - subject.wall_tilt * u), (height, width)).astype(np.float32)
        base = linear_from_srgb(np.array(subject.appearance.background, np.float32) / 255.0)
        shade = 0.85 + rng.normal(0.0, 0.35) * u - 0.25 * v + rng.normal(0.0, 0.2) * u * v
        linear = (base * np.clip(shade, 0.3, 1.3)[..., None]).astype(np.float32)
        torso = subject.torso
        seen = self.camera_from_torso.apply(torso.vertices)
        fragments = rasterise(K.project(seen), seen[:, 2], torso.faces, KINECT_SIZE)
        covered = fragments.covered & (fragments.depth < wall)
        shown = shade_fragments(fragments, seen, torso.faces, albedo=torso.colours, lights=self.lights, shininess=0.02)
        linear[fragments.covered] = np.where(covered[fragments.covered, None], shown, linear[fragments.covered])
        self.depth = np.where(covered, fragments.depth, wall)
        self.linear = linear

    def look(self, camera_from_model: RigidMotion) -> Look:
        """Paint the scene with the head in this pose."""
        still = self.camera_from_torso.apply(self.vertices)
        seen = still + self.bend[:, None] * (camera_from_model.apply(self.vertices) - still)
        pixels = self.intrinsics.project(seen)
        window = _window(pixels, KINECT_SIZE)
        depth, linear = self.depth.copy(), self.linear.copy()
        absorbed = np.zeros(KINECT_SIZE, np.float32)
        if window is not None:
            rows, columns = window
            origin = np.array([columns.start, rows.start])
            size = (rows.stop - rows.start, columns.stop - columns.start)
            fragments = rasterise(pixels - origin, seen[:, 2], self.faces, size)
            covered = fragments.covered
            shown = shade_fragments(
                fragments, seen, self.faces, albedo=self._albedo, lights=self.lights, shininess=self.gloss
            )
            before = covered & (fragments.depth < depth[rows, columns])
            linear[rows, columns][before] = shown[before[covered]]
            depth[rows, columns][before] = fragments.depth[before]
            own = fragments.face_index
            hair = before & (own >= self.n_own) & (own < self.n_own + self.n_hair)
            absorbed[rows, columns][hair] = self.hair_absorbs
            if self.lenses is not None:
                self._add_lenses(camera_from_model, linear, depth, absorbed)
        return Look(_soften(255.0 * srgb_from_linear(linear)), depth, absorbed)

    def _add_lenses(
        self,
        camera_from_model: RigidMotion,
        linear: NDArray[np.float32],
        depth: NDArray[np.float32],
        absorbed: NDArray[np.float32],
    ) -> None:
        """Put a faint reflection on the lenses; they scatter the sensor's pattern."""
        assert self.lenses is not None
        seen = camera_from_model.apply(self.lenses.vertices)
        fragments = rasterise(self.intrinsics.project(seen), seen[:, 2], self.lenses.faces, KINECT_SIZE)
        glass = fragments.covered & (fragments.depth < depth + 0.5)
        height = np.nonzero(glass)[0]
        if len(height):
            share = 0.03 + 0.10 * (1.0 - (height - height.min()) / max(np.ptp(height), 1))[:, None] ** 2
            linear[glass] = (1.0 - share) * linear[glass] + share
            absorbed[glass] = 0.35

    def _albedo(self, fragments: Fragments) -> NDArray[np.float32]:
        own = fragments.face_index < self.n_own
        person = Fragments(np.where(own, fragments.face_index, -1), fragments.barycentric, fragments.depth)
        colours = self.paint(person)
        if len(self.faces) > self.n_own:
            props = fragments.interpolate(self.faces, self.colours)
            colours[~own] = props[~own]
        return colours

    def add_grain(self, color: NDArray[np.float32], rng: np.random.Generator) -> NDArray[np.uint8]:
        """Return the picture as the sensor's colour camera delivers it: soft, with noise, uint8."""
        i, j = rng.integers(0, 64, 2)
        height, width = KINECT_SIZE
        grain = self.grain[i : i + height, j : j + width]
        return np.clip(color + _GRAIN * grain + 0.5, 0.0, 255.0).astype(np.uint8)


def _window(pixels: NDArray[np.float64], size: tuple[int, int]) -> tuple[slice, slice] | None:
    """Return the rows and columns of a picture that hold these pixels, or None."""
    low = np.maximum(np.floor(pixels.min(axis=0)).astype(int), 0)
    high = np.minimum(np.ceil(pixels.max(axis=0)).astype(int) + 1, [size[1], size[0]])
    if (high <= low).any():
        return None
    return slice(int(low[1]), int(high[1])), slice(int(low[0]), int(high[0]))


def _soften(picture: NDArray[np.float32], side: float = 0.45) -> NDArray[np.float32]:
    """Blur a picture (H, W, 3) a little, as lens and Bayer pattern do."""
    for axis in (0, 1):
        padded = (
            np.concatenate([picture[:1], picture, picture[-1:]])
            if axis == 0
            else np.concatenate([picture[:, :1], picture, picture[:, -1:]], axis=1)
        )
        before, after = (padded[:-2], padded[2:]) if axis == 0 else (padded[:, :-2], padded[:, 2:])
        picture = (picture + side * (before + after)) / (1.0 + 2.0 * side)
    return picture
