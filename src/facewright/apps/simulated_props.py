"""What people carry into a picture besides their face: hair, glasses, a torso; made up, as meshes."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import PchipInterpolator

from facewright.faces.face import Face
from facewright.faces.paint_map import build_paint_map
from facewright.mesh.normals import vertex_normals
from facewright.mesh.random_field import smooth_random_field
from facewright.mesh.subdivide import subdivide_catmull_clark

_HAIR_STARTS, _HAIR_FULL = 0.35, 2.0  # of `PaintMap.scalp`, whose hairline is at 0.5 and which grows by 1/12 per mm
_CLOTHES = np.array(
    [
        [0.16, 0.18, 0.23],
        [0.55, 0.56, 0.58],
        [0.45, 0.16, 0.17],
        [0.18, 0.28, 0.42],
        [0.72, 0.68, 0.60],
        [0.2, 0.3, 0.2],
    ]
)
_FRAME_TONES = np.array([[0.05, 0.05, 0.06], [0.25, 0.13, 0.08], [0.45, 0.45, 0.47], [0.35, 0.08, 0.10]])


@dataclass(frozen=True, eq=False)
class Prop:
    """A coloured mesh.

    Parameters
    ----------
    vertices : ndarray of shape (V, 3), float64, millimetres
        In model space.
    faces : ndarray of shape (F, 3), int32
        Triangles, counter-clockwise seen from outside.
    colours : ndarray of shape (V, 3), float32
        sRGB in [0, 1].
    """

    vertices: NDArray[np.float64]
    faces: NDArray[np.int32]
    colours: NDArray[np.float32]


@dataclass(frozen=True, eq=False)
class Hair:
    """A cap of hair over the scalp, which follows the skin below.

    Parameters
    ----------
    weights : sparse matrix of shape (H, n_skin)
        Where the cap's vertices stand on the skin.
    faces : ndarray of shape (F, 3), int32
        Its triangles.
    thickness : ndarray of shape (H,), float64, millimetres
        How far the cap stands off the skin.
    colours : ndarray of shape (H, 3), float32
        sRGB in [0, 1].
    """

    weights: Any
    faces: NDArray[np.int32]
    thickness: NDArray[np.float64]
    colours: NDArray[np.float32]

    def over(self, skin: NDArray[np.floating], normals: NDArray[np.floating]) -> Prop:
        """Return the cap over a posed skin (n_skin, 3) with its vertex normals."""
        outward = self.weights @ normals
        outward /= np.maximum(np.linalg.norm(outward, axis=1, keepdims=True), 1e-9)
        return Prop(self.weights @ skin + self.thickness[:, None] * outward, self.faces, self.colours)


def make_hair(
    face: Face, colour: NDArray[np.floating], skin_colour: NDArray[np.floating], rng: np.random.Generator
) -> Hair:
    """Make up a cap of hair, 5 to 25 mm thick and bumpy, in shades of `colour` (3,); it thins out at the hairline."""
    skin = face.mean_shape[: face.n_skin].astype(np.float64)
    paint = build_paint_map(face)
    scalp = paint.columns(paint.attributes[: face.n_skin])["scalp"].astype(np.float64)
    faces = face.topology.faces[(face.topology.faces < face.n_skin).all(axis=1)]
    faces = faces[(scalp[faces] > 0.0).any(axis=1)]
    polygons = np.concatenate([faces, np.full((len(faces), 1), -1, faces.dtype)], axis=1)
    ids = np.unique(faces)
    number = np.full(face.n_skin, -1)
    number[ids] = np.arange(len(ids))
    polygons[:, :3] = number[faces]
    fine = subdivide_catmull_clark(polygons, len(ids))
    quads = fine.faces
    triangles = np.concatenate([quads[:, [0, 1, 2]], quads[:, [0, 2, 3]]]).astype(np.int32)
    weights = fine.matrix @ _choose_rows(ids, face.n_skin)
    places = weights @ skin
    ramp = np.clip((weights @ scalp - _HAIR_STARTS) / (_HAIR_FULL - _HAIR_STARTS), 0.0, 1.0)
    body = rng.uniform(5.0, 25.0) * (0.6 + 0.4 * np.clip((places[:, 1] - 20.0) / 90.0, 0.0, 1.0))
    bumps = 1.0 + 0.25 * _scalar_field(places, 18.0, rng) + 0.12 * _scalar_field(places, 6.0, rng)
    thickness = body * np.clip(bumps, 0.4, 1.8) * np.sqrt(ramp) - 1.5 * (ramp <= 0)
    shades = 1.0 + 0.22 * _scalar_field(places * [1.0, 0.35, 0.35], 4.0, rng) + 0.10 * rng.normal(size=len(places))
    colours = np.clip(np.asarray(colour) * np.clip(shades, 0.5, 1.7)[:, None], 0.01, 0.95)
    line = ramp + 0.06 * _scalar_field(places, 5.0, rng)
    thin = np.clip((line - 0.01) / 0.12, 0.0, 1.0)[:, None]
    colours = np.asarray(skin_colour) + thin * (colours - skin_colour)
    return Hair(weights, triangles, thickness, colours.astype(np.float32))


def make_glasses(face: Face, neutral: NDArray[np.floating], rng: np.random.Generator) -> tuple[Prop, Prop]:
    """Make up glasses that fit a head at rest: frame (rims, bridge, temples) and lenses."""
    points = neutral[face.topology.landmarks["fw74"].clip(0)].astype(np.float64)
    eyes = points[27:35].mean(axis=0), points[35:43].mean(axis=0)  # right and left
    half_width = rng.uniform(0.66, 0.76) * 0.5 * float(np.linalg.norm(eyes[1] - eyes[0]))
    shape = half_width, half_width * rng.uniform(0.72, 0.95), rng.uniform(2.0, 4.5)
    radius = rng.uniform(0.9, 2.2)
    tone = _FRAME_TONES[rng.integers(len(_FRAME_TONES))]
    front = max(points[44, 2] - 4.0, eyes[0][2] + 13.0, eyes[1][2] + 13.0)
    rims = [_rim(centre, side, shape, front) for centre, side in zip(eyes, (-1.0, 1.0))]
    tubes = [_tube(rim, radius, closed=True) for rim in rims]
    span = np.linspace(-1.0, 1.0, 9)
    gap = max(rims[1][:, 0].min(), -rims[0][:, 0].max()) + 1.0
    height = 0.5 * (eyes[0][1] + eyes[1][1]) - 1.0
    depth = max(front, points[43, 2] + 1.5)
    tubes.append(_tube(np.stack([gap * span, height + 3.0 * (1 - span**2), np.full(9, depth)], axis=1), radius))
    skin = neutral[: face.n_skin].astype(np.float64)
    ears = neutral[face.topology.landmarks["ibug68"][[0, 16]], 2].astype(np.float64) - 14.0
    for rim, side, ear in zip(rims, (-1.0, 1.0), ears):
        corner = rim[np.argmax(side * rim[:, 0] + 0.3 * rim[:, 1])]
        tubes.append(_tube(_temple(skin, corner, side, ear, radius), radius))
    return _join(tubes, tone), _join([_fan(rim - [0.0, 0.0, 0.5]) for rim in rims], np.full(3, 0.85))


def _rim(eye: NDArray[np.float64], side: float, shape: tuple[float, float, float], front: float) -> NDArray[np.float64]:
    """Return the outline of a lens (48, 3): a superellipse (half width, half height, power), bent round the face."""
    half_width, half_height, power = shape
    angle = np.linspace(0.0, 2.0 * np.pi, 49)[:-1]
    c, s = np.cos(angle), np.sin(angle)
    x = eye[0] + 2.0 * side + np.sign(c) * np.abs(c) ** (2.0 / power) * half_width
    y = np.sign(s) * np.abs(s) ** (2.0 / power) * half_height
    return np.stack([x, eye[1] - 4.0 + y, front - 0.0022 * x**2 + 0.05 * y], axis=1)


def _temple(
    skin: NDArray[np.float64], corner: NDArray[np.float64], side: float, ear: float, radius: float
) -> NDArray[np.float64]:
    """Return the line (12, 3) from the corner of a rim beside the head back to the ear."""
    back = np.linspace(corner[2], ear, 12)
    beside = skin[(np.abs(skin[:, 1] - corner[1]) < 8.0) & (side * skin[:, 0] > 0)]
    reach = np.array([np.abs(beside[np.abs(beside[:, 2] - z) < 6.0, 0]).max(initial=0.0) for z in back])
    across = np.maximum.accumulate(np.maximum(reach + radius, abs(corner[0])))
    return np.stack([side * across, np.full(12, corner[1]), back], axis=1)


def make_torso(face: Face, neutral: NDArray[np.floating], rng: np.random.Generator) -> Prop:
    """Make up a clothed torso below the neck of a head at rest."""
    skin = neutral[: face.n_skin].astype(np.float64)
    bottom, chin = skin[:, 1].min(), neutral[face.topology.landmarks["ibug68"][8], 1]
    collar = bottom + 0.45 * (chin - bottom)
    middle = _section(skin, collar)[1]
    depth = np.concatenate([np.linspace(2.0, -90.0, 36), np.linspace(-100.0, -420.0, 20)])
    curve = _torso_profile(skin, collar, rng.uniform(0.88, 1.12))(-depth)
    angle = np.linspace(0.0, 2.0 * np.pi, 73)[:-1]
    power = np.linspace(2.0, 2.6, len(depth))[:, None]
    x = np.sign(np.cos(angle)) * np.abs(np.cos(angle)) ** (2.0 / power) * curve[:, :1]
    z = np.sign(np.sin(angle)) * np.abs(np.sin(angle)) ** (2.0 / power) * curve[:, 1:2]
    rings = np.stack(
        [middle[0] + x, np.broadcast_to(collar + depth[:, None], x.shape), middle[2] + curve[:, 2:] + z], axis=2
    )
    vertices = rings.reshape(-1, 3)
    folds = smooth_random_field(vertices, 45.0, 4.0, rng) * np.clip(-depth / 60.0, 0.0, 1.0).repeat(len(angle))[:, None]
    colour = _CLOTHES[rng.integers(len(_CLOTHES))] * rng.uniform(0.8, 1.2)
    stripes = 1.0 + rng.choice([0.0, 0.25]) * np.sign(np.sin(vertices[:, 1] / rng.uniform(4.0, 9.0)))
    colours = np.clip(colour * (stripes * (1.0 + 0.03 * rng.normal(size=len(vertices))))[:, None], 0.02, 0.95)
    return Prop(vertices + folds, _grid(len(depth), len(angle)), colours.astype(np.float32))


def _torso_profile(skin: NDArray[np.float64], collar: float, wide: float) -> PchipInterpolator:
    """Return a function of the way down from the collar: half width, half depth, backwards shift of the middle."""
    half, middle = _section(skin, collar)
    table = np.array(
        [
            [2.0, half[0] + 2.0, half[2] + 2.0, 0.0],
            [-6.0, half[0] + 6.0, half[2] + 6.0, 0.0],
            [-25.0, half[0] + 32.0 * wide, half[2] + 12.0, -3.0],
            [-48.0, 135.0 * wide, half[2] + 20.0, -8.0],
            [-80.0, 190.0 * wide, 95.0 * wide, -10.0],
            [-140.0, 215.0 * wide, 112.0 * wide, -6.0],
            [-420.0, 210.0 * wide, 125.0 * wide, 0.0],
        ]
    )
    for row in table:  # wide enough for shoulders that the head's mesh brings along
        below, centre = _section(skin, collar + row[0])
        row[1] = max(row[1], below[0] + 12.0)
        row[2] = max(row[2], below[2] + 8.0 + abs(centre[2] - middle[2] - row[3]))
    table[:, 1:3] = np.maximum.accumulate(table[:, 1:3], axis=0)
    return PchipInterpolator(-table[:, 0], table[:, 1:])


def _section(skin: NDArray[np.float64], height: float) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return half the extent and the middle of the neck at a height, both (3,); zeros below it."""
    ring = skin[np.abs(skin[:, 1] - height) < 10.0]
    if not len(ring):
        return np.zeros(3), np.zeros(3)
    low, high = ring.min(axis=0), ring.max(axis=0)
    return 0.5 * (high - low), 0.5 * (high + low)


def _choose_rows(ids: NDArray[np.integer], n: int) -> Any:
    from scipy import sparse

    return sparse.csr_matrix((np.ones(len(ids)), (np.arange(len(ids)), ids)), (len(ids), n))


def _scalar_field(points: NDArray[np.floating], correlation_mm: float, rng: np.random.Generator) -> NDArray[np.float64]:
    """Return a smooth random number of unit variance for each point."""
    return smooth_random_field(points, correlation_mm, float(np.sqrt(3.0)), rng)[:, 0]


def _grid(rows: int, columns: int) -> NDArray[np.int32]:
    """Return triangles between rings that are closed; rings go down and counter-clockwise seen from below."""
    i, j = np.meshgrid(np.arange(rows - 1), np.arange(columns), indexing="ij")
    a, b = i * columns + j, i * columns + (j + 1) % columns
    c, d = a + columns, b + columns
    return np.concatenate([np.stack([a, b, d], -1), np.stack([a, d, c], -1)]).reshape(-1, 3).astype(np.int32)


def _tube(line: NDArray[np.float64], radius: float, closed: bool = False) -> tuple[NDArray, NDArray]:
    """Return vertices and triangles of a round tube along a polyline (N, 3)."""
    along = np.roll(line, -1, axis=0) - np.roll(line, 1, axis=0) if closed else np.gradient(line, axis=0)
    along /= np.linalg.norm(along, axis=1, keepdims=True)
    helper = np.where(np.abs(along[:, 2:]) < 0.8, [[0.0, 0.0, 1.0]], [[0.0, 1.0, 0.0]])
    u = np.cross(along, helper)
    u /= np.linalg.norm(u, axis=1, keepdims=True)
    v = np.cross(along, u)
    angle = np.linspace(0.0, 2.0 * np.pi, 9)[:-1]
    ring = np.cos(angle)[None, :, None] * u[:, None] + np.sin(angle)[None, :, None] * v[:, None]
    vertices = (line[:, None] + radius * ring).reshape(-1, 3)
    faces = _grid(len(line), 8)
    if closed:
        last = (len(line) - 1) * 8 + np.arange(8)
        after = np.roll(last, -1)
        first, second = np.arange(8), np.roll(np.arange(8), -1)
        faces = np.concatenate([faces, np.stack([last, after, second], 1), np.stack([last, second, first], 1)])
    return vertices, faces.astype(np.int32)


def _fan(rim: NDArray[np.float64]) -> tuple[NDArray, NDArray]:
    """Return a plate with this rim (N, 3), counter-clockwise seen from the front."""
    n = len(rim)
    faces = np.stack([np.full(n, n), np.arange(n), (np.arange(n) + 1) % n], axis=1)
    return np.concatenate([rim, rim.mean(axis=0, keepdims=True)]), faces.astype(np.int32)


def _join(meshes: list[tuple[NDArray, NDArray]], colour: NDArray[np.floating]) -> Prop:
    starts = np.cumsum([0] + [len(vertices) for vertices, _ in meshes])
    vertices = np.concatenate([vertices for vertices, _ in meshes])
    faces = np.concatenate([faces + start for (_, faces), start in zip(meshes, starts)]).astype(np.int32)
    return Prop(vertices, faces, np.broadcast_to(colour, vertices.shape).astype(np.float32))


def outward_normals(vertices: NDArray[np.floating], faces: NDArray[np.integer]) -> NDArray[np.float64]:
    """Return unit vertex normals in float64."""
    return vertex_normals(np.asarray(vertices, dtype=np.float64), faces).astype(np.float64)
