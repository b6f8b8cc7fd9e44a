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
_COLLAR_MM = 18.0  # how far the neck is still there below the top of the clothes
_GRAIN = 2.6  # standard deviation of a picture's noise, of 255
_SOFT = 0.25  # weight of a pixel's neighbours in it, before and after


class Look(NamedTuple):
    """One view of a scene: what a perfect sensor would see."""

    color: NDArray[np.uint8]
    """(H, W, 3), sRGB without noise."""
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
        own = own[~_under_clothes(subject)[own].any(axis=1)]
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
        self.neck, self.bend = _neck_bend(subject)
        self.normals = outward_normals(self.vertices, self.faces)
        grain = _GRAIN * rng.standard_normal((KINECT_SIZE[0] + 64, KINECT_SIZE[1] + 64, 3))
        self.grain = np.rint(grain).astype(np.int16)
        self._paint_background(subject)

    def _paint_background(self, subject: SimulatedCaptureSubject) -> None:
        """Paint wall and torso, which stand still."""
        K, (height, width) = self.intrinsics, KINECT_SIZE
        u = ((np.arange(width) - K.centre_x) / K.focal_x)[None, :]
        v = ((np.arange(height) - K.centre_y) / K.focal_y)[:, None]
        wall = np.broadcast_to(subject.wall_mm / (1.0 - subject.wall_tilt * u), (height, width)).astype(np.float32)
        base = linear_from_srgb(np.array(subject.appearance.background, np.float32) / 255.0)
        across, corner = subject.wall_shades
        shade = 0.85 + across * u - 0.25 * v + corner * u * v
        linear = (base * np.clip(shade, 0.3, 1.3)[..., None]).astype(np.float32)
        torso = subject.torso
        seen = self.camera_from_torso.apply(torso.vertices)
        drawn = _draw(K.project(seen), seen[:, 2], torso.faces, wall)
        shown = np.zeros_like(linear)
        shown[drawn.fragments.covered] = shade_fragments(
            drawn.fragments, seen, torso.faces, albedo=torso.colours, lights=self.lights, shininess=0.02
        )
        self.linear = drawn.over(shown, linear)
        self.depth = np.where(drawn.fragments.covered, drawn.fragments.depth, wall)
        self.color = _finish(self.linear)

    def look(self, camera_from_model: RigidMotion) -> Look:
        """Paint the scene with the head in this pose."""
        seen = camera_from_model.apply(self.vertices)
        still = self.camera_from_torso.apply(self.vertices[self.neck])
        seen[self.neck] = still + self.bend[:, None] * (seen[self.neck] - still)
        pixels = self.intrinsics.project(seen)
        window = _window(pixels, KINECT_SIZE)
        color, depth = self.color.copy(), self.depth.copy()
        absorbed = np.zeros(KINECT_SIZE, np.float32)
        if window is None:
            return Look(color, depth, absorbed)
        origin = [window[1].start, window[0].start]
        drawn = _draw(pixels - origin, seen[:, 2], self.faces, self.depth[window])
        fragments, covered = drawn.fragments, drawn.fragments.covered
        shown = np.zeros((*covered.shape, 3), np.float32)
        shown[covered] = shade_fragments(
            fragments,
            seen,
            self.faces,
            albedo=self._albedo,
            lights=self.lights,
            shininess=self.gloss,
            normals=self.normals @ camera_from_model.rotation.T,
        )
        depth[window][covered] = fragments.depth[covered]
        hair = (fragments.face_index >= self.n_own) & (fragments.face_index < self.n_own + self.n_hair)
        absorbed[window][hair] = self.hair_absorbs
        linear = drawn.over(shown, self.linear[window])
        if self.lenses is not None:
            self._add_lenses(camera_from_model, linear, depth, absorbed, window)
        color[window] = _finish(linear)
        return Look(color, depth, absorbed)

    def _add_lenses(
        self,
        camera_from_model: RigidMotion,
        linear: NDArray[np.float32],
        depth: NDArray[np.float32],
        absorbed: NDArray[np.float32],
        window: tuple[slice, slice],
    ) -> None:
        """Put a faint reflection on the lenses; they scatter the sensor's pattern."""
        assert self.lenses is not None
        seen = camera_from_model.apply(self.lenses.vertices)
        pixels = self.intrinsics.project(seen) - [window[1].start, window[0].start]
        size = (linear.shape[0], linear.shape[1])
        fragments = rasterise(pixels, seen[:, 2], self.lenses.faces, size)
        glass = fragments.covered & (fragments.depth < depth[window] + 0.5)
        height = np.nonzero(glass)[0]
        if len(height):
            share = 0.03 + 0.10 * (1.0 - (height - height.min()) / max(np.ptp(height), 1))[:, None] ** 2
            linear[glass] = (1.0 - share) * linear[glass] + share
            absorbed[window][glass] = 0.35

    def _albedo(self, fragments: Fragments) -> NDArray[np.float32]:
        own = fragments.face_index < self.n_own
        person = Fragments(np.where(own, fragments.face_index, -1), fragments.barycentric, fragments.depth)
        colours = self.paint(person)
        if len(self.faces) > self.n_own:
            props = fragments.interpolate(self.faces, self.colours)
            colours[~own] = props[~own]
        return colours

    def add_grain(self, color: NDArray[np.uint8], rng: np.random.Generator) -> NDArray[np.uint8]:
        """Return the picture with a camera's noise."""
        i, j = rng.integers(0, 64, 2)
        height, width = KINECT_SIZE
        return np.clip(color + self.grain[i : i + height, j : j + width], 0, 255).astype(np.uint8)


def _under_clothes(subject: SimulatedCaptureSubject) -> NDArray[np.bool_]:
    """Return the vertices of the face below the collar, where shoulders that a face brings along must not show."""
    hidden = np.zeros(subject.face.topology.n_vertices, dtype=bool)
    n = subject.face.n_skin
    hidden[:n] = subject.person.neutral[:n, 1] < subject.torso.vertices[:, 1].max() - _COLLAR_MM
    return hidden


def _neck_bend(subject: SimulatedCaptureSubject) -> tuple[NDArray[np.intp], NDArray[np.float64]]:
    """Return the neck's vertices, and for each how far it follows the head, 1, or the torso, 0."""
    face, neutral = subject.face, subject.person.neutral
    below = neutral[face.topology.landmarks["ibug68"][8], 1] - _NECK_RIGID_MM - neutral[: face.n_skin, 1]
    t = np.clip(below / _NECK_BENDS_MM, 0.0, 1.0)
    neck = np.flatnonzero(t > 0)
    return neck, (1.0 - t * t * (3.0 - 2.0 * t))[neck]


def _window(pixels: NDArray[np.float64], size: tuple[int, int]) -> tuple[slice, slice] | None:
    """Return the rows and columns of a picture that hold these pixels and a rim, or None."""
    low = np.maximum(np.floor(pixels.min(axis=0)).astype(int) - 2, 0)
    high = np.minimum(np.ceil(pixels.max(axis=0)).astype(int) + 3, [size[1], size[0]])
    if (high <= low).any():
        return None
    return slice(int(low[1]), int(high[1])), slice(int(low[0]), int(high[0]))


class _Drawn(NamedTuple):
    """A mesh before a background: what pixel centres see of it, and the share (H, W) of each pixel that it covers."""

    fragments: Fragments
    share: NDArray[np.float32]

    def over(self, shown: NDArray[np.float32], behind: NDArray[np.float32]) -> NDArray[np.float32]:
        """Lay the mesh's linear colours (H, W, 3) over those behind it, with smooth outlines."""
        covered = self.fragments.covered
        # Pixels that the mesh covers, but not at their centre, get the mean colour of their neighbours.
        row, column = np.nonzero((self.share > 0) & ~covered)
        total, weight = np.zeros((len(row), 3), np.float32), np.zeros((len(row), 1), np.float32)
        for down, right in ((-1, 0), (1, 0), (0, -1), (0, 1), (-1, -1), (-1, 1), (1, -1), (1, 1)):
            v = np.clip(row + down, 0, covered.shape[0] - 1)
            u = np.clip(column + right, 0, covered.shape[1] - 1)
            there = covered[v, u, None]
            total += there * shown[v, u]
            weight += there
        colours, share = shown.copy(), self.share.copy()
        colours[row, column] = total / np.maximum(weight, 1.0)
        share[row, column] *= weight[:, 0] > 0
        return behind + share[..., None] * (colours - behind)


def _draw(
    pixels: NDArray[np.float64],
    depth: NDArray[np.float64],
    faces: NDArray[np.int32],
    behind: NDArray[np.float32],
) -> _Drawn:
    """Rasterise a mesh where it is before the depth `behind` (H, W), nine samples a pixel."""
    height, width = behind.shape
    # The middle one of the nine is the pixel's centre.
    fine = rasterise(3.0 * pixels + 1.0, depth, faces, (3 * height, 3 * width), cull_back_faces=True)
    before = fine.depth < np.repeat(np.repeat(behind, 3, axis=0), 3, axis=1)
    share = before.reshape(height, 3, width, 3).mean(axis=(1, 3), dtype=np.float32)
    middle = (slice(1, None, 3), slice(1, None, 3))
    index = np.where(before[middle], fine.face_index[middle], -1)
    return _Drawn(Fragments(index, fine.barycentric[middle], fine.depth[middle]), share)


def _finish(linear: NDArray[np.float32]) -> NDArray[np.uint8]:
    """Turn linear light (H, W, 3) into a picture as soft as lens and Bayer pattern leave it."""
    picture = 255.0 * srgb_from_linear(linear)
    for axis in (0, 1):
        inner = [slice(None), slice(None)]
        before, after = list(inner), list(inner)
        inner[axis], before[axis], after[axis] = slice(1, -1), slice(None, -2), slice(2, None)
        soft = picture.copy()
        soft[tuple(inner)] += _SOFT * (picture[tuple(before)] + picture[tuple(after)])
        soft[tuple(inner)] /= 1.0 + 2.0 * _SOFT
        picture = soft
    return np.rint(picture).astype(np.uint8)
