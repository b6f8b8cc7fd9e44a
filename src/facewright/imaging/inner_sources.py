"""What a photo tells of its mouth and eyes once and for all, before any of them is drawn in another view."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from facewright.faces.builtin_parts import GUM_OF_SECTION
from facewright.faces.face import Face
from facewright.imaging._inner_kernels import CROWN, N_MOUTH_COLUMNS, TOOTH, unshade, upper_edges
from facewright.imaging.colour import linear_from_srgb, srgb_from_linear
from facewright.imaging.eye_layer import IRIS_MM, EyeLayer, eye_layer, eye_light
from facewright.imaging.inner_parts import EYE, LOWER_TOOTH, SKIN, UPPER_TOOTH, Opening, paint_map
from facewright.imaging.lid_skin import LidSkin, lid_skin
from facewright.imaging.mesh_view import MeshView
from facewright.imaging.mouth_layer import MouthLayers, mouth_layers, teeth_in_slit, trim_lips
from facewright.imaging.photo_light import PhotoLight
from facewright.imaging.rasterise import Fragments, rasterise
from facewright.imaging.skin_layer import skin_layer
from facewright.imaging.wide_blur import wide_blur

#: sRGB of teeth, gums and tongue, and of the mouth's walls, in white light.
_TOOTH, _FLESH, _WALL = (0.86, 0.82, 0.75), (0.66, 0.33, 0.32), (0.50, 0.18, 0.17)
_TEETH_BEHIND_LIPS_MM = 6.0
_TOOTH_OF_SCLERA = np.array([1.0, 0.97, 0.86])
_TINT = 0.05
#: Depth of the shadow of the upper lip on teeth.
LIP_SHADOW = 0.25
#: Lips less than 0.36 of this apart show nothing but a dark line between them; teeth are plain from here on.
_SLIT_MM = 5.0
#: That line's colour as a share of the lips': warm, for what light there is comes off them.
_SLIT_TONE = np.array([0.40, 0.30, 0.30])
_FORWARD = np.array([[0.0, 0.0, -1.0]])
_LEAST_SIDE = 3  # pixels, of what a photo must show of an opening


@dataclass(frozen=True, eq=False)
class OpeningSource:
    """The photo's skin round one opening.

    Parameters
    ----------
    opening : Opening
        The mouth or an eye.
    pixels : ndarray of shape (M, 2), float64
        Its vertices in the photo.
    skin : ndarray of shape (h, w, 3), float32
        The photo round it without what shows between lips or lids, sRGB in [0, 255].
    origin : tuple of int
        Column and row of the photo at the first pixel of `skin`.
    """

    opening: Opening
    pixels: NDArray[np.float64]
    skin: NDArray[np.float32]
    origin: tuple[int, int]


@dataclass(frozen=True, eq=False)
class EyeSource(OpeningSource):
    """An eye: its lid's skin and fine texture, and its ball without lids."""

    grain: NDArray[np.float32]
    lid: LidSkin
    ball: EyeLayer


@dataclass(frozen=True, eq=False)
class MouthSource(OpeningSource):
    """The mouth: what the photo shows in it, and what the rest is made of.

    Parameters
    ----------
    layers : MouthLayers
        The photo's own teeth and tongue.
    columns : ndarray of shape (M, N_MOUTH_COLUMNS), float32
        What the vertices are made of, as the kernel takes it; the light is 0 yet.
    rows : two ndarrays of int
        Places of the foremost upper and lower teeth.
    tooth, flesh, wall : ndarray of shape (3,), float32
        Linear albedos.
    tongue : float
        1 where the face has no tongue of its own and one is to be drawn, else 0.
    behind : float
        How far the teeth lie behind the upper lip in the photo, mm.
    slit : ndarray of shape (5,), float32
        sRGB, [0, 255], of the dark between lips that hardly part, and the gaps, mm, up to which nothing else is seen
        and from which nothing of it is.
    """

    layers: MouthLayers
    columns: NDArray[np.float32]
    rows: tuple[NDArray[np.intp], NDArray[np.intp]]
    tooth: NDArray[np.float32]
    flesh: NDArray[np.float32]
    wall: NDArray[np.float32]
    tongue: float
    behind: float
    slit: NDArray[np.float32]


@dataclass(frozen=True, eq=False)
class _Look:
    """What a photo shows of an opening."""

    crop: NDArray[np.uint8]
    origin: tuple[int, int]
    fragments: Fragments
    kinds: NDArray[np.uint8]
    scale: float  # pixels per millimetre


def eye_source(
    photo: NDArray[np.uint8], view: MeshView, face: Face, light: PhotoLight, opening: Opening
) -> EyeSource | None:
    """Prepare an eye; None where it lies outside the photo."""
    look = _look(photo, view, opening, 8.0)
    if look is None:
        return None
    edge = max(1.0, 0.3 * look.scale)  # no more than the very edge: lashes differ from skin, and shall stay
    skin = skin_layer(look.crop, look.kinds > SKIN, inset_px=edge, doubt_px=edge)
    lit = _light_on_eye(look, upper_edges(look.fragments.face_index, opening.kinds, EYE))
    iris = view.pixels[face.topology.masks[f"iris_{opening.name}"]].mean(axis=0) - look.origin
    ball = eye_layer(
        look.crop,
        look.origin,
        look.kinds == EYE,
        lit,
        np.array([*iris, IRIS_MM * look.scale]),
        look.scale,
        light.irradiance(_FORWARD)[0],
    )
    return EyeSource(
        opening,
        view.pixels[opening.vertices],
        skin,
        look.origin,
        grain=_fine(look.crop, look.scale),
        lid=lid_skin(photo, view, face, opening),
        ball=ball,
    )


def mouth_source(
    photo: NDArray[np.uint8],
    view: MeshView,
    face: Face,
    light: PhotoLight,
    opening: Opening,
    eyes: list[EyeSource],
) -> MouthSource | None:
    """Prepare the mouth; None where it lies outside the photo. The eyes' white tells how bright teeth may be."""
    look = _look(photo, view, opening, 10.0)
    if look is None:
        return None
    lips = look.fragments.interpolate(opening.faces, _on(opening.rim, opening))[..., 0] > 0.5
    shown = look.crop[lips & (look.kinds == SKIN)]
    colour = np.median(shown.astype(np.float64), axis=0) if len(shown) else np.full(3, 128.0)
    inside = trim_lips(look.crop, look.kinds > SKIN, colour, round(3.0 * look.scale))
    seam = look.fragments.interpolate(opening.faces, opening.seam[:, None])[..., 0]
    line = inside | (seam > (0.5 if look.scale > 1 else 0.25))  # between closed lips: a dark line, or teeth in a slit
    skin = skin_layer(
        look.crop,
        line | teeth_in_slit(look.crop, line, lips, look.scale),
        inset_px=max(1.0, 0.4 * look.scale),
        doubt_px=max(2.0, 2.0 * look.scale),
        wanted=lips,
    )
    white = light.irradiance(_FORWARD)[0]
    gum = 0.5 * colour + 0.5 * 255.0 * srgb_from_linear(0.9 * white * linear_from_srgb(np.array(_FLESH)))
    layers = mouth_layers(look.crop, look.origin, inside, colour, _incisal(view, opening, look), look.scale, gum)
    behind = behind_lip(opening, _foremost(opening)[0], view.camera_vertices[opening.vertices])
    if inside.any():
        _unshade(layers, inside, look.scale, behind)
    return MouthSource(
        opening,
        view.pixels[opening.vertices],
        skin,
        look.origin,
        layers=layers,
        columns=_mouth_columns(face, opening),
        rows=_foremost(opening),
        tooth=_tooth_albedo(layers, eyes, light),
        flesh=linear_from_srgb(np.array(_FLESH)),
        wall=linear_from_srgb(np.array(_WALL)),
        tongue=float(not any("tongue" in name for name in face.topology.parts)),
        behind=behind,
        slit=_slit(colour, layers, inside, look.scale),
    )


def px_per_mm(view: MeshView, opening: Opening) -> float:
    """Return the scale of a view at an opening, pixels per millimetre."""
    ids = opening.vertices[opening.rim[::5]]
    flat, deep = view.pixels[ids], view.camera_vertices[ids, :2]
    spread = np.linalg.norm(deep - deep.mean(axis=0))
    return max(float(np.linalg.norm(flat - flat.mean(axis=0)) / max(float(spread), 1e-9)), 1e-6)


def box_round(pixels: NDArray[np.floating], margin: float, size: tuple[int, ...]) -> tuple[int, int, int, int]:
    """Return first and last column and row (exclusive) round points, x0, y0, x1, y1, within the picture."""
    low = np.clip(np.floor(pixels.min(axis=0) - margin), 0, (size[1], size[0])).astype(int)
    high = np.clip(np.ceil(pixels.max(axis=0) + margin) + 1, 0, (size[1], size[0])).astype(int)
    return int(low[0]), int(low[1]), int(high[0]), int(high[1])


def _look(photo: NDArray[np.uint8], view: MeshView, opening: Opening, margin_mm: float) -> _Look | None:
    pixels, scale = view.pixels[opening.vertices], px_per_mm(view, opening)
    x0, y0, x1, y1 = box_round(pixels[opening.rim], margin_mm * scale + 3, photo.shape[:2])
    if min(x1 - x0, y1 - y0) < _LEAST_SIDE:
        return None
    fragments = rasterise(
        pixels - (x0, y0),
        view.depth[opening.vertices],
        opening.faces,
        (y1 - y0, x1 - x0),
        perspective=view.perspective,
    )
    kinds = np.where(fragments.covered, opening.kinds[fragments.face_index], SKIN).astype(np.uint8)
    return _Look(photo[y0:y1, x0:x1], (x0, y0), fragments, kinds, scale)


def _foremost(opening: Opening) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
    """Return places of the foremost upper and lower teeth."""
    upper, lower = (opening.faces[opening.kinds == kind] for kind in (UPPER_TOOTH, LOWER_TOOTH))
    return np.intersect1d(opening.probes, upper), np.intersect1d(opening.probes, lower)


def behind_lip(opening: Opening, teeth: NDArray[np.intp], seen: NDArray[np.floating]) -> float:
    """Return how far the teeth lie behind the upper lip, mm: a smile draws it back to them, a kiss puts it forward.

    Parameters
    ----------
    opening : Opening
        The mouth.
    teeth : ndarray of int
        Places of the foremost upper teeth.
    seen : ndarray of shape (M, 3)
        Its vertices in the camera's axes.
    """
    return float(np.percentile(seen[teeth, 2], 25) - np.percentile(seen[opening.upper, 2], 25))


def _unshade(layers: MouthLayers, inside: NDArray[np.bool_], scale: float, behind: float) -> None:
    """Take the lips' shade off what the photo shows between them, in place."""
    columns = np.flatnonzero(inside.any(axis=0))
    at = np.arange(inside.shape[1])
    first = np.interp(at, columns, inside.argmax(axis=0)[columns])
    last = np.interp(at, columns, (len(inside) - 1 - inside[::-1].argmax(axis=0))[columns])
    middle, half = 0.5 * (columns[0] + columns[-1]), 0.5 * (columns[-1] - columns[0] + 1)
    for layer in (layers.skull, layers.jaw):
        if layer[..., 3].any():
            unshade(layer, first, last, middle, half, scale, behind)


def _slit(
    lips: NDArray[np.floating], layers: MouthLayers, inside: NDArray[np.bool_], scale: float
) -> NDArray[np.float32]:
    """Return what is seen between lips that hardly part, see `MouthSource`: a shadow of their own colour."""
    most = _SLIT_MM
    if layers.tooth is not None:  # teeth that the photo shows stay as they are
        heights = inside.sum(axis=0)[inside.any(axis=0)] / scale
        most = float(np.clip(0.8 * np.percentile(heights, 70), 0.6 * _SLIT_MM, _SLIT_MM))
    return np.array([*(_SLIT_TONE * lips), 0.36 * most, most], np.float32)


def _light_on_eye(look: _Look, edges: NDArray[np.float32]) -> NDArray[np.float32]:
    """Return the share of light (h, w) that lids leave on the eyeball in a cut-out; 1 beside the eye."""
    rows = np.arange(len(look.crop), dtype=np.float32)[:, None]
    columns = np.flatnonzero(edges[0] >= 0)
    if len(columns) == 0:
        return np.ones(look.crop.shape[:2], np.float32)
    middle, half = 0.5 * (columns[0] + columns[-1]), 0.5 * (columns[-1] - columns[0] + 1)
    corner = (half - np.abs(np.arange(edges.shape[1]) - middle)) / look.scale
    light = eye_light((rows - edges[0]) / look.scale, (edges[1] - rows) / look.scale, corner[None])
    return np.where(edges[0] >= 0, light, 1.0).astype(np.float32)


def _on(places: NDArray[np.intp], opening: Opening) -> NDArray[np.float32]:
    weight = np.zeros((len(opening.vertices), 1), np.float32)
    weight[places] = 1.0
    return weight


def _incisal(view: MeshView, opening: Opening, look: _Look) -> NDArray[np.float64]:
    """Return the lowest row of the drawn upper teeth in each column of the cut-out, NaN where there is none."""
    teeth = opening.faces[opening.kinds == UPPER_TOOTH]
    height, width = look.crop.shape[:2]
    at = view.pixels[opening.vertices] - look.origin
    depth = view.depth[opening.vertices]
    seen = rasterise(at, depth, teeth, (height, width), perspective=view.perspective).covered
    return np.where(seen.any(axis=0), height - 1.0 - seen[::-1].argmax(axis=0), np.nan)


def _tooth_albedo(layers: MouthLayers, eyes: list[EyeSource], light: PhotoLight) -> NDArray[np.float32]:
    """Return the teeth's linear albedo: as the photo shows them, else as bright as its light and eyes allow."""
    white = light.irradiance(_FORWARD)[0]
    tooth = linear_from_srgb(np.array(_TOOTH)).astype(np.float64)
    sclera = [eye.ball.sclera for eye in eyes if eye.ball.seen]
    if layers.tooth is not None:
        tooth = linear_from_srgb(layers.tooth / 255.0) / np.maximum(0.85 * white, 1e-3)
    else:
        if sclera:
            # what is white in the same light tells the light better than skin does, shaded by lids as it is
            told = _TOOTH_OF_SCLERA * max(sclera, key=lambda c: float(np.sum(c))) / np.maximum(white, 1e-3)
            # its brightness more than its hue, for which an eye in a dark photo is a poor witness
            ratio = np.clip(told / tooth, 0.5, 1.5)
            tooth = tooth * (0.3 * ratio + 0.7 * ratio.mean()) ** 0.7
        brightest = max(float(colour.sum()) for colour in (*sclera, light.highlight))
        if brightest > 0:  # not brighter than what else is bright in the face
            tooth = tooth * min(1.0, 1.35 * brightest / float((tooth * white).sum()))
    if layers.tooth is None:  # lips and gums around them tint teeth
        tint = light.skin_albedo / light.skin_albedo.mean()
        tooth = tooth * (tint / tint.max()) ** _TINT
    return np.clip(tooth, 0.03, 1.1).astype(np.float32)


def _mouth_columns(face: Face, opening: Opening) -> NDArray[np.float32]:
    """Return what the mouth's vertices are made of, in the columns that the kernel takes."""
    columns = np.zeros((len(opening.vertices), N_MOUTH_COLUMNS), np.float32)
    paint = paint_map(face)
    of = paint.columns(paint.attributes[opening.vertices])
    columns[:, 3], columns[:, 4], columns[:, 5] = of["flesh"], of["cavity"], of["groove"]
    z = face.mean_shape[opening.vertices, 2]
    columns[:, 6] = np.maximum(z[opening.rim].max() - _TEETH_BEHIND_LIPS_MM - z, 0.0)
    columns[:, TOOTH] = -1.0
    if face.topology.name == "builtin":  # its rows are tubes: sections along the arch, teeth but for the texture
        n = len(GUM_OF_SECTION)
        for part in ("teeth_upper", "teeth_lower"):
            start, stop = face.topology.parts[part]
            own = (opening.vertices >= start) & (opening.vertices < stop)
            section = np.arange((stop - start) // n)
            along = np.floor((section - 2) / 3) + np.choose((section - 2) % 3, [0.0, 0.19, 0.81]) + 2.0
            along = np.where(
                section < 2, section, np.where(section > section[-1] - 2, section - section[-1] + 15.0, along)
            )
            columns[own, TOOTH] = along[(opening.vertices[own] - start) // n]
            crown = (0.5 - np.array(GUM_OF_SECTION)) / 1.2
            crown[3:] = 2.0, 3.0  # the inner edge, and the gum behind
            columns[own, CROWN] = crown[(opening.vertices[own] - start) % n]
    return columns


def _fine(photo: NDArray[np.uint8], scale: float) -> NDArray[np.float32]:
    """Return pores and grain of a cut-out of the photo, without its lines and edges: (h, w, 3) about 0."""
    values = photo.astype(np.float32)
    sigma = max(1.0, 0.6 * scale)
    fine = values - wide_blur(values, sigma)
    limit = 3.0 * np.median(np.abs(fine))
    return np.asarray(np.clip(fine, -limit, limit), np.float32)
