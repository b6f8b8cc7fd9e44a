"""Mouth and eyes of a photo in another view: what the photo shows of them, and what it does not."""

from __future__ import annotations

from collections.abc import Callable
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from facewright.faces.face import Face
from facewright.imaging._inner_kernels import (
    GRAIN_X,
    LID,
    LID_R,
    N_SKIN_COLUMNS,
    RIM,
    SHEEN,
    WET,
    compose,
    upper_edges,
)
from facewright.imaging.colour import srgb_from_linear
from facewright.imaging.expression_shading import ExpressionShading
from facewright.imaging.eye_layer import LID_SHADOW, LID_SHADOW_MM
from facewright.imaging.eye_turning import EyeTurning
from facewright.imaging.inner_looks import NO_EYE, NO_LINE, NO_MOUTH, EyeLook, MouthLook
from facewright.imaging.inner_parts import (
    EYE,
    SIDES,
    SKIN,
    SOCKET,
    Opening,
    eyeball,
    openings,
)
from facewright.imaging.inner_sources import (
    LIP_SHADOW,
    EyeSource,
    MouthSource,
    OpeningSource,
    behind_lip,
    box_round,
    eye_source,
    mouth_source,
    px_per_mm,
)
from facewright.imaging.lid_skin import unit_normals
from facewright.imaging.mesh_view import MeshView
from facewright.imaging.photo_light import PhotoLight, estimate_light
from facewright.imaging.rasterise import rasterise
from facewright.numeric.check import check_shape

_TOUCH_MM = 0.9
#: The dark line between lips that touch: how dark, and half its width, mm.
_SEAM, _SEAM_MM = 0.65, 0.3
#: Motion of an opening against itself, mm: below the first the plain warp of the photo is right.
_MOTION_MM = (0.25, 1.0)
_ENCODE = (255.0 * srgb_from_linear(np.linspace(0, 1, 4096))).astype(np.float32)
#: Openings smaller than this, pixels, get more samples.
_FINE_BELOW = 90
_compose: Callable[..., None] = compose
#: The triangle that each pixel of a box shows, and the box's first pixel.
Front = tuple[NDArray[np.int32], tuple[int, int]]


class InnerFace:
    """Draws mouth and eyes over a warped photo, where they open, close or turn.

    Parameters
    ----------
    photo : ndarray of shape (H, W, 3), uint8
        The photo.
    source : MeshView
        The fitted mesh as the photo sees it, all parts of `face`.
    face : Face
        Its topology.
    light : PhotoLight
        The photo's light.
    gaze : ndarray of shape (2, 2), radians, optional
        Yaw and pitch of the right and left eyeball in the photo; as the source's eyeballs stand where absent.

    Notes
    -----
    Teeth, tongue and eyeballs that the photo shows keep its pixels, on layers that move with skull, jaw and eyeball;
    the rest is drawn in the photo's light. Lips and lids come from the photo without what showed between them, so that
    no tooth or eye is dragged along; a lid that closes is drawn from clean lid skin.
    """

    def __init__(
        self,
        photo: NDArray[np.uint8],
        source: MeshView,
        face: Face,
        light: PhotoLight,
        gaze: NDArray[np.floating] | None = None,
    ) -> None:
        check_shape("photo", photo, "H", "W", 3)
        check_shape("source.pixels", source.pixels, face.topology.n_vertices, 2)
        self.face, self.source, self.light = face, source, light
        self._turning = EyeTurning(source, face, gaze)
        self._size = photo.shape[:2]
        mouth, *eyes = openings(face)
        prepared = [eye_source(photo, source, face, light, eye) for eye in eyes]
        self._eyes = [eye for eye in prepared if eye is not None]
        self._mouth = mouth_source(photo, source, face, light, mouth, self._eyes)
        self._shading = ExpressionShading.of(photo, source, face, light)

    @classmethod
    def of(
        cls,
        photo: NDArray[np.uint8],
        source: MeshView,
        face: Face,
        light: PhotoLight | None = None,
        gaze: NDArray[np.floating] | None = None,
    ) -> InnerFace:
        """Prepare a photo; the light is estimated where absent. See the class."""
        return cls(photo, source, face, light or estimate_light(photo, source, face), gaze)

    def paint(
        self,
        image: NDArray[np.uint8],
        target: MeshView,
        gaze: NDArray[np.floating] | None = None,
        touched: NDArray[np.bool_] | None = None,
        front: Front | None = None,
    ) -> None:
        """Draw mouth and eyes into the warped photo, in place.

        Parameters
        ----------
        image : ndarray of shape (H, W, 3), uint8
            The photo warped to `target`, C-contiguous; what lies between lips or lids in it does not matter unless the
            opening only moves as a whole: then nothing is drawn and the warp is right.
        target : MeshView
            The wanted view, all parts. Its eyeballs carry the gaze unless `gaze` is given.
        gaze : ndarray of shape (2, 2), radians, optional
            Wanted yaw and pitch of the right and the left eyeball.
        touched : ndarray of shape (H, W), bool, optional
            Set where pixels were drawn.
        front : tuple of ndarray of shape (h, w), int32, and (x, y), optional
            The face's triangle that each pixel of a box shows, -1 for none, and where the box begins: nothing is drawn
            where other skin is in front, as a nose is of the far eye. Without it nothing is in front.
        """
        sizes = check_shape("image", image, *self._size, 3)
        check_shape("target.pixels", target.pixels, self.face.topology.n_vertices, 2, **sizes)
        marks = np.zeros(self._size, np.bool_) if touched is None else touched
        for eye in self._eyes:
            own = None if gaze is None else np.asarray(gaze, np.float64)[SIDES.index(eye.opening.name)]
            self._paint_eye(image, marks, eye, target, own, front)
        if self._mouth is not None:
            self._paint_mouth(image, marks, self._mouth, target, front)
        self._shading.paint(image, marks, target, self._turning.of_head(target))

    def _paint_eye(
        self,
        image: NDArray[np.uint8],
        marks: NDArray[np.bool_],
        eye: EyeSource,
        target: MeshView,
        gaze: NDArray[np.floating] | None,
        front: Front | None,
    ) -> None:
        opening, lid = eye.opening, eye.lid
        ids = opening.vertices
        pixels, seen, scale = target.pixels[ids], target.camera_vertices[ids], px_per_mm(target, opening)
        balls = opening.places(eyeball(self.face, opening.name))
        moved = _own_motion(eye, pixels) / scale
        places = self._turning.places(opening.name, target, gaze)
        if gaze is not None:
            turned = places - self.source.pixels[eyeball(self.face, opening.name)]
            moved = max(moved, float(np.abs(turned - turned.mean(axis=0)).max()) / scale)
        mix = _ease((moved - _MOTION_MM[0]) / (_MOTION_MM[1] - _MOTION_MM[0]))
        if mix <= 0:
            return
        skin = np.zeros((len(ids), N_SKIN_COLUMNS), np.float32)
        skin[:, :2] = eye.pixels
        skin[balls, :2] = places
        skin[:, LID] = lid.weights(opening, pixels, _gap(opening, seen))
        if skin[:, LID].any():
            normals = unit_normals(np.ascontiguousarray(seen), opening.faces[opening.kinds <= SOCKET])
            skin[:, LID_R : LID_R + 3] = lid.shaded(normals, self.light)
        skin[:, RIM], skin[:, GRAIN_X:] = opening.near, lid.grain
        skin[balls, GRAIN_X:] = 0.5 * (places + self._turning.still_places(opening.name, target))
        x, y = eye.ball.origin
        look = EyeLook(
            eye.grain,
            lid.lash_colour,
            NO_LINE,
            eye.ball.picture,
            np.float32(x),
            np.float32(y),
            eye.ball.iris,
            eye.ball.glint,
            np.float32(eye.ball.glint_origin[0]),
            np.float32(eye.ball.glint_origin[1]),
        )
        line = lid.lash_line(opening, pixels, skin[:, LID])
        self._draw(image, marks, eye, target, mix, skin, (LID_SHADOW, LID_SHADOW_MM), look, NO_MOUTH, front, line)

    def _paint_mouth(
        self,
        image: NDArray[np.uint8],
        marks: NDArray[np.bool_],
        source: MouthSource,
        target: MeshView,
        front: Front | None,
    ) -> None:
        opening = source.opening
        ids = opening.vertices
        pixels, seen, scale = target.pixels[ids], target.camera_vertices[ids], px_per_mm(target, opening)
        mix = _ease((_own_motion(source, pixels) / scale - _MOTION_MM[0]) / (_MOTION_MM[1] - _MOTION_MM[0]))
        if mix <= 0:
            return
        skin = np.zeros((len(ids), N_SKIN_COLUMNS), np.float32)
        skin[:, :2] = source.pixels
        skin[:, WET], skin[:, RIM] = self._wet(opening, seen), opening.near
        inner = np.flatnonzero(ids >= self.face.n_skin)
        normals = unit_normals(np.ascontiguousarray(seen), opening.faces[opening.kinds > SKIN])
        columns = source.columns.copy()
        columns[inner, :3] = self.light.irradiance(normals[inner])
        columns[inner, SHEEN] = np.clip(normals[inner] @ self._half, 0.0, 1.0) ** 40
        maps = [_layer_map(row, pixels, source.pixels, source.layers.origin) for row in source.rows]
        # the wider the mouth, the deeper light gets into it
        gap = float(np.percentile(_gap(opening, seen), 70))
        look = MouthLook(
            columns,
            source.flesh,
            source.tooth,
            source.wall,
            np.float32(11.0 + 0.8 * gap),
            np.float32(source.tongue * _ease((gap - 3.0) / 9.0)),
            np.float32(self._key),
            np.float32(source.behind),
            source.slit,
            source.layers.skull,
            maps[0],
            source.layers.jaw,
            maps[1],
        )
        shadow = (LIP_SHADOW, behind_lip(opening, source.rows[0], seen))
        seam = NO_EYE._replace(lash_colour=np.array([*source.slit[:3], _SEAM, max(_SEAM_MM, 0.5 / scale)], np.float32))
        line = _seam_line(opening, pixels, scale)
        self._draw(image, marks, source, target, mix, skin, shadow, seam, look, front, line)

    def _wet(self, opening: Opening, seen: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return how dark the lips' inner sides are, (M,), and the line between closing lips."""
        shut = 1 - np.clip(_gap(opening, seen) / _TOUCH_MM, 0, 1)
        was_shut = 1 - np.clip(_gap(opening, self.source.camera_vertices[opening.vertices]) / _TOUCH_MM, 0, 1)
        line = np.clip(shut - was_shut, 0, 1)[opening.pair]
        return np.asarray(opening.hidden * opening.near + 1.3 * opening.seam * line)

    def _draw(
        self,
        image: NDArray[np.uint8],
        marks: NDArray[np.bool_],
        source: OpeningSource,
        target: MeshView,
        mix: float,
        skin: NDArray[np.float32],
        shadow: tuple[float, float],
        eye: EyeLook,
        mouth: MouthLook,
        front: Front | None,
        lashes: NDArray[np.float64] | None = None,
    ) -> None:
        """Find what the samples of an opening's box see in the target, and draw it."""
        opening = source.opening
        pixels = target.pixels[opening.vertices]
        x0, y0, x1, y1 = box_round(pixels[opening.rim], 3.0, self._size)
        if x1 <= x0 or y1 <= y0:
            return
        step = 3 if max(x1 - x0, y1 - y0) < _FINE_BELOW else 2
        fragments = rasterise(
            (pixels - (x0, y0) + 0.5) * step - 0.5,
            target.depth[opening.vertices],
            opening.faces,
            ((y1 - y0) * step, (x1 - x0) * step),
            perspective=target.perspective,
        )
        if front is not None:
            self._hide(fragments.face_index, opening, front, (x0, y0, x1, y1), step)
        edges = upper_edges(fragments.face_index, opening.kinds, EYE)
        line = np.zeros((3, edges.shape[1]), np.float32)
        if lashes is not None and len(lashes):
            line = _by_columns(lashes, (x0, y0), step, edges.shape[1])
        eye = eye._replace(lash_line=line)
        x, y = source.origin
        _compose(
            image, marks, x0, y0, step, fragments.face_index, fragments.barycentric, opening.faces, opening.kinds,
            edges, px_per_mm(target, opening), np.float32(mix), skin, source.skin, np.float32(x), np.float32(y),
            np.float32(shadow[0]), np.float32(shadow[1]), *eye, *mouth, _ENCODE,
        )  # fmt: skip

    def _hide(
        self, drawn: NDArray[np.int32], opening: Opening, front: Front, box: tuple[int, int, int, int], step: int
    ) -> None:
        """Take samples out, in place, of pixels that show skin which is not of the opening."""
        (x0, y0, x1, y1), (left, top) = box, front[1]
        low, high = max(x0, left), min(x1, left + front[0].shape[1])
        first, last = max(y0, top), min(y1, top + front[0].shape[0])
        if high <= low or last <= first:
            return
        shown = front[0][first - top : last - top, low - left : high - left]
        other = (self._foreign[opening.name][shown] & (shown >= 0)).repeat(step, axis=0).repeat(step, axis=1)
        drawn[(first - y0) * step : (last - y0) * step, (low - x0) * step : (high - x0) * step][other] = -1

    @cached_property
    def _foreign(self) -> dict[str, NDArray[np.bool_]]:
        """Triangles (F,) of the face's skin that are not of each opening."""
        faces = self.face.topology.faces
        skin = (faces < self.face.n_skin).all(axis=1)
        return {o.name: skin & ~np.isin(faces, o.vertices).all(axis=1) for o in openings(self.face)}

    @cached_property
    def _key(self) -> float:
        """Strength of the light that has a direction."""
        return float(self.light.lights().colours.mean())

    @cached_property
    def _half(self) -> NDArray[np.float64]:
        """Direction half way to the light, of surfaces that mirror it into the camera."""
        half = self.light.lights().directions[0] + (0.0, 0.0, -1.0)
        return np.asarray(half / max(float(np.linalg.norm(half)), 1e-9))


def _own_motion(source: OpeningSource, pixels: NDArray[np.float64]) -> float:
    """Return how far an opening moves against itself, pixels: beyond the best affine motion of its probes."""
    probes = source.opening.probes
    now, then = pixels[probes], source.pixels[probes]
    design = np.column_stack([then - then.mean(axis=0), np.ones(len(then))])
    fitted, *_ = np.linalg.lstsq(design, now, rcond=None)
    return float(np.abs(now - design @ fitted).max())


def _gap(opening: Opening, seen: NDArray[np.floating]) -> NDArray[np.float64]:
    """Return the distance between lips or lids at the pairs that touch, (K,), millimetres."""
    return np.asarray(np.linalg.norm(seen[opening.upper] - seen[opening.lower], axis=1))


def _seam_line(opening: Opening, pixels: NDArray[np.floating], scale: float) -> NDArray[np.float64]:
    """Return the dark line between lips where they touch, (K, 4): x, y, strength and width of its points."""
    order = np.argsort(pixels[opening.upper, 0])
    above, below = pixels[opening.upper][order], pixels[opening.lower][order]
    if len(order) < 2:
        return np.zeros((0, 4))
    at = 0.5 * (above + below)
    along = (at[-1] - at[0]) / max(float(np.linalg.norm(at[-1] - at[0])), 1e-9)
    gap = (below - above) @ (-along[1], along[0]) / scale  # below 0 where lips are pressed into one another
    strength = 1 - np.clip(gap / _TOUCH_MM - 0.5, 0, 1)
    ends = np.clip((1 - np.abs(np.linspace(-1.0, 1.0, len(order)))) / 0.15, 0, 1)
    return np.column_stack([at, strength * ends, np.ones(len(order))])


def _by_columns(points: NDArray[np.float64], origin: tuple[int, int], step: int, n: int) -> NDArray[np.float32]:
    """Return a line (K, 4) of x, y, strength and width by columns of samples, (3, n): row, strength, width."""
    x, y = ((points[:, k] - origin[k] + 0.5) * step - 0.5 for k in range(2))
    order = np.argsort(x)
    at = np.arange(n)
    values = [np.interp(at, x[order], v[order]) for v in (y, points[:, 2], points[:, 3])]
    values[1][(at < x.min()) | (at > x.max())] = 0.0
    return np.asarray(values, np.float32)


def _ease(value: float) -> float:
    w = min(max(value, 0.0), 1.0)
    return w * w * (3 - 2 * w)


def _layer_map(
    teeth: NDArray[np.intp],
    target: NDArray[np.float64],
    source: NDArray[np.float64],
    origin: tuple[int, int],
) -> NDArray[np.float64]:
    """Return the quadratic map from target to layer that the foremost teeth of a row say, (8, 2) as `compose` takes it.

    Rows: constant, x, y, x^2, xy, y^2, then middle and inverse size of the normalisation.
    """
    now, then = target[teeth], source[teeth] - origin
    middle = now.mean(axis=0)
    size = 1.0 / np.maximum(np.abs(now - middle).max(), 1e-6)
    d = (now - middle) * size
    design = np.column_stack([np.ones(len(d)), d, d[:, 0] ** 2, d[:, 0] * d[:, 1], d[:, 1] ** 2])
    # little curvature unless the teeth insist
    ridge = np.diag([0, 1e-6, 1e-6, 0.02, 0.02, 0.02]) * len(d)
    terms = np.linalg.solve(design.T @ design + ridge, design.T @ then)
    return np.concatenate([terms, middle[None], np.full((1, 2), size)])
