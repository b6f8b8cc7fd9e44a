"""Masks and landmarks of ICT-FaceKit, derived from its edge loops, its landmarks and the reach of its expressions."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from facewright.faces.blendshape_names import blendshape_index
from facewright.faces.ict_rings import OpeningRings, contact_pairs, opening_rings, polygon_adjacency
from facewright.mesh.connectivity import boundary_loops

FIRST_LOWER_TOOTH = 19247  # from the tooth table in ICT-FaceKit's README

Masks = dict[str, NDArray[np.int32]]

_LIP_RINGS = (5, 9)  # edge rings of the mouth in which the lips touch
_LID_RINGS = (1, 3)  # edge rings of the eyes in which closed lids touch
_TOUCH_MM = 1.3


def openings(
    vertices: NDArray, faces: NDArray[np.int32], quads: NDArray[np.int32], n_skin: int
) -> dict[str, OpeningRings]:
    """Return the edge rings of ``"mouth"``, ``"left"`` and ``"right"`` eye, found as boundary loops of the skin."""
    adjacency = polygon_adjacency(quads[(quads < n_skin).all(axis=1)], n_skin)
    points = np.asarray(vertices[:n_skin], dtype=np.float64)
    loops = boundary_loops(faces[(faces < n_skin).all(axis=1)])
    front = [loop for loop in loops if points[loop, 2].mean() > 0]  # the fourth loop is the cut at the shoulders
    mouth = min(front, key=lambda loop: points[loop, 1].mean())
    left = max(front, key=lambda loop: points[loop, 0].mean())
    right = min(front, key=lambda loop: points[loop, 0].mean())
    return {
        name: opening_rings(points, adjacency, loop)
        for name, loop in (("mouth", mouth), ("left", left), ("right", right))
    }


def contact_masks(vertices: NDArray, deltas: NDArray, rings: dict[str, OpeningRings], mirror: NDArray) -> Masks:
    """Return the lip and lid contact pairs; masks of one pair name have equal length and go together by row."""
    masks: Masks = {}
    points = np.asarray(vertices, dtype=np.float64)
    upper, lower = _touching(points, rings["mouth"], _LIP_RINGS)
    masks["lip_contact_upper"], masks["lip_contact_lower"] = upper, lower
    closed = points + deltas[blendshape_index("eyeBlink_L")]
    upper, lower = _touching(closed, rings["left"], _LID_RINGS)
    masks["lid_contact_upper_left"], masks["lid_contact_lower_left"] = upper, lower
    masks["lid_contact_upper_right"], masks["lid_contact_lower_right"] = mirror[upper], mirror[lower]
    return masks


def _touching(points: NDArray, rings: OpeningRings, reach: tuple[int, int]) -> tuple[NDArray[np.int32], ...]:
    within = (rings.ring >= reach[0]) & (rings.ring <= reach[1])
    return contact_pairs(points, np.flatnonzero(rings.upper & within), np.flatnonzero(rings.lower & within), _TOUCH_MM)


def ict_masks(
    vertices: NDArray,
    deltas: NDArray,
    faces: NDArray[np.int32],
    quads: NDArray[np.int32],
    parts: dict[str, tuple[int, int]],
    mirror: NDArray[np.int32],
) -> Masks:
    """Return all named vertex sets of ICT-FaceKit."""
    n_skin = parts["head_and_neck"][1]
    rings = openings(vertices, faces, quads, n_skin)
    masks = contact_masks(vertices, deltas, rings, mirror)
    teeth = parts["teeth"]
    masks["teeth_upper"] = np.arange(teeth[0], FIRST_LOWER_TOOTH, dtype=np.int32)
    masks["teeth_lower"] = np.arange(FIRST_LOWER_TOOTH, teeth[1], dtype=np.int32)
    return masks
