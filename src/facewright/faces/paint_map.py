"""Where on a face each colour goes: vertex attributes that stick to the surface, from masks and landmarks."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from facewright.faces.builtin_parts import GUM_OF_SECTION
from facewright.faces.face import Face
from facewright.mesh.connectivity import vertex_adjacency
from facewright.mesh.normals import vertex_normals

_CHANNELS = (
    "lips",
    "lash",
    "lid_margin",
    "flush",
    "eye_shade",
    "scalp",
    "front",
    "teeth",
    "flesh",
    "cavity",
    "depth_in_mouth",
    "eye",
    "groove",
)


@dataclass(frozen=True, eq=False)
class PaintMap:
    """Attributes for painting a face.

    Parameters
    ----------
    attributes : ndarray of shape (V, 3 + 13), float32
        Position on the generic neutral in mm, then one weight in [0, 1] per channel (``lash`` is a distance in mm).
    brow : ndarray of shape (3, K), float64
        Middle curve of the left brow: x, y and half width, by growing x, mm.
    iris_centre : ndarray of shape (3,), float64
        Foremost point of the left eyeball, mm.
    iris_radius_mm : float
        Radius of the iris.
    landmarks : ndarray of shape (74, 3), float64
        Landmarks of the generic neutral, mm.
    """

    attributes: NDArray[np.float32]
    brow: NDArray[np.float64]
    iris_centre: NDArray[np.float64]
    iris_radius_mm: float
    landmarks: NDArray[np.float64]

    @property
    def brow_width_mm(self) -> float:
        """Mean half width of the brow."""
        return float(self.brow[2].mean())

    def columns(self, values: NDArray[np.floating]) -> dict[str, NDArray]:
        """Split samples (N, C) of the attributes into ``position`` (N, 3) and channels (N,)."""
        values = np.ascontiguousarray(np.asarray(values, dtype=np.float32).T)
        return {"position": values[:3].T} | {name: values[3 + i] for i, name in enumerate(_CHANNELS)}

    def scalp(self, position: NDArray[np.floating]) -> NDArray[np.float64]:
        """Return for places (N, 3) on the generic neutral: 0.5 on the hairline, 1/12 more or less per millimetre."""
        return _scalp(position, self.landmarks)

    def brow_coordinates(
        self, x: NDArray, y: NDArray, arch_mm: float, thickness: float
    ) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Return how far along (0 inner to 1 outer end) and across (-1 to 1) the brow points at |x|, y lie."""
        curve_x, curve_y, half = self.brow
        along = (x - curve_x[0]) / (curve_x[-1] - curve_x[0])
        arch = arch_mm * np.sin(np.pi * np.clip(along, 0.0, 1.0))
        width = np.interp(x, curve_x, half) * thickness
        return along, (y - np.interp(x, curve_x, curve_y) - arch) / width


def build_paint_map(face: Face) -> PaintMap:
    """Derive the paint map of a face from its parts, masks and 74 landmarks."""
    topology, mean = face.topology, face.mean_shape.astype(np.float64)
    V = topology.n_vertices
    points = mean[topology.landmarks["fw74"]]
    channels = {name: np.zeros(V) for name in _CHANNELS}
    channels["lash"][:] = 99.0
    n = face.n_skin
    skin = mean[:n]
    channels["lips"][topology.masks["lips"]] = 1.0
    _parts(channels, face)
    _lashes(channels, mean, points, n)
    channels["flush"][:n] = _bumps(skin, [_cheek(points, 1), _cheek(points, -1), points[45]], [22.0, 22.0, 12.0])
    eyes = [points[[27, 31]].mean(axis=0), points[[35, 39]].mean(axis=0)]
    channels["eye_shade"][:n] = _bumps(skin, eyes, [16.0, 16.0])
    channels["scalp"][:n] = _scalp(skin, points)
    channels["front"][:n] = np.clip((skin[:, 2] - (points[45, 2] - 75.0)) / 10.0, 0.0, 1.0)
    iris = topology.masks.get("iris_left", np.empty(0, dtype=np.int32))
    centre = eyes[1] if not len(iris) else mean[iris][mean[iris, 2].argmax()]
    if len(topology.masks.get("pupil_left", ())):
        centre = mean[topology.masks["pupil_left"]].mean(axis=0)
    radius = float(np.hypot(*(mean[iris] - centre)[:, :2].T).max()) if len(iris) else 6.0
    return PaintMap(
        attributes=np.concatenate([mean, np.stack([channels[name] for name in _CHANNELS], axis=1)], axis=1).astype(
            np.float32
        ),
        brow=_brow_curve(points),
        iris_centre=centre,
        iris_radius_mm=radius,
        landmarks=points,
    )


def _parts(channels: dict[str, NDArray], face: Face) -> None:
    """Mark teeth, flesh, cavity and eyeballs by the names of the parts."""
    mean = face.mean_shape
    channels["depth_in_mouth"][face.topology.masks.get("nostril_insides", np.empty(0, dtype=np.int32))] = 0.9
    lips_z = float(mean[face.topology.masks["lips"], 2].max())
    for name, (start, stop) in face.topology.parts.items():
        part = slice(start, stop)
        if name.startswith("eyeball"):
            channels["eye"][part] = 1.0
        elif "teeth" in name:
            channels["teeth"][part] = 1.0
            channels["groove"][part] = _grooves(face, start, stop)
            if face.topology.name == "builtin":  # its gums are the roots of the rows; 0.5 is the gum line
                gum = np.tile(GUM_OF_SECTION, ((stop - start) // len(GUM_OF_SECTION), 1))
                gum[[0, -1]] = np.maximum(gum[[0, -1]], 1.0)  # where the row sinks into it
                channels["flesh"][part] = gum.ravel()
        elif "tongue" in name or "gum" in name:
            channels["flesh"][part] = 1.0
        elif name.startswith("mouth"):
            channels["cavity"][part] = 1.0
        elif name.startswith("eye"):
            channels["lid_margin"][part] = 1.0
        if "teeth" in name or "tongue" in name or "gum" in name or name.startswith("mouth"):
            depth = lips_z - mean[part, 2]
            darkness = 1.2 if "teeth" in name else 0.7  # rows of teeth fade away backwards, the cavity stays dark red
            channels["depth_in_mouth"][part] = darkness * np.clip((depth - 8.0) / 44.0, 0.0, 1.0)


def _grooves(face: Face, start: int, stop: int) -> NDArray[np.float64]:
    """Tell where a row of teeth is hollow against its surroundings, between teeth: (stop - start,) in [0, 1]."""
    faces = face.topology.faces
    faces = faces[((faces >= start) & (faces < stop)).all(axis=1)] - start
    vertices = face.mean_shape[start:stop].astype(np.float64)
    adjacency = vertex_adjacency(faces, stop - start)
    around = adjacency @ vertices / np.maximum(np.asarray(adjacency.sum(axis=1)), 1.0)
    hollow = ((around - vertices) * vertex_normals(vertices, faces)).sum(axis=1)
    return np.clip((hollow - np.median(hollow)) / (2.0 * hollow.std()) - 0.1, 0.0, 1.0)


def _lashes(channels: dict[str, NDArray], mean: NDArray, points: NDArray, n_skin: int) -> None:
    """Distance to the upper lash lines (the lower ones count as 1.5 mm further), and the wet margin behind them."""
    for upper, lower in (([27, 28, 29, 30, 31], [27, 34, 33, 32, 31]), ([35, 36, 37, 38, 39], [35, 42, 41, 40, 39])):
        near = np.flatnonzero(np.linalg.norm(mean - points[upper].mean(axis=0), axis=1) < 40.0)
        near = near[near < n_skin]
        to_upper = cKDTree(_dense(points[upper])).query(mean[near])[0]
        to_lower = cKDTree(_dense(points[lower])).query(mean[near])[0] + 1.2
        channels["lash"][near] = np.minimum(channels["lash"][near], np.minimum(to_upper, to_lower))


def _dense(line: NDArray) -> NDArray[np.float64]:
    """Return a polyline of few points as a smooth curve of many."""
    from scipy.interpolate import CubicSpline

    steps = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(line, axis=0), axis=1))])
    return CubicSpline(steps, line)(np.linspace(0.0, steps[-1], 160))


def _bumps(skin: NDArray, centres: list[NDArray], widths: list[float]) -> NDArray[np.float64]:
    result = np.zeros(len(skin))
    for centre, width in zip(centres, widths):
        result = np.maximum(result, np.exp(-0.5 * ((skin - centre) ** 2).sum(axis=1) / width**2))
    return result


def _cheek(points: NDArray, side: int) -> NDArray[np.float64]:
    eye, mouth = points[41 if side > 0 else 33], points[60 if side > 0 else 54]
    return 0.5 * (eye + mouth) + [8.0 * side, 0.0, -4.0]


def _scalp(skin: NDArray, points: NDArray) -> NDArray[np.float64]:
    """Return 1 above and behind a hairline that runs from the forehead's top down behind the ears."""
    brow, chin = points[[16, 22]].mean(axis=0), points[7]
    length = brow[1] - chin[1]
    top = brow + [0.0, 0.36 * length, -0.10 * length]
    nape = np.array([0.0, chin[1] + 0.30 * length, top[2] - 1.35 * length])
    along = nape - top
    normal = np.array([0.0, -along[2], along[1]]) / np.hypot(along[1], along[2])
    height = (skin - top) @ normal
    # Temples recede: the line climbs towards the sides of the forehead.
    receding = 0.06 * length * np.exp(-0.5 * ((np.abs(skin[:, 0]) - 0.38 * length) / (0.12 * length)) ** 2)
    height = height - receding * np.clip(0.5 + (skin[:, 2] - top[2] + 0.35 * length) / 20.0, 0.0, 1.0)
    # No hair on the ears: beside the face's outline it stays above the brows.
    inside = 1.03 * np.abs(points[[1, 13], 0]).mean() - np.abs(skin[:, 0])
    above = skin[:, 1] - (brow[1] + 0.10 * length)
    soft = 5.0  # mm: corners of the line are round
    beside = soft * np.logaddexp(inside / soft, above / soft)
    height = -soft * np.logaddexp(-height / soft, -beside / soft)
    # past 0 and 1, so that the line stays straight across coarse triangles
    return np.clip(0.5 + height / 12.0, -1.5, 2.5)


def _brow_curve(points: NDArray) -> NDArray[np.float64]:
    """Return x, y and half width along the left brow, inner end first, from its six landmarks."""
    upper, lower = points[[23, 22, 21]], points[[24, 25, 26]]
    x = np.linspace(min(upper[0, 0], lower[0, 0]) - 1.0, max(upper[2, 0], lower[2, 0]) + 1.0, 24)
    top, bottom = (np.polynomial.Polynomial.fit(row[:, 0], row[:, 1], 2)(x) for row in (upper, lower))
    return np.stack([x, 0.5 * (top + bottom), np.maximum(0.5 * (top - bottom), 1.4)])
