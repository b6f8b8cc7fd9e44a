"""Which triangles of a face lie behind its lips and lids, and what they are made of."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from facewright.faces.face import Face
from facewright.faces.paint_map import PaintMap, build_paint_map
from facewright.faces.rigid_motion import rigid_vertices
from facewright.imaging.rasterise import rasterise
from facewright.mesh.connectivity import vertex_adjacency

#: What a triangle is: skin, the wet margin and socket behind the lids, an eyeball, a tooth of either row, anything
#: else in the mouth.
SKIN, SOCKET, EYE, UPPER_TOOTH, LOWER_TOOTH, MOUTH = range(6)
SIDES = ("right", "left")  # the order of `Performance.gaze`

_SHELLS = ("lacrimal", "eye_blend", "eye_occlusion", "eyelash")  # see-through: not drawn
_REACH_MM = {"mouth": 34.0, "eye": 26.0}  # skin up to here may hide an opening
_HIDDEN_MM = 0.6
_NEAR_MM = 4.0
_SEAM_MM = 0.5


@dataclass(frozen=True, eq=False)
class Opening:
    """The mouth or an eye: the triangles around and behind it, in a numbering of their own.

    Parameters
    ----------
    name : str
        ``"mouth"``, ``"right"`` or ``"left"``.
    vertices : ndarray of shape (M,), int
        Vertices of the face.
    faces : ndarray of shape (N, 3), int32
        Triangles, numbered within `vertices`.
    kinds : ndarray of shape (N,), uint8
        What each triangle is: `SKIN`, `SOCKET`, `EYE`, `UPPER_TOOTH`, `LOWER_TOOTH` or `MOUTH`.
    rim : ndarray of int
        Places within `vertices` of the lips or lids: what is drawn anew lies within their bounding box.
    upper, lower : ndarray of shape (K,), int
        Places within `vertices` of pairs that meet when the opening closes.
    probes : ndarray of int
        Places whose motion tells whether the opening only moves as a whole.
    hidden : ndarray of shape (M,), float64
        How far skin lies out of sight on the closed mouth and the open eye of the generic face, 0 to 1.
    near : ndarray of shape (M,), float64
        1 on lips or lids, falling to 0 around them.
    seam : ndarray of shape (M,), float64
        1 where lips or lids touch, falling to 0 within a millimetre.
    pair : ndarray of shape (M,), int
        The nearest of the pairs that touch.
    """

    name: str
    vertices: NDArray[np.intp]
    faces: NDArray[np.int32]
    kinds: NDArray[np.uint8]
    rim: NDArray[np.intp]
    upper: NDArray[np.intp]
    lower: NDArray[np.intp]
    probes: NDArray[np.intp]
    hidden: NDArray[np.float64]
    near: NDArray[np.float64]
    seam: NDArray[np.float64]
    pair: NDArray[np.intp]

    def places(self, ids: NDArray[np.integer]) -> NDArray[np.intp]:
        """Return where vertices of the face, all of them in `vertices`, are within it."""
        return np.searchsorted(self.vertices, ids)


@lru_cache(maxsize=4)
def openings(face: Face) -> tuple[Opening, Opening, Opening]:
    """Return the mouth, the right and the left eye of a face that has all its parts."""
    kinds = _vertex_kinds(face)
    hidden = _out_of_sight(face, kinds)
    return (
        _opening(face, "mouth", kinds, hidden),
        _opening(face, "right", kinds, hidden),
        _opening(face, "left", kinds, hidden),
    )


@lru_cache(maxsize=4)
def paint_map(face: Face) -> PaintMap:
    """Return `build_paint_map` of a face, kept."""
    return build_paint_map(face)


def eyeball(face: Face, side: str) -> NDArray[np.intp]:
    """Return the vertices of one eyeball."""
    return rigid_vertices(face, f"eyeball_{side}")


def rigid_motion(
    before: NDArray[np.floating], after: NDArray[np.floating]
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return rotation (3, 3) and shift (3,) that take points (N, 3) to others best: after = R before + t."""
    a, b = before.mean(axis=0), after.mean(axis=0)
    u, _, vt = np.linalg.svd((after - b).T.astype(np.float64) @ (before - a))
    flip = np.array([1.0, 1.0, np.sign(np.linalg.det(u @ vt))])
    rotation = (u * flip) @ vt
    return rotation, b - rotation @ a


def sphere_centre(points: NDArray[np.floating]) -> NDArray[np.float64]:
    """Return the centre (3,) of the sphere that an eyeball's vertices (N, 3) lie on, but for its cornea."""
    middle = points.mean(axis=0)
    p = np.asarray(points - middle, np.float64)
    keep = np.ones(len(p), bool)
    centre = np.zeros(3)
    for _ in range(4):
        design = np.column_stack([2.0 * p[keep], np.ones(int(keep.sum()))])
        centre = np.linalg.lstsq(design, (p[keep] ** 2).sum(axis=1), rcond=None)[0][:3]
        radius = np.linalg.norm(p - centre, axis=1)
        keep = np.abs(radius - np.median(radius)) <= np.percentile(np.abs(radius - np.median(radius)), 70)
    return np.asarray(centre + middle)


def turn_of_gaze(gaze: NDArray[np.floating]) -> NDArray[np.float64]:
    """Return the rotation (3, 3) of an eyeball in model space; yaw to the subject's left (+x), pitch upwards."""
    cy, cp = np.cos(gaze)
    sy, sp = np.sin(gaze)
    about_y = np.array([[cy, 0.0, sy], [0.0, 1.0, 0.0], [-sy, 0.0, cy]])
    return about_y @ np.array([[1.0, 0.0, 0.0], [0.0, cp, sp], [0.0, -sp, cp]])


def _vertex_kinds(face: Face) -> NDArray[np.int8]:
    """Return what each vertex is made of; -1 is not drawn."""
    topology = face.topology
    kinds = np.full(topology.n_vertices, MOUTH, np.int8)
    kinds[: face.n_skin] = SKIN
    for name, (start, stop) in topology.parts.items():
        if name.startswith(_SHELLS):
            kinds[start:stop] = -1
        elif name.startswith("eyeball"):
            kinds[start:stop] = EYE
        elif name.startswith("eye"):
            kinds[start:stop] = SOCKET
    kinds[rigid_vertices(face, "teeth_upper")] = UPPER_TOOTH
    kinds[rigid_vertices(face, "teeth_lower")] = LOWER_TOOTH
    return kinds


def _out_of_sight(face: Face, kinds: NDArray[np.int8]) -> NDArray[np.float64]:
    """Return how far each skin vertex is hidden from the front on the generic face, smoothed, (V,)."""
    n = face.n_skin
    mean = face.mean_shape[:n].astype(np.float64)
    faces = face.topology.faces[(face.topology.faces < n).all(axis=1)]
    step = 0.4
    lo = mean[:, :2].min(axis=0)
    width, height = (np.ceil((mean[:, :2].max(axis=0) - lo) / step) + 1).astype(int)
    size = (int(height), int(width))
    at = (mean[:, :2] - lo) / step
    at[:, 1] = size[0] - 1 - at[:, 1]
    buffer = rasterise(at, 1000.0 - mean[:, 2], faces, size, perspective=False).depth
    x, y = np.round(at).astype(int).T
    hidden = (1000.0 - mean[:, 2] > buffer[y, x] + _HIDDEN_MM).astype(np.float64)
    adjacency = vertex_adjacency(faces, n)
    degree = np.maximum(np.asarray(adjacency.sum(axis=1)).ravel(), 1.0)
    for _ in range(2):
        hidden = 0.5 * hidden + 0.5 * (adjacency @ hidden) / degree
    result = np.ones(len(kinds))
    result[:n] = np.clip(1.6 * hidden - 0.3, 0, 1)
    return result


def _opening(face: Face, name: str, kinds: NDArray[np.int8], hidden: NDArray[np.float64]) -> Opening:
    topology, mean = face.topology, face.mean_shape.astype(np.float64)
    if name == "mouth":
        rim = topology.masks["lips"]
        upper, lower = topology.masks["lip_contact_upper"], topology.masks["lip_contact_lower"]
        wanted, reach = {UPPER_TOOTH, LOWER_TOOTH, MOUTH}, _REACH_MM["mouth"]
        inner = np.isin(kinds, list(wanted))
    else:
        rim = np.union1d(topology.masks[f"eyelid_upper_{name}"], topology.masks[f"eyelid_lower_{name}"])
        upper, lower = topology.masks[f"lid_contact_upper_{name}"], topology.masks[f"lid_contact_lower_{name}"]
        reach = _REACH_MM["eye"]
        inner = np.zeros(len(kinds), bool)
        inner[eyeball(face, name)] = True
        inner |= (kinds == SOCKET) & (mean[:, 0] * (1.0 if name == "left" else -1.0) > 0)
    near = np.full(len(kinds), False)
    distance = cKDTree(mean[rim]).query(mean[: face.n_skin], distance_upper_bound=reach)[0]
    near[: face.n_skin] = np.isfinite(distance)
    keep = near | inner
    chosen = topology.faces[keep[topology.faces].all(axis=1)]
    vertices = np.unique(chosen)
    kind = kinds[chosen].max(axis=1)  # a triangle that joins skin and socket or cavity is the latter
    pairs = np.isin(upper, vertices) & np.isin(lower, vertices)
    upper, lower = upper[pairs], lower[pairs]
    points = mean[vertices]
    away = cKDTree(mean[rim]).query(points)[0]
    touch, pair = cKDTree(np.concatenate([mean[upper], mean[lower]])).query(points)
    skin = vertices < face.n_skin

    def places(ids: NDArray[np.integer]) -> NDArray[np.intp]:
        return np.searchsorted(vertices, np.intersect1d(ids, vertices))

    return Opening(
        name=name,
        vertices=vertices,
        faces=np.searchsorted(vertices, chosen).astype(np.int32),
        kinds=kind.astype(np.uint8),
        rim=places(rim),
        upper=np.searchsorted(vertices, upper),
        lower=np.searchsorted(vertices, lower),
        probes=np.concatenate([places(upper), places(lower), places(_front(face, name, kinds))]),
        hidden=hidden[vertices],
        near=skin * _ease((_NEAR_MM - away) / _NEAR_MM),
        seam=skin * np.exp(-((touch / _SEAM_MM) ** 2)),
        pair=pair % len(upper),
    )


def _ease(value: NDArray[np.floating]) -> NDArray[np.float64]:
    w = np.clip(value, 0.0, 1.0)
    return np.asarray(w * w * (3 - 2 * w))


def _front(face: Face, name: str, kinds: NDArray[np.int8]) -> NDArray[np.intp]:
    """Return some of what is seen first in an opening: the foremost teeth, or the iris."""
    mean = face.mean_shape
    if name != "mouth":
        return np.asarray(face.topology.masks[f"iris_{name}"][::4], dtype=np.intp)
    picked = []
    for kind in (UPPER_TOOTH, LOWER_TOOTH):
        ids = np.flatnonzero(kinds == kind)
        front = ids[mean[ids, 2] > mean[ids, 2].max() - 8.0]
        picked.append(front[:: max(1, len(front) // 40)])
    return np.concatenate(picked)
