"""Masks and landmarks of ICT-FaceKit, derived from its edge loops, its landmarks and the reach of its expressions."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

from facewright.errors import FileFormatError
from facewright.faces.blendshape_names import blendshape_index, read_package_json
from facewright.faces.ict_rings import (
    OpeningRings,
    contact_pairs,
    enclosed,
    opening_rings,
    polygon_adjacency,
    shortest_path,
)
from facewright.mesh.connectivity import boundary_loops

Masks = dict[str, NDArray[np.int32]]

NARROW_FACE = 6706  # vertices of the "narrow face area", from ICT-FaceKit's README
FIRST_LOWER_TOOTH = 19247  # from the tooth table there
N_SCLERA = 770  # vertices of an eyeball's outer layer, from the table there

_LIP_RINGS = (5, 9)  # edge rings of the mouth in which the lips touch
_LID_RINGS = (1, 3)  # edge rings of the eyes in which closed lids touch
_TOUCH_MM = 1.3
_LID_MOTION_MM = 1.0  # an upper lid is where a blink moves the skin by more than this
_LOWER_LID_MM = 8.0
_BROW_MARGIN_MM = 2.0
_IRIS_MM, _PUPIL_MM = 6.0, 2.2


def ict_landmarks() -> dict[str, NDArray[np.int32]]:
    """Return the vertices of the ``"ibug68"`` and ``"fw74"`` points; contour points are those of the frontal outline.

    The first are ICT-FaceKit's own; the second were measured once by ``tools/measure_ict_landmarks.py``.
    """
    content = read_package_json("ict_landmarks.json")
    if not isinstance(content, dict) or [len(content.get(k, ())) for k in ("ibug68", "fw74")] != [68, 74]:
        raise FileFormatError("ict_landmarks.json must hold 68 and 74 vertices.")
    return {key: np.asarray(content[key], dtype=np.int32) for key in ("ibug68", "fw74")}


class IctAnnotator:
    """Derives the masks; keeps what they share: skin positions, edges, rings round mouth and eyes.

    Parameters
    ----------
    vertices : ndarray of shape (V, 3), millimetres
        The mean.
    deltas : ndarray of shape (46, V, 3), millimetres
        The generic blendshapes.
    faces, quads : ndarray
        Triangles and polygons.
    parts : mapping of str to (start, stop)
        Vertex ranges.
    landmarks : mapping of str to ndarray
        Vertices of ``"ibug68"`` and ``"fw74"``.
    mirror : ndarray of shape (V,)
        Mirror map.
    """

    def __init__(
        self,
        vertices: NDArray,
        deltas: NDArray,
        faces: NDArray[np.int32],
        quads: NDArray[np.int32],
        parts: Mapping[str, tuple[int, int]],
        landmarks: Mapping[str, NDArray[np.int32]],
        mirror: NDArray[np.int32],
    ) -> None:
        self.points = np.asarray(vertices, dtype=np.float64)
        self.deltas = deltas
        self.parts, self.landmarks, self.mirror = parts, landmarks, mirror
        self.n_skin = parts["head_and_neck"][1]
        skin_quads = quads[(quads < self.n_skin).all(axis=1)]
        self.lengths = polygon_adjacency(skin_quads, self.n_skin, self.points)
        self.edges = polygon_adjacency(skin_quads, self.n_skin)
        self.rings = self._rings(faces[(faces < self.n_skin).all(axis=1)])

    def _rings(self, skin_faces: NDArray[np.int32]) -> dict[str, OpeningRings]:
        """Measure rings round ``"mouth"`` and ``"left"`` eye, which are boundary loops of the skin."""
        skin = self.points[: self.n_skin]
        front = [loop for loop in boundary_loops(skin_faces) if skin[loop, 2].mean() > 0]  # not the shoulders' cut
        mouth = min(front, key=lambda loop: skin[loop, 1].mean())
        left = max(front, key=lambda loop: skin[loop, 0].mean())
        return {"mouth": opening_rings(skin, self.edges, mouth), "left": opening_rings(skin, self.edges, left)}

    def masks(self) -> Masks:
        """Return all named vertex sets; contact pairs go together by row, all others are sorted."""
        result = self._contacts() | self._mouth() | self._eyes() | self._eyeballs()
        result["face"] = np.arange(*self.parts["face"], dtype=np.int32)
        result["face_region"] = np.arange(NARROW_FACE, dtype=np.int32)
        teeth = self.parts["teeth"]
        result["teeth_upper"] = np.arange(teeth[0], FIRST_LOWER_TOOTH, dtype=np.int32)
        result["teeth_lower"] = np.arange(FIRST_LOWER_TOOTH, teeth[1], dtype=np.int32)
        x = self.points[: self.n_skin, 0]
        result["left"], result["right"] = _ids(x > 1e-3), _ids(x < -1e-3)
        return result | self._regions(result)

    def _contacts(self) -> Masks:
        mouth, left = self.rings["mouth"], self.rings["left"]
        masks: Masks = {}
        masks["lip_contact_upper"], masks["lip_contact_lower"] = _touching(self.points, mouth, _LIP_RINGS)
        closed = self.points + self.deltas[blendshape_index("eyeBlink_L")]
        upper, lower = _touching(closed, left, _LID_RINGS)
        masks["lid_contact_upper_left"], masks["lid_contact_lower_left"] = upper, lower
        masks["lid_contact_upper_right"], masks["lid_contact_lower_right"] = self.mirror[upper], self.mirror[lower]
        return masks

    def _mouth(self) -> Masks:
        """Lips: from the vermilion border, which runs through the outer lip landmarks, to the opening."""
        mouth, outer = self.rings["mouth"], self.landmarks["ibug68"][48:60]
        border = shortest_path(self.lengths, outer[:7])  # half of it, and its mirror image
        below = shortest_path(self.lengths, outer[[6, 7, 8, 9, 10, 11, 0]])
        border = np.union1d(border, below)
        border = np.union1d(border, self.mirror[border])
        lips = enclosed(self.edges, border, int(mouth.loop[0]))
        return {
            "lips": lips.astype(np.int32),
            "lips_upper": lips[mouth.upper[lips]].astype(np.int32),
            "lips_lower": lips[mouth.lower[lips]].astype(np.int32),
        }

    def _eyes(self) -> Masks:
        """Lids: from the lash line outwards, as far as a blink moves the upper and 8 mm for the lower."""
        left, lash = self.rings["left"], self.landmarks["ibug68"][42:48]
        line = shortest_path(self.lengths, np.append(lash, lash[0]))
        margin = enclosed(self.edges, line, int(left.loop[0]))
        skin = self.points[: self.n_skin]
        motion = np.linalg.norm(self.deltas[blendshape_index("eyeBlink_L"), : self.n_skin], axis=1)
        outside = ~np.isin(np.arange(self.n_skin), np.setdiff1d(margin, line))
        lower_line = line[left.lower[line]]
        gap = np.linalg.norm(skin[:, None] - skin[None, lower_line], axis=2).min(axis=1)
        masks = {
            "eyelid_upper_left": _ids(left.upper & outside & (motion > _LID_MOTION_MM) & (skin[:, 0] > 0)),
            "eyelid_lower_left": _ids(left.lower & outside & (gap < _LOWER_LID_MM) & (skin[:, 0] > 0)),
            "lash_line_left": np.unique(line).astype(np.int32),
        }
        return masks | {key.replace("_left", "_right"): self._mirrored(ids) for key, ids in masks.items()}

    def _eyeballs(self) -> Masks:
        """Iris and pupil: discs round the foremost point of each eyeball's outer layer."""
        masks: Masks = {}
        start, _ = self.parts["eyeball_left"]
        ball = self.points[start : start + N_SCLERA]
        front = ball[ball[:, 2].argmax()]
        radius = np.hypot(*(ball - front)[:, :2].T)
        facing = ball[:, 2] > ball[:, 2].mean()
        for name, limit in (("iris", _IRIS_MM), ("pupil", _PUPIL_MM)):
            masks[f"{name}_left"] = start + _ids(facing & (radius <= limit))
            masks[f"{name}_right"] = self._mirrored(masks[f"{name}_left"])
        return masks

    def _regions(self, masks: Masks) -> Masks:
        """Regions of the frontal face: outlines through landmarks, seen from the front."""
        skin = self.points[: self.n_skin]
        p = self.points[self.landmarks["fw74"]]
        narrow = np.arange(self.n_skin) < NARROW_FACE
        used = np.zeros(self.n_skin, dtype=bool)
        for name in ("lips", "eyelid_upper_left", "eyelid_upper_right", "eyelid_lower_left", "eyelid_lower_right"):
            used[masks[name]] = True
        for name in ("left", "right"):  # the wet inside of the lids
            used[self.rings["left"].loop if name == "left" else self.mirror[self.rings["left"].loop]] = True
        result: Masks = {}
        outline = p[[21, 22, 23, 24, 25, 26], :2]
        brow = narrow & ~used & (_outline_distance(skin[:, :2], outline) < _BROW_MARGIN_MM)
        result["brow_left"] = _ids(brow)
        result["brow_right"] = self._mirrored(result["brow_left"])
        used[result["brow_left"]] = used[result["brow_right"]] = True
        alar = p[52, 0] + 3.0
        bridge = np.array(
            [[0, p[43, 1]], [9.0, p[43, 1]], [11.0, p[44, 1]], [alar, p[52, 1] + 6], [alar, p[51, 1] - 2]]
        )
        half = np.concatenate([bridge, [[0, p[49, 1] - 1]]])
        mirrored = skin[:, :2] * np.array([1.0, 1.0])
        mirrored[:, 0] = np.abs(mirrored[:, 0])
        nose = narrow & ~used & (_outline_distance(mirrored, half) <= 0.0)
        result["nose"] = _ids(nose)
        used |= nose
        brow_top = np.interp(np.abs(skin[:, 0]), [0.0, p[23, 0], p[22, 0], p[21, 0]], p[[23, 23, 22, 21], 1])
        result["forehead"] = _ids(narrow & ~used & (skin[:, 1] > brow_top))
        side = np.abs(skin[:, 0])
        mouth_low, lid_low = p[63, 1], p[41, 1]
        chin = narrow & ~used & (skin[:, 1] < mouth_low) & (skin[:, 2] > p[7, 2] - 25.0) & (side < p[60, 0])
        result["chin"] = _ids(chin)
        cheek = narrow & ~used & ~chin & (skin[:, 1] < lid_low) & (skin[:, 1] > mouth_low) & (side > alar)
        result["cheeks_left"], result["cheeks_right"] = _ids(cheek & (skin[:, 0] > 0)), _ids(cheek & (skin[:, 0] < 0))
        return result

    def _mirrored(self, ids: NDArray[np.int32]) -> NDArray[np.int32]:
        return np.sort(self.mirror[ids])


def _ids(mask: NDArray[np.bool_]) -> NDArray[np.int32]:
    return np.flatnonzero(mask).astype(np.int32)


def _touching(points: NDArray, rings: OpeningRings, reach: tuple[int, int]) -> tuple[NDArray[np.int32], ...]:
    within = (rings.ring >= reach[0]) & (rings.ring <= reach[1])
    upper, lower = (np.flatnonzero(side & within) for side in (rings.upper, rings.lower))
    return contact_pairs(points, upper, lower, _TOUCH_MM)


def _outline_distance(points: NDArray, outline: NDArray) -> NDArray[np.float64]:
    """Return the signed distance of 2D points (N, 2) from a simple polygon (K, 2): negative inside."""
    start, end = outline, np.roll(outline, -1, axis=0)
    along = end - start
    relative = points[:, None] - start[None]
    t = np.clip((relative * along).sum(axis=2) / np.maximum((along**2).sum(axis=1), 1e-12), 0.0, 1.0)
    distance = np.linalg.norm(relative - t[..., None] * along, axis=2).min(axis=1)
    rising = (start[:, 1] <= points[:, None, 1]) != (end[:, 1] <= points[:, None, 1])
    slope = np.divide(along[:, 0], along[:, 1], out=np.zeros(len(along)), where=along[:, 1] != 0)
    crossing = start[:, 0] + slope * (points[:, None, 1] - start[:, 1])
    inside = (rising & (points[:, None, 0] < crossing)).sum(axis=1) % 2 == 1
    return np.where(inside, -distance, distance)
