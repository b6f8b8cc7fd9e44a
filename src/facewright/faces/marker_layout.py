"""Where a simulated performer wears markers: about a centimetre apart on the face, each face its own way."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from facewright.errors import DegenerateError, TopologyError, ValueRangeError
from facewright.faces.face import Face
from facewright.mesh.areas import face_areas
from facewright.mesh.closest_point import ClosestPoints
from facewright.mesh.geodesics import path_distances
from facewright.mesh.normals import vertex_normals
from facewright.numeric.check import check_shape

MARKER_DIAMETER_MM = 3.0
SPACING_MM = 10.0

#: Distances that markers keep, mm: from the line where lips meet, from the edges of the lids, from the nostrils.
_OFF_LIPS_MM, _OFF_LIDS_MM, _OFF_NOSTRILS_MM = 5.5, 5.0, 4.0
_NOSTRIL_MM = 9.0
_CANDIDATES_PER_MM2 = 0.15
#: Smallest distance of two markers relative to their mean spacing: of points that fill a surface at a smallest distance
#: r, the nearest neighbours are 1.15 r apart on average.
_SMALLEST = 0.87
#: Markers on the rims of the lips are set first, evenly, along the points of this scheme.
_OUTER_LIPS = slice(48, 60)


@dataclass(frozen=True, eq=False)
class MarkerLayout:
    """Markers glued to a surface: spheres whose centres stand off the skin.

    Parameters
    ----------
    labels : tuple of str
        Names of the M markers.
    corners : ndarray of shape (M, 3), int32
        Vertices of the triangle that each marker sits on.
    weights : ndarray of shape (M, 3), float64
        Barycentric coordinates in it.
    standoff_mm : float
        Height of the centres above the skin: the radius.
    """

    labels: tuple[str, ...]
    corners: NDArray[np.int32]
    weights: NDArray[np.float64]
    standoff_mm: float = 0.5 * MARKER_DIAMETER_MM

    def __post_init__(self) -> None:
        check_shape("corners", self.corners, len(self.labels), 3)
        check_shape("weights", self.weights, len(self.labels), 3)

    def feet(self, vertices: NDArray[np.floating]) -> NDArray[np.float64]:
        """Return the points of the skin (..., M, 3) that the markers sit on, vertices (..., V, 3)."""
        triangles = np.asarray(vertices)[..., self.corners, :]
        return np.einsum("mk,...mkc->...mc", self.weights, triangles.astype(np.float64))

    def centres(self, vertices: NDArray[np.floating]) -> NDArray[np.float64]:
        """Return the centres of the spheres (..., M, 3): off the skin along the normals of their triangles."""
        triangles = np.asarray(vertices)[..., self.corners, :].astype(np.float64)
        normal = np.cross(
            triangles[..., 1, :] - triangles[..., 0, :], triangles[..., 2, :] - triangles[..., 0, :], axis=-1
        )
        normal /= np.maximum(np.linalg.norm(normal, axis=-1, keepdims=True), 1e-12)
        return np.einsum("mk,...mkc->...mc", self.weights, triangles) + self.standoff_mm * normal


def marker_region(face: Face, vertices: NDArray[np.floating]) -> NDArray[np.bool_]:
    """Return which skin vertices (n_skin,) may bear markers: forehead, cheeks, nose, lips' rims, jaw.

    Ears, neck, scalp, the edges of the lids, the inside of lips and nostrils stay free (Tena et al. 2011, Fig. 3).

    Parameters
    ----------
    face : Face
        Whose masks and landmarks are used.
    vertices : ndarray of shape (V, 3) or (n_skin, 3), millimetres
        The performer at rest.

    Raises
    ------
    TopologyError
        If the face has no masks of its facial region.
    """
    masks, n = face.topology.masks, face.n_skin
    if "face_region" not in masks or "ibug68" not in face.topology.landmarks:
        raise TopologyError(f"face {face.name!r} must mark its face_region and ibug68 landmarks to wear markers.")
    points = np.asarray(vertices, dtype=np.float64)[:n]
    faces = face.topology.submesh(n).faces
    allowed = np.zeros(n, bool)
    allowed[masks["face_region"][masks["face_region"] < n]] = True
    allowed &= ~_beyond_jaw(points, face.topology.landmarks["ibug68"])
    if "ears" in masks:
        allowed[masks["ears"][masks["ears"] < n]] = False
    for names, distance in (
        (("lip_contact_upper", "lip_contact_lower"), _OFF_LIPS_MM),
        (("lash_line_left", "lash_line_right"), _OFF_LIDS_MM),
        (("nostrils",), _OFF_NOSTRILS_MM),
    ):
        sources = np.concatenate([masks.get(name, np.empty(0, np.int32)) for name in names])
        sources = sources[sources < n]
        if len(sources):
            near = path_distances(points, faces, np.unique(sources), limit_mm=distance)
            allowed &= ~np.isfinite(near).any(axis=0)
    if "nostrils" not in masks:
        allowed &= ~_in_nostrils(points, vertex_normals(points, faces), face.topology.landmarks["ibug68"])
    return allowed


def _in_nostrils(
    points: NDArray[np.float64], normals: NDArray[np.float64], ibug68: NDArray[np.int32]
) -> NDArray[np.bool_]:
    """Return which points face the middle of a nostril, between tip, wing and base of the nose."""
    inside = np.zeros(len(points), bool)
    tip, base = points[ibug68[30]], points[ibug68[33]]
    for wing in points[ibug68[[31, 35]]]:
        middle = 0.2 * (tip + base) + 0.6 * wing + 0.2 * (tip - base) * [0.0, 1.0, 0.0]
        towards = middle - points
        near = np.linalg.norm(towards, axis=1) < _NOSTRIL_MM
        inside |= near & ((towards * normals).sum(axis=1) > 0.0)
    return inside


def _beyond_jaw(points: NDArray[np.float64], ibug68: NDArray[np.int32]) -> NDArray[np.bool_]:
    """Return which points lie under the jaw, behind the ears' fronts or far up the scalp."""
    jaw, brows, eyes = points[ibug68[:17]], points[ibug68[17:27]], points[ibug68[36:48]]
    # the hairline is about as far above the brows as the nose's base is below the eyes
    top = brows[:, 1].max() + 1.05 * (eyes[:, 1].mean() - points[ibug68[33], 1])
    behind = points[:, 2] < max(jaw[0, 2], jaw[16, 2]) + 12.0
    lowest = np.interp(points[:, 0], jaw[np.argsort(jaw[:, 0]), 0], jaw[np.argsort(jaw[:, 0]), 1])
    return behind | (points[:, 1] < lowest - 2.0) | (points[:, 1] > top)


def draw_marker_layout(
    face: Face, vertices: NDArray[np.floating], rng: np.random.Generator, *, spacing_mm: float = SPACING_MM
) -> MarkerLayout:
    """Glue markers on a performer: evenly around the lips, the rest by Poisson-disc sampling, nearly symmetric.

    Parameters
    ----------
    face : Face
        Topology and masks.
    vertices : ndarray of shape (V, 3) or (n_skin, 3), millimetres
        The performer at rest. Larger faces get more markers.
    rng : numpy.random.Generator
        No two layouts are alike.
    spacing_mm : float
        Mean distance of neighbours, about.

    Raises
    ------
    ValueRangeError
        If the spacing is not positive.
    DegenerateError
        If the region bears no marker at that spacing.
    TopologyError
        If the face does not mark its region.
    """
    if not (spacing_mm > 0 and np.isfinite(spacing_mm)):
        raise ValueRangeError(f"spacing_mm must be positive, got {spacing_mm}.")
    n = face.n_skin
    points = np.asarray(vertices, dtype=np.float64)[:n]
    faces = face.topology.submesh(n).faces
    allowed = marker_region(face, points)
    inside = faces[allowed[faces].all(axis=1)]
    if not len(inside):
        raise DegenerateError(f"face {face.name!r} must have room for markers, got none.")
    nearest = ClosestPoints(points, inside)
    smallest = _SMALLEST * spacing_mm
    wanted = _lip_rim(points[face.topology.landmarks["ibug68"][_OUTER_LIPS]], spacing_mm, rng)
    candidates = _on_surface(points, inside, rng)
    normals = vertex_normals(points, faces)
    chosen = _poisson_disc(nearest.query(wanted).points, candidates, smallest, rng)
    # glued by eye: a little off its place
    chosen = chosen + 0.06 * spacing_mm * rng.standard_normal(chosen.shape)
    places = nearest.query(chosen)
    corners = inside[places.faces].astype(np.int32)
    outside = (normals[corners].mean(axis=1) * [0.0, 0.0, 1.0]).sum(axis=1) > -0.2
    keep = outside & _apart(places.points, 0.6 * spacing_mm)
    order = np.lexsort((places.points[keep, 0].round(), -places.points[keep, 1].round()))
    corners, weights = corners[keep][order], places.barycentric[keep][order]
    labels = tuple(f"M{k + 1:03d}" for k in range(len(corners)))
    return MarkerLayout(labels, corners, weights)


def _lip_rim(outline: NDArray[np.float64], spacing: float, rng: np.random.Generator) -> NDArray[np.float64]:
    """Return points evenly along the closed outline (12, 3) of the lips, beginning at a corner of the mouth."""
    closed = np.concatenate([outline, outline[:1]])
    along = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(closed, axis=0), axis=1))])
    n = 2 * max(4, round(0.5 * along[-1] / spacing))
    at = (np.arange(n) + rng.uniform(-0.12, 0.12, n)) / n * along[-1]
    return np.stack([np.interp(at % along[-1], along, column) for column in closed.T], axis=1)


def _on_surface(points: NDArray[np.float64], faces: NDArray[np.int32], rng: np.random.Generator) -> NDArray[np.float64]:
    """Return points spread evenly at random over triangles, each followed by its mirror image."""
    areas = face_areas(points, faces)
    n = int(areas.sum() * _CANDIDATES_PER_MM2)
    chosen = rng.choice(len(faces), n, p=areas / areas.sum())
    u, v = np.sort(rng.random((2, n)), axis=0)
    weights = np.stack([u, v - u, 1.0 - v], axis=1)
    drawn = np.einsum("nk,nkc->nc", weights, points[faces[chosen]])
    return np.stack([drawn, drawn * [-1.0, 1.0, 1.0]], axis=1).reshape(-1, 3)


def _poisson_disc(
    first: NDArray[np.float64], candidates: NDArray[np.float64], smallest: float, rng: np.random.Generator
) -> NDArray[np.float64]:
    """Return points no nearer to one another than `smallest`: the first, then candidates in pairs, in random order."""
    pool = np.concatenate([first[_apart(first, smallest * 0.8)], candidates])
    neighbours = cKDTree(pool).query_ball_point(pool, smallest)
    n_first = len(pool) - len(candidates)
    pairs = n_first + 2 * rng.permutation(len(candidates) // 2)
    order = np.concatenate([np.arange(n_first), np.stack([pairs, pairs + 1], axis=1).ravel()])
    free = np.ones(len(pool), bool)
    chosen = []
    for k in order:  # a few ten thousand candidates, once a performer
        if free[k] or k < n_first:
            chosen.append(k)
            free[neighbours[k]] = False
    return pool[chosen]


def _apart(points: NDArray[np.float64], smallest: float) -> NDArray[np.bool_]:
    """Return which points are no nearer than `smallest` to an earlier one that is kept."""
    keep = np.ones(len(points), bool)
    for i, k in sorted(cKDTree(points).query_pairs(smallest)):
        if keep[i]:
            keep[k] = False
    return keep
