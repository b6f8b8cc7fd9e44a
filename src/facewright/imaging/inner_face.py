"""Mouth and eyes of a photo in another view: what the photo shows of them, and what it does not."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from facewright.faces.face import Face
from facewright.faces.rigid_motion import rigid_vertices
from facewright.imaging._inner_kernels import N_MOUTH_COLUMNS, N_SKIN_COLUMNS, compose, upper_edges
from facewright.imaging.colour import linear_from_srgb, srgb_from_linear
from facewright.imaging.eye_layer import IRIS_MM, LID_SHADOW, LID_SHADOW_MM, EyeLayer, eye_layer
from facewright.imaging.inner_parts import (
    EYE,
    LOWER_TOOTH,
    SIDES,
    SKIN,
    UPPER_TOOTH,
    Opening,
    eyeball,
    rigid_motion,
    sphere_centre,
    turn_of_gaze,
    openings,
    paint_map,
)
from facewright.imaging.lid_skin import LidSkin, lid_skin, unit_normals
from facewright.imaging.mesh_view import MeshView
from facewright.imaging.mouth_layer import MouthLayers, mouth_layers, trim_lips
from facewright.imaging.photo_light import PhotoLight, estimate_light
from facewright.imaging.rasterise import Fragments, rasterise
from facewright.imaging.skin_layer import skin_layer
from facewright.numeric.check import check_shape

#: sRGB of teeth, gums and tongue, and of the mouth's walls, in white light.
_TOOTH, _FLESH, _WALL = (0.86, 0.82, 0.75), (0.66, 0.33, 0.32), (0.50, 0.18, 0.17)
_TEETH_BEHIND_LIPS_MM = 6.0
_TOUCH_MM = 0.9
_TOOTH_OF_SCLERA = np.array([1.0, 0.97, 0.86])
#: Motion of an opening against itself, mm: below the first the plain warp of the photo is right.
_MOTION_MM = (0.25, 1.0)
_ENCODE = (255.0 * srgb_from_linear(np.linspace(0, 1, 4096))).astype(np.float32)
_NO_LAYER = np.zeros((0, 0, 5), np.float32)
_NO_PICTURE = np.zeros((2, 2, 3), np.float32)


@dataclass(frozen=True, eq=False)
class _Prepared:
    """What depends on the photo only, of one opening."""

    opening: Opening
    pixels: NDArray[np.float64]  # (M, 2) in the photo
    skin_picture: NDArray[np.float32]
    grain: NDArray[np.float32]  # the photo's fine texture, about 0
    origin: tuple[int, int]
    lid: LidSkin | None = None
    eye: EyeLayer | None = None
    layers: MouthLayers | None = None
    mouth: NDArray[np.float32] | None = None  # (M, N_MOUTH_COLUMNS) but for the light
    rows: tuple[NDArray[np.intp], NDArray[np.intp]] | None = None  # foremost upper and lower teeth


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
        self._gaze = None if gaze is None else np.asarray(gaze, np.float64)
        self._size = photo.shape[:2]
        mouth, *eyes = openings(face)
        self._eyes = [self._prepare_eye(photo, eye) for eye in eyes]
        self._mouth = self._prepare_mouth(photo, mouth)

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
        """
        sizes = check_shape("image", image, *self._size, 3)
        check_shape("target.pixels", target.pixels, self.face.topology.n_vertices, 2, **sizes)
        marks = np.zeros(self._size, np.bool_) if touched is None else touched
        for k, prepared in enumerate(self._eyes):
            self._paint_eye(image, marks, prepared, target, None if gaze is None else np.asarray(gaze)[k])
        self._paint_mouth(image, marks, self._mouth, target)

    # ---- preparation

    def _look(self, opening: Opening, margin_mm: float) -> tuple[tuple[int, int, int, int], Fragments, float]:
        """Return the box round an opening in the photo, what its pixels see of it, and pixels per millimetre."""
        pixels = self.source.pixels[opening.vertices]
        scale = _px_per_mm(self.source, opening)
        box = _box(pixels[opening.rim], margin_mm * scale + 3, self._size)
        x0, y0, x1, y1 = box
        fragments = rasterise(
            pixels - (x0, y0),
            self.source.depth[opening.vertices],
            opening.faces,
            (y1 - y0, x1 - x0),
            perspective=self.source.perspective,
        )
        return box, fragments, scale

    def _prepare_eye(self, photo: NDArray[np.uint8], opening: Opening) -> _Prepared:
        (x0, y0, x1, y1), fragments, scale = self._look(opening, 8.0)
        crop = photo[y0:y1, x0:x1]
        kinds = np.where(fragments.covered, opening.kinds[fragments.face_index], SKIN)
        inside = kinds > SKIN
        # no more than the very edge: lashes differ from skin, and shall stay
        edge = max(1.0, 0.3 * scale)
        picture = skin_layer(crop, inside, inset_px=edge, doubt_px=edge)
        edges = upper_edges(fragments.face_index, opening.kinds, EYE)[0]
        rows = np.arange(inside.shape[0])[:, None]
        below = np.where(edges >= 0, (rows - edges) / scale, 0.0)
        iris = self.face.topology.masks[f"iris_{opening.name}"]
        centre = self.source.pixels[iris].mean(axis=0) - (x0, y0)
        white = self.light.irradiance(np.array([[0.0, 0.0, -1.0]]))[0]
        layer = eye_layer(crop, (x0, y0), kinds == EYE, below, np.array([*centre, IRIS_MM * scale]), scale, white)
        lid = lid_skin(photo, self.source, self.face, opening)
        return _Prepared(
            opening, self.source.pixels[opening.vertices], picture, _fine(crop, scale), (x0, y0), lid, layer
        )

    def _prepare_mouth(self, photo: NDArray[np.uint8], opening: Opening) -> _Prepared:
        (x0, y0, x1, y1), fragments, scale = self._look(opening, 10.0)
        crop = photo[y0:y1, x0:x1]
        kinds = np.where(fragments.covered, opening.kinds[fragments.face_index], SKIN)
        lips = self._lips(opening, fragments)
        colour = np.median(crop[lips & (kinds == SKIN)].astype(np.float64), axis=0) if lips.any() else np.full(3, 128.0)
        inside = trim_lips(crop, kinds > SKIN, colour, round(3.0 * scale))
        picture = skin_layer(
            crop,
            inside | self._seam(opening, fragments, scale),
            inset_px=max(1.0, 0.4 * scale),
            doubt_px=max(2.0, 2.0 * scale),
            wanted=lips,
        )
        white = self.light.irradiance(np.array([[0.0, 0.0, -1.0]]))[0]
        gum = 0.5 * colour + 0.5 * 255.0 * srgb_from_linear(0.9 * white * linear_from_srgb(np.array(_FLESH)))
        layers = mouth_layers(crop, (x0, y0), inside, colour, self._incisal(opening, (x0, y0, x1, y1)), scale, gum)
        self._prepare_colours(layers)
        rows = tuple(
            np.intersect1d(opening.probes, opening.faces[opening.kinds == kind]) for kind in (UPPER_TOOTH, LOWER_TOOTH)
        )
        return _Prepared(
            opening,
            self.source.pixels[opening.vertices],
            picture,
            _NO_PICTURE,
            (x0, y0),
            layers=layers,
            mouth=self._mouth_columns(opening),
            rows=rows,
        )

    def _lips(self, opening: Opening, fragments: Fragments) -> NDArray[np.bool_]:
        weight = np.zeros((len(opening.vertices), 1), np.float32)
        weight[opening.rim] = 1.0
        return np.asarray(fragments.interpolate(opening.faces, weight)[..., 0] > 0.5)

    def _seam(self, opening: Opening, fragments: Fragments, scale: float) -> NDArray[np.bool_]:
        """Return the pixels along the line between closed lips: a dark line, or teeth in a slit."""
        near = fragments.interpolate(opening.faces, opening.seam[:, None])[..., 0]
        return np.asarray(fragments.covered & (near > (0.5 if scale > 1 else 0.25)))

    def _incisal(self, opening: Opening, box: tuple[int, int, int, int]) -> NDArray[np.float64]:
        """Return the lowest row of the drawn upper teeth in each column of a box in the photo."""
        x0, y0, x1, y1 = box
        teeth = opening.faces[opening.kinds == UPPER_TOOTH]
        pixels, depth = self.source.pixels[opening.vertices], self.source.depth[opening.vertices]
        size = (y1 - y0, x1 - x0)
        seen = rasterise(pixels - (x0, y0), depth, teeth, size, perspective=self.source.perspective).covered
        lowest = (size[0] - 1 - seen[::-1].argmax(axis=0)).astype(np.float64)
        return np.where(seen.any(axis=0), lowest, np.nan)

    def _prepare_colours(self, layers: MouthLayers) -> None:
        """Choose the linear albedos of teeth, flesh and walls: those of the photo where it shows them."""
        white = self.light.irradiance(np.array([[0.0, 0.0, -1.0]]))[0]
        tooth = linear_from_srgb(np.array(_TOOTH)).astype(np.float64)
        open_eyes = [prepared.eye.sclera for prepared in self._eyes if prepared.eye is not None and prepared.eye.seen]
        if layers.tooth is not None:
            tooth = linear_from_srgb(layers.tooth / 255.0) / np.maximum(0.85 * white, 1e-3)
        elif open_eyes:
            # what is white in the same light tells the light better than skin does, shaded by lids as it is
            sclera = max(open_eyes, key=lambda colour: float(np.sum(colour)))
            told = _TOOTH_OF_SCLERA * sclera / np.maximum(white, 1e-3)
            tooth = tooth * np.clip(told / tooth, 0.5, 1.5) ** 0.7
        if layers.tooth is None:  # not brighter than what else is bright in the face
            brightest = max(float(colour.sum()) for colour in (*open_eyes, self.light.highlight))
            tooth = tooth * min(1.0, 1.15 * brightest / float((tooth * white).sum()))
        self._tooth = np.clip(tooth, 0.03, 1.1).astype(np.float32)
        self._flesh = linear_from_srgb(np.array(_FLESH)).astype(np.float32)
        self._wall = linear_from_srgb(np.array(_WALL)).astype(np.float32)

    # ---- drawing

    def _paint_eye(
        self,
        image: NDArray[np.uint8],
        marks: NDArray[np.bool_],
        prepared: _Prepared,
        target: MeshView,
        gaze: NDArray[np.floating] | None,
    ) -> None:
        opening, eye, lid = prepared.opening, prepared.eye, prepared.lid
        assert eye is not None and lid is not None
        ids = opening.vertices
        pixels, seen = target.pixels[ids], target.camera_vertices[ids]
        scale = _px_per_mm(target, opening)
        lookup = self._eyeball_places(opening.name, target, gaze)
        moved = self._motion(prepared, pixels, scale)
        balls = np.flatnonzero(np.isin(ids, eyeball(self.face, opening.name)))
        if gaze is not None:
            turned = lookup - self.source.pixels[ids[balls]]
            moved = max(moved, float(np.abs(turned - turned.mean(axis=0)).max()) / scale)
        mix = _ease((moved - _MOTION_MM[0]) / (_MOTION_MM[1] - _MOTION_MM[0]))
        if mix <= 0:
            return
        gap = _gap(opening, seen)
        skin = np.zeros((len(ids), N_SKIN_COLUMNS), np.float32)
        skin[:, :2] = prepared.pixels
        skin[balls, :2] = lookup
        skin[:, 2] = lid.weights(opening, pixels, gap)
        if skin[:, 2].any():
            normals = unit_normals(np.ascontiguousarray(seen), opening.faces[opening.kinds <= 1])
            skin[:, 3:6] = lid.shaded(normals, self.light)
        skin[:, 6], skin[:, 8], skin[:, 9:] = lid.lash_mm, opening.near, lid.grain
        self._draw(
            image, marks, prepared, target, scale, mix, skin, np.zeros((len(ids), N_MOUTH_COLUMNS), np.float32),
            eye.picture, eye.origin, LID_SHADOW, LID_SHADOW_MM, lid.lash_colour, 1.0, None,
        )  # fmt: skip

    def _paint_mouth(
        self, image: NDArray[np.uint8], marks: NDArray[np.bool_], prepared: _Prepared, target: MeshView
    ) -> None:
        opening, layers = prepared.opening, prepared.layers
        assert layers is not None and prepared.mouth is not None and prepared.rows is not None
        ids = opening.vertices
        pixels, seen = target.pixels[ids], target.camera_vertices[ids]
        scale = _px_per_mm(target, opening)
        mix = _ease((self._motion(prepared, pixels, scale) - _MOTION_MM[0]) / (_MOTION_MM[1] - _MOTION_MM[0]))
        if mix <= 0:
            return
        skin = np.zeros((len(ids), N_SKIN_COLUMNS), np.float32)
        skin[:, :2] = prepared.pixels
        skin[:, 7], skin[:, 8] = self._wet(prepared, seen), opening.near
        inner = np.flatnonzero(ids >= self.face.n_skin)
        normals = unit_normals(np.ascontiguousarray(seen), opening.faces[opening.kinds > SKIN])
        mouth = prepared.mouth.copy()
        mouth[inner, :3] = self.light.irradiance(normals[inner])
        gap = _gap(opening, seen)
        height = float(np.percentile(gap, 70)) if len(gap) else 0.0
        maps = tuple(_layer_map(row, pixels, prepared.pixels, layers.origin) for row in prepared.rows)
        self._draw(
            image, marks, prepared, target, scale, mix, skin, mouth,
            _NO_PICTURE, (0, 0), 0.28, 1.5, np.zeros(5, np.float32), 8.0 + 1.3 * height, maps,
        )  # fmt: skip

    def _wet(self, prepared: _Prepared, seen: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return how dark the lips' inner sides are, (M,), and the line between closing lips."""
        opening = prepared.opening
        shut = 1 - np.clip(_gap(opening, seen) / _TOUCH_MM, 0, 1)
        was_shut = 1 - np.clip(_gap(opening, self.source.camera_vertices[opening.vertices]) / _TOUCH_MM, 0, 1)
        line = np.clip(shut - was_shut, 0, 1)[opening.pair]
        return np.asarray(opening.hidden * opening.near + 1.3 * opening.seam * line)

    def _mouth_columns(self, opening: Opening) -> NDArray[np.float32]:
        """Return what the mouth's vertices are made of, in the columns that `compose` takes; the light is 0 yet."""
        mouth = np.zeros((len(opening.vertices), N_MOUTH_COLUMNS), np.float32)
        paint = paint_map(self.face)
        attributes = paint.columns(paint.attributes[opening.vertices])
        mouth[:, 3], mouth[:, 4], mouth[:, 5] = attributes["flesh"], attributes["cavity"], attributes["groove"]
        z = self.face.mean_shape[opening.vertices, 2]
        mouth[:, 6] = np.maximum(z[opening.rim].max() - _TEETH_BEHIND_LIPS_MM - z, 0.0)
        return mouth

    def _draw(
        self,
        image: NDArray[np.uint8],
        marks: NDArray[np.bool_],
        prepared: _Prepared,
        target: MeshView,
        scale: float,
        mix: float,
        skin: NDArray[np.float32],
        mouth: NDArray[np.float32],
        eye_picture: NDArray[np.float32],
        eye_origin: tuple[int, int],
        shadow: float,
        shadow_mm: float,
        lash_colour: NDArray[np.float32],
        depth_mm: float,
        maps: tuple[NDArray[np.float64], ...] | None,
    ) -> None:
        opening, layers = prepared.opening, prepared.layers
        pixels = target.pixels[opening.vertices]
        x0, y0, x1, y1 = _box(pixels[opening.rim], 3.0, self._size)
        if x1 <= x0 or y1 <= y0:
            return
        step = 3 if max(x1 - x0, y1 - y0) < 45 else 2
        fragments = rasterise(
            (pixels - (x0, y0) + 0.5) * step - 0.5,
            target.depth[opening.vertices],
            opening.faces,
            ((y1 - y0) * step, (x1 - x0) * step),
            perspective=target.perspective,
        )
        edges = upper_edges(fragments.face_index, opening.kinds, EYE)
        nowhere = np.zeros((8, 2))
        compose(
            image, marks, x0, y0, step, fragments.face_index, fragments.barycentric, opening.faces, opening.kinds,
            edges, scale, np.float32(mix),
            skin, prepared.skin_picture, prepared.grain, *map(np.float32, prepared.origin), lash_colour,
            eye_picture, *map(np.float32, eye_origin), np.float32(shadow), np.float32(shadow_mm),
            mouth, self._flesh, self._tooth, self._wall, np.float32(depth_mm),
            _NO_LAYER if layers is None else layers.skull, nowhere if maps is None else maps[0],
            _NO_LAYER if layers is None else layers.jaw, nowhere if maps is None else maps[1],
            _ENCODE,
        )  # fmt: skip

    def _motion(self, prepared: _Prepared, pixels: NDArray[np.float64], scale: float) -> float:
        """Return how far an opening moves against itself, mm: beyond the best affine motion of its probes."""
        probes = prepared.opening.probes
        now, then = pixels[probes], prepared.pixels[probes]
        design = np.column_stack([then - then.mean(axis=0), np.ones(len(then))])
        fitted, *_ = np.linalg.lstsq(design, now, rcond=None)
        return float(np.abs(now - design @ fitted).max()) / max(scale, 1e-9)

    def _eyeball_places(self, side: str, target: MeshView, gaze: NDArray[np.floating] | None) -> NDArray[np.float64]:
        """Return where in the photo the eyeball's vertices are shown, (N, 2), by what the target's show."""
        ids = eyeball(self.face, side)
        here = self.source.pixels[ids]
        if gaze is None:
            return here
        then, now = self.source.camera_vertices[ids], target.camera_vertices[ids]
        centre = sphere_centre(then)
        own, shift = rigid_motion(then, now)
        back = (now - (own @ centre + shift)) @ self._eyeball_turn(side, target, gaze)
        design = np.column_stack([then - centre, np.ones(len(then))])
        affine, *_ = np.linalg.lstsq(design, here, rcond=None)
        return np.asarray(np.column_stack([back, np.ones(len(back))]) @ affine)

    def _eyeball_turn(self, side: str, target: MeshView, gaze: NDArray[np.floating]) -> NDArray[np.float64]:
        """Return the rotation from an eyeball as the photo has it to the wanted one, in the camera's axes, (3, 3)."""
        teeth = rigid_vertices(self.face, "teeth_upper")  # they are fixed to the skull
        rest, then = self.face.mean_shape[teeth].astype(np.float64), self.source.camera_vertices[teeth]
        head, _ = rigid_motion(rest, then)
        moved, _ = rigid_motion(then, target.camera_vertices[teeth])
        if self._gaze is None:
            centre = sphere_centre(self.source.camera_vertices[eyeball(self.face, side)])
            iris = self.source.camera_vertices[self.face.topology.masks[f"iris_{side}"]].mean(axis=0)
            x, y, z = head.T @ (iris - centre)
            own = np.array([np.arctan2(x, z), np.arctan2(y, np.hypot(x, z))])
        else:
            own = self._gaze[SIDES.index(side)]
        return np.asarray(moved @ head @ turn_of_gaze(gaze) @ turn_of_gaze(own).T @ head.T)


def _fine(photo: NDArray[np.uint8], scale: float) -> NDArray[np.float32]:
    """Return pores and grain of a cut-out of the photo, without its lines and edges: (h, w, 3) about 0."""
    values = photo.astype(np.float32)
    sigma = max(1.0, 0.6 * scale)
    fine = values - ndimage.gaussian_filter(values, (sigma, sigma, 0))
    limit = 3.0 * np.median(np.abs(fine))
    return np.asarray(np.clip(fine, -limit, limit), np.float32)


def _gap(opening: Opening, seen: NDArray[np.floating]) -> NDArray[np.float64]:
    """Return the distance between lips or lids at the pairs that touch, (K,), millimetres."""
    return np.asarray(np.linalg.norm(seen[opening.upper] - seen[opening.lower], axis=1))


def _ease(value: float) -> float:
    w = min(max(value, 0.0), 1.0)
    return w * w * (3 - 2 * w)


def _box(pixels: NDArray[np.floating], margin: float, size: tuple[int, ...]) -> tuple[int, int, int, int]:
    """Return first and last column and row (exclusive) round points, within the picture."""
    low = np.floor(pixels.min(axis=0) - margin).astype(int)
    high = np.ceil(pixels.max(axis=0) + margin).astype(int) + 1
    x0, y0 = np.clip(low, 0, (size[1], size[0]))
    x1, y1 = np.clip(high, 0, (size[1], size[0]))
    return int(x0), int(y0), int(x1), int(y1)


def _px_per_mm(view: MeshView, opening: Opening) -> float:
    """Return the scale of a view at an opening, pixels per millimetre."""
    ids = opening.vertices[opening.rim[::5]]
    flat, deep = view.pixels[ids], view.camera_vertices[ids, :2]
    spread = np.linalg.norm(deep - deep.mean(axis=0))
    return float(np.linalg.norm(flat - flat.mean(axis=0)) / max(float(spread), 1e-9))


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
