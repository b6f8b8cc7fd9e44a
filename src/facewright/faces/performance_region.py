"""The part of a face that acts and that performers wear markers on: forehead to jaw, no ears, throat and insides."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import PchipInterpolator
from scipy.sparse.csgraph import dijkstra

from facewright.errors import TopologyError
from facewright.faces.face import Face
from facewright.mesh.connectivity import boundary_loops, vertex_adjacency, vertex_components
from facewright.mesh.geodesics import path_graph

_FOREHEAD = 0.8  # how far above the brows it reaches, in heights from the base of the nose to the brows
_ROUNDS = 3  # of removing what sticks out of the outline
_UNDER_JAW = np.deg2rad(2.0)


def performance_region(face: Face) -> NDArray[np.bool_]:
    """Return which skin vertices (n_skin,) lie in the face as performers wear markers on it.

    The outer limit is a smooth curve through the jaw line and across the forehead. Mouth and eyes are open: the region
    ends where the lips touch and at the lash lines. It is one connected piece, the same on both sides.

    Raises
    ------
    TopologyError
        If the face lacks the ``ibug68`` landmarks or the masks ``lip_contact_*`` and ``lash_line_*``.
    """
    skin = face.skin()
    topology = skin.topology
    points = skin.mean_shape.astype(np.float64)
    inside = _before_the_limit(points, topology.landmarks.get("ibug68"), topology.name)
    inside[topology.part_slice("head_and_neck")] = False
    if "ears" in topology.masks:
        inside[topology.masks["ears"]] = False
    inside &= ~_insides(points, topology.faces, topology.masks)
    if topology.mirror is not None:
        inside &= inside[topology.mirror]
    return _main_piece(inside, topology.faces if topology.quads is None else topology.quads)


def acting_surface(face: Face, margin_mm: float = 30.0) -> NDArray[np.bool_]:
    """Return which skin vertices (n_skin,) lie in the `performance_region` or within `margin_mm` of it on the outside.

    Lips and lids still end where they touch; for markers that were set beyond the region.
    """
    skin = face.skin()
    points, faces = skin.mean_shape.astype(np.float64), skin.topology.faces
    outside = ~_insides(points, faces, skin.topology.masks)
    inside = performance_region(face)
    graph = path_graph(points, faces[outside[faces].all(axis=1)])
    distance = dijkstra(graph, directed=False, indices=np.flatnonzero(inside), min_only=True, limit=margin_mm)
    kept = faces[(np.isfinite(distance) & outside)[faces].all(axis=1)]
    found = np.zeros(len(points), dtype=bool)
    found[kept] = True
    return found


def _before_the_limit(points: NDArray[np.float64], ids: NDArray[np.int32] | None, name: str) -> NDArray[np.bool_]:
    """Return the vertices within the smooth curve of jaw line and forehead, seen from inside the head."""
    if ids is None or (ids[:34] < 0).any():
        raise TopologyError(f"topology {name!r} must mark the jaw line, brows and nose of 'ibug68'.")
    jaw, brows, nose_base = points[ids[:17]], points[ids[17:27]], points[ids[33]]
    centre = np.array([0.0, nose_base[1] + 12.0, 0.5 * (jaw[0, 2] + jaw[-1, 2]) - 8.0])
    front = (np.abs(points[:, 0]) < 8.0) & (points[:, 2] > centre[2])
    height = brows[:, 1].max() + _FOREHEAD * (brows[:, 1].max() - nose_base[1])
    top = points[np.flatnonzero(front)[np.abs(points[front, 1] - height).argmin()]] * [0.0, 1.0, 1.0]
    around, out = _angles(jaw - centre)
    above = _angles(top[None] - centre)[1]
    # chin, every second point up to the temple (both sides averaged), the forehead; even about chin and crown
    turn = np.abs(around)
    knots = np.concatenate([0.5 * (turn[8::-2] + turn[8::2]), np.pi + np.deg2rad([-15.0, 0.0])])
    knots[0] = 0.0
    limits = np.concatenate([0.5 * (out[8::-2] + out[8::2]) + _UNDER_JAW, np.repeat(above, 2)])
    # monotone between knots, and even, so that it is smooth over chin and crown
    knots = np.concatenate([-knots[:0:-1], knots, 2 * np.pi - knots[-2::-1]])
    curve = PchipInterpolator(knots, np.concatenate([limits[:0:-1], limits, limits[-2::-1]]))
    around, out = _angles(points - centre)
    return np.asarray(out <= curve(np.abs(around)))


def _angles(arms: NDArray[np.float64]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return the meridian, 0 over the chin, and the angle from straight ahead of vectors (N, 3), radians."""
    d = arms / np.maximum(np.linalg.norm(arms, axis=1, keepdims=True), 1e-9)
    return np.arctan2(d[:, 0], -d[:, 1]), np.arccos(np.clip(d[:, 2], -1.0, 1.0))


def _insides(points: NDArray, faces: NDArray[np.int32], masks: Mapping[str, NDArray[np.int32]]) -> NDArray[np.bool_]:
    """Return the vertices of lips and lids behind the line where they touch."""
    adjacency = vertex_adjacency(faces, len(points))
    inner = np.zeros(len(points), dtype=bool)
    loops = boundary_loops(faces)
    for rims in (("lip_contact_upper", "lip_contact_lower"), ("lash_line_left",), ("lash_line_right",)):
        if any(name not in masks for name in rims):
            raise TopologyError(f"the face must have the mask {rims[0]!r}, got none.")
        rim = np.concatenate([masks[name] for name in rims])
        middle = points[rim].mean(axis=0)
        loop = min(loops, key=lambda ids: float(np.linalg.norm(points[ids].mean(axis=0) - middle)))
        ring = dijkstra(adjacency, directed=False, unweighted=True, indices=loop, min_only=True, limit=30)
        inner |= ring < np.median(ring[rim])
    return inner


def _main_piece(inside: NDArray[np.bool_], polygons: NDArray[np.int32]) -> NDArray[np.bool_]:
    """Return the largest connected piece of the polygons inside, without those that hang on by a corner."""
    for _ in range(_ROUNDS):
        kept = polygons[(inside[polygons] | (polygons < 0)).all(axis=1)]
        count = np.bincount(kept[kept >= 0], minlength=len(inside))
        # at an end that sticks out two vertices of a polygon have no other one
        alone = ((count[kept] == 1) & (kept >= 0)).sum(axis=1) >= 2
        inside = np.zeros_like(inside)
        inside[kept[~alone][kept[~alone] >= 0]] = True
    triangles = np.concatenate([kept[:, :3], kept[kept[:, -1] >= 0][:, [0, 2, 3]]]) if kept.shape[1] == 4 else kept
    labels = vertex_components(triangles, len(inside))
    return inside & (labels == np.bincount(labels[inside]).argmax())
