"""How made-up people look: skin, lips, brows, eyes and light, evaluated per vertex or per pixel."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import lru_cache
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from facewright.faces.face import Face
from facewright.faces.paint_map import PaintMap, build_paint_map

#: sRGB albedo of skin from light to dark.
SKIN_TONES = np.array(
    [
        [0.95, 0.82, 0.75],
        [0.90, 0.73, 0.63],
        [0.82, 0.63, 0.51],
        [0.70, 0.50, 0.38],
        [0.54, 0.37, 0.28],
        [0.38, 0.26, 0.20],
    ]
)
_HAIR_TONES = np.array(
    [
        [0.10, 0.08, 0.07],
        [0.20, 0.13, 0.10],
        [0.32, 0.22, 0.15],
        [0.50, 0.37, 0.23],
        [0.45, 0.26, 0.16],
        [0.5, 0.49, 0.48],
    ]
)
_IRIS_TONES = np.array(
    [
        [0.20, 0.11, 0.06],
        [0.33, 0.20, 0.10],
        [0.40, 0.33, 0.18],
        [0.33, 0.42, 0.30],
        [0.36, 0.50, 0.60],
        [0.45, 0.52, 0.56],
    ]
)
_TEETH = np.array([0.90, 0.87, 0.79])
_FLESH = np.array([0.66, 0.33, 0.32])
_CAVITY = np.array([0.52, 0.19, 0.18])


@dataclass(frozen=True, eq=False)
class Appearance:
    """Colours (sRGB in [0, 1]), brow shape and light of one made-up person.

    Parameters
    ----------
    skin, lips, brows, iris, sclera, hair : ndarray of shape (3,), float64
        sRGB colours.
    brow_density, brow_thickness, brow_arch_mm : float
        Opacity of the brows, their width relative to the face's own, and how far their middle is lifted.
    flush : float
        Strength of the redness of cheeks and nose.
    hair_density : float
        Opacity of a closely cut scalp; 0 is bald.
    light_directions : ndarray of shape (N, 3), float64
        Towards each light, camera frame (x right, y down, z away from the viewer).
    light_colours : ndarray of shape (N, 3), float64
        Linear RGB intensities.
    sky, ground : tuple of 3 floats
        Ambient linear RGB from above and from below.
    background : tuple of 3 ints
        sRGB colour behind the person.
    grain : ndarray of shape (7, 12), float64
        Waves of the skin's mottling: wave vector, phase (rows 0-3) and colour (rows 4-6, whose mean is used).
    """

    skin: NDArray[np.float64]
    lips: NDArray[np.float64]
    brows: NDArray[np.float64]
    iris: NDArray[np.float64]
    sclera: NDArray[np.float64]
    hair: NDArray[np.float64]
    brow_density: float
    brow_thickness: float
    brow_arch_mm: float
    flush: float
    hair_density: float
    light_directions: NDArray[np.float64]
    light_colours: NDArray[np.float64]
    sky: tuple[float, float, float]
    ground: tuple[float, float, float]
    background: tuple[int, int, int]
    grain: NDArray[np.float64]


class PixelSamples(Protocol):
    """What pixels see of a mesh; `facewright.imaging.rasterise.Fragments` is one."""

    @property
    def covered(self) -> NDArray[np.bool_]:
        """Pixels that see the mesh, shape (H, W)."""

    def interpolate(self, faces: NDArray[np.integer], attributes: NDArray[np.floating]) -> NDArray[np.float32]:
        """Interpolate vertex attributes (V, C) to (H, W, C)."""


def sample_appearance(rng: np.random.Generator) -> Appearance:
    """Draw an appearance: skin from light to dark, with lips, brows, eyes and light that go with it."""
    tone = rng.uniform(0.0, len(SKIN_TONES) - 1.0)
    skin = _between(SKIN_TONES, tone) * rng.uniform(0.95, 1.03) * (1.0 + rng.normal(0, 0.015, 3))
    lips = skin * np.array([0.90, 0.68, 0.67]) + rng.uniform(-0.03, 0.07) * np.array([1.0, 0.1, 0.25])
    darkest = 1.2 if tone > 2.5 else len(_HAIR_TONES) - 1.0
    hair = _between(_HAIR_TONES, rng.uniform(0.0, darkest))
    iris = _between(_IRIS_TONES, rng.uniform(0.0, 1.2 if tone > 2.5 else len(_IRIS_TONES) - 1.0))
    key_side, key_height = np.deg2rad(rng.uniform(-55, 55)), np.deg2rad(rng.uniform(5, 50))
    key = [np.sin(key_side) * np.cos(key_height), -np.sin(key_height), -np.cos(key_side) * np.cos(key_height)]
    warmth = rng.uniform(-0.06, 0.06) * np.array([1.0, 0.0, -1.0])
    gain = 1.0 + 0.25 * tone / len(SKIN_TONES)  # dark skin is photographed with more light
    return Appearance(
        skin=np.clip(skin, 0.02, 0.98),
        lips=np.clip(lips, 0.02, 0.95),
        brows=np.minimum(hair * rng.uniform(0.7, 1.0), 0.62 * skin),
        iris=iris,
        sclera=np.array([0.90, 0.88, 0.86]) * rng.uniform(0.92, 1.02),
        hair=np.minimum(hair, 0.85 * skin),
        brow_density=rng.uniform(0.55, 0.95),
        brow_thickness=rng.uniform(0.75, 1.25),
        brow_arch_mm=rng.uniform(-0.8, 0.8),
        flush=rng.uniform(0.0, 1.0),
        hair_density=rng.uniform(0.5, 0.95) if rng.random() < 0.7 else 0.0,
        light_directions=np.array([key, [-np.sign(key_side) * 0.8, -0.2, -0.55], [0.1, -0.75, 0.55]]),
        light_colours=gain
        * np.stack(
            [
                rng.uniform(0.55, 0.85) * (1.0 + warmth),
                rng.uniform(0.15, 0.35) * (1.0 - warmth),
                np.full(3, rng.uniform(0.1, 0.3)),
            ]
        ),
        sky=_triple(gain * rng.uniform(0.26, 0.38) * (1.0 - 0.5 * warmth)),
        ground=_triple(gain * rng.uniform(0.13, 0.20) * (1.0 + 0.5 * warmth)),
        background=_background(rng),
        grain=np.concatenate(
            [rng.normal(0, 0.18, (3, 12)), rng.uniform(0, 2 * np.pi, (1, 12)), rng.normal(0, 0.005, (3, 12))]
        ),
    )


def vertex_colors(face: Face, appearance: Appearance) -> NDArray[np.float32]:
    """Return one sRGB colour for each vertex, shape (V, 3) in [0, 1]: `albedo_function` sampled at the vertices."""
    paint = _paint_map(face)
    return _paint(paint, paint.attributes, appearance).astype(np.float32)


def vertex_gloss(face: Face) -> NDArray[np.float32]:
    """Return the strength of each vertex's highlight, shape (V,): wet eyes shine, the depth of the mouth does not."""
    paint = _paint_map(face)
    a = paint.columns(paint.attributes)
    gloss = 0.10 + 0.08 * a["lips"] + 0.10 * a["teeth"] + 0.12 * a["eye"]
    gloss = (
        gloss
        * (1.0 - 0.7 * np.clip(a["scalp"], 0.0, 1.0))
        * (1.0 - np.maximum(a["cavity"], np.clip(3.0 * a["depth_in_mouth"], 0.0, 1.0)))
    )
    return gloss.astype(np.float32)


def albedo_function(face: Face, appearance: Appearance, faces: NDArray[np.integer]) -> Callable[[Any], NDArray]:
    """Return a function from pixel samples to sRGB surface colour, for ``render_mesh(albedo=...)``.

    Brows, lip border, lash lines and irises are drawn per pixel, in coordinates that stick to the surface (those of the
    generic neutral), so that they stay sharp on any mesh and move with any expression.

    Parameters
    ----------
    face : Face
        Whose topology is rendered.
    appearance : Appearance
        Colours.
    faces : ndarray of shape (F, 3)
        The triangles handed to the renderer (see `visible_faces`).
    """
    paint = _paint_map(face)

    def albedo(samples: PixelSamples) -> NDArray[np.float32]:
        values = samples.interpolate(faces, paint.attributes)
        colours = np.zeros((*values.shape[:-1], 3), dtype=np.float32)
        colours[samples.covered] = _paint(paint, values[samples.covered], appearance)
        return colours

    return albedo


def visible_faces(face: Face) -> NDArray[np.int32]:
    """Return the triangles to render: all but lashes, tear fluid and the other see-through shells round the eyes."""
    keep = np.ones(face.topology.n_vertices, dtype=bool)
    for name, (start, stop) in face.topology.parts.items():
        if name.startswith(("lacrimal", "eye_blend", "eye_occlusion", "eyelash")):
            keep[start:stop] = False
    return face.topology.faces[keep[face.topology.faces].all(axis=1)]


@lru_cache(maxsize=4)
def _paint_map(face: Face) -> PaintMap:
    return build_paint_map(face)


def _paint(paint: PaintMap, values: NDArray[np.floating], look: Appearance) -> NDArray[np.float32]:
    """Return the sRGB colour (N, 3) at samples of the attributes (N, C)."""
    a = paint.columns(values)
    grain = look.grain.astype(np.float32)
    # Skin: mottling, flush, shaded eye sockets.
    waves = np.sin(a["position"] @ grain[:3] + grain[3])
    mottling = 0.7 * (waves @ grain[4:].mean(axis=0))  # of lightness only
    colour = look.skin.astype(np.float32) * (1.0 + mottling)[:, None]
    colour[:, 1] *= 1.0 - 0.10 * look.flush * a["flush"]
    colour[:, 2] *= 1.0 - 0.09 * look.flush * a["flush"]
    colour *= (1.0 - 0.12 * a["eye_shade"])[:, None]
    # Layers over it, each only where it is seen.
    _lay(colour, look.hair, look.hair_density * _scalp_opacity(a, paint))
    _lay(colour, look.brows, _brow_opacity(a, paint, look))
    _lay(colour, look.lips, 0.9 * _smoothstep(a["lips"], 0.35, 0.65))
    _lay(colour, 0.25 * look.brows, 0.85 * np.exp(-((a["lash"] / 0.9) ** 2)))
    _lay(colour, look.skin * np.array([0.95, 0.72, 0.70]), 0.6 * a["lid_margin"])
    _lay(colour, _TEETH, a["teeth"])
    colour *= (1.0 - 0.55 * a["groove"] ** 1.5)[:, None]
    _lay(colour, _FLESH, _smoothstep(a["flesh"], 0.4, 0.6))
    _lay(colour, _CAVITY, a["cavity"])
    gums = np.clip(a["flesh"], 0.0, 1.0) * a["teeth"]
    colour *= (1.0 - 0.65 * a["depth_in_mouth"] * (1.0 - 0.45 * gums))[:, None]
    eye = np.flatnonzero(a["eye"] > 0.45)
    if len(eye):
        ball = _eyeball({name: column[eye] for name, column in a.items()}, paint, look)
        colour[eye] = _over(colour[eye], ball, _smoothstep(a["eye"][eye], 0.45, 0.55))
    return np.clip(colour, 0.0, 1.0).astype(np.float32)


def _scalp_opacity(a: dict[str, NDArray], paint: PaintMap) -> NDArray[np.float64]:
    """Return the opacity (N,) of closely cut hair; the hairline is evaluated where it is near, with stray hairs."""
    scalp = a["scalp"].astype(np.float64)
    near = np.flatnonzero((scalp > -1.5) & (scalp < 2.5) & (a["eye"] + a["teeth"] + a["cavity"] == 0.0))
    x, y, z = a["position"][near].T.astype(np.float64)
    line = paint.scalp(a["position"][near].astype(np.float64))
    scalp[near] = line + 0.10 * _noise(1.1 * (x + 0.6 * y), 0.35 * y - 1.1 * z)
    return _smoothstep(scalp, 0.25, 0.85)


def _brow_opacity(a: dict[str, NDArray], paint: PaintMap, look: Appearance) -> NDArray[np.float64]:
    """Return the opacity (N,) of the brows: a band along their middle curve, with hairs."""
    x, y = np.abs(a["position"][:, 0]), a["position"][:, 1]
    along, across = paint.brow_coordinates(x, y, look.brow_arch_mm, look.brow_thickness)
    near = np.flatnonzero((np.abs(across) < 1.25) & (along > 0.0) & (along < 1.0) & (a["front"] > 0.0))
    x, y, along, signed = x[near], y[near], along[near], across[near]
    # Hairs stand up at the inner end and lie down towards the outer one.
    lean = 0.35 + 0.9 * along
    over = signed * paint.brow_width_mm
    hairs = 0.75 + 0.25 * _noise(3.4 * (x - lean * over), 0.55 * over + 0.2 * y)
    across = np.abs(signed) + 0.18 * _noise(2.3 * (x - lean * over), 0.0 * over)  # a ragged outline
    ends = _smoothstep(along, 0.0, 0.06) * _smoothstep(1.0 - along, 0.0, 0.12)
    opacity = np.zeros(len(a["front"]))
    opacity[near] = look.brow_density * _smoothstep(1.25 - across, 0.0, 0.5) * ends * hairs * a["front"][near]
    return opacity


def _noise(u: NDArray, v: NDArray) -> NDArray[np.float64]:
    """Return smooth noise in [-1, 1] at points of a plane: values hashed on the unit grid, blended between."""
    i, j = np.floor(u), np.floor(v)
    s, t = _smoothstep(u - i, 0.0, 1.0), _smoothstep(v - j, 0.0, 1.0)

    def corner(a: NDArray, b: NDArray) -> NDArray[np.float64]:
        return 2.0 * np.modf(np.abs(43758.5453 * np.sin(12.9898 * a.astype(float) + 78.233 * b.astype(float))))[0] - 1.0

    low = corner(i, j) * (1.0 - s) + corner(i + 1, j) * s
    high = corner(i, j + 1) * (1.0 - s) + corner(i + 1, j + 1) * s
    return low * (1.0 - t) + high * t


def _eyeball(a: dict[str, NDArray], paint: PaintMap, look: Appearance) -> NDArray[np.float64]:
    """Return the eyeball's colour: sclera, limbus, iris with radial streaks, pupil."""
    dx, dy = np.abs(a["position"][:, 0]) - paint.iris_centre[0], a["position"][:, 1] - paint.iris_centre[1]
    r = np.hypot(dx, dy) / paint.iris_radius_mm
    facing = a["position"][:, 2] > paint.iris_centre[2] - paint.iris_radius_mm
    streaks = 1.0 + 0.18 * np.sin(23.0 * np.arctan2(dy, dx)) * np.clip(r, 0, 1)
    iris = look.iris * (streaks * (1.15 - 0.35 * r))[:, None]
    iris = _over(iris, np.full(3, 0.03), _smoothstep(0.42 - r, -0.04, 0.04))
    iris = _over(iris, 0.35 * look.iris, 0.8 * _smoothstep(r, 0.85, 0.98))
    veins = 1.0 - 0.10 * np.clip(r - 1.2, 0.0, 1.0)[:, None] * np.array([0.2, 1.0, 1.0])
    shade = 1.0 - 0.25 * _smoothstep(dy / paint.iris_radius_mm, 0.2, 1.2)  # the upper lid's shadow
    white = look.sclera * veins * shade[:, None]
    return _over(white, iris * shade[:, None], _smoothstep(1.0 - r, -0.04, 0.04) * facing)


def _background(rng: np.random.Generator) -> tuple[int, int, int]:
    red, green, blue = np.clip(rng.uniform(50, 235) + rng.normal(0, 18, 3), 0, 255)
    return int(red), int(green), int(blue)


def _lay(colour: NDArray[np.float32], tone: NDArray, opacity: NDArray) -> None:
    """Paint `tone` over the rows of `colour` (N, 3) where it is not quite transparent, in place."""
    rows = np.flatnonzero(opacity > 0.004)
    colour[rows] = _over(colour[rows], tone, opacity[rows])


def _over(base: NDArray, colour: NDArray, alpha: NDArray) -> NDArray[np.float64]:
    return base + (np.asarray(colour) - base) * np.asarray(alpha)[:, None]


def _smoothstep(value: NDArray, low: float, high: float) -> NDArray[np.float64]:
    t = np.clip((value - low) / (high - low), 0.0, 1.0)
    return t * t * (3.0 - 2.0 * t)


def _between(tones: NDArray[np.float64], position: float) -> NDArray[np.float64]:
    """Return the colour at a fractional row of `tones`."""
    return np.array([np.interp(position, np.arange(len(tones)), tones[:, c]) for c in range(3)])


def _triple(values: NDArray[np.floating]) -> tuple[float, float, float]:
    return float(values[0]), float(values[1]), float(values[2])
