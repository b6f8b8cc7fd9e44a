"""The landmark term of scan fitting (FaceWarehouse eq. 1): points in 3D, points in 2D, and the sliding contour."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from facewright.errors import TopologyError
from facewright.faces.face import Face
from facewright.fitting.scan_target import ScanTarget
from facewright.landmarks.contour import ContourStrips, build_contour_strips, slide_on_outline
from facewright.landmarks.scheme import load_scheme

#: Residuals beyond this lose weight as in a Student t distribution of 4 degrees of freedom.
_SCALE_MM = 3.0
_FREEDOM = 4.0
#: Offsets of a detector's landmarks are believed up to this.
_LARGEST_OFFSET_MM = 5.0


@dataclass(frozen=True, eq=False)
class LandmarkPull:
    """Where landmarks want vertices to be, linear at the current shape.

    Parameters
    ----------
    vertices : ndarray of shape (N,), int
        The vertex of each pull.
    goals : ndarray of shape (N, 3), millimetres
        Where it should be, in the scan's frame.
    projectors : ndarray of shape (N, 3, 3)
        Symmetric projectors: identity for a 3D landmark; across the line of sight for a 2D one; across the outline
        for one that slides along it.
    weights : ndarray of shape (N,)
        Confidence, less for outliers.
    residuals_mm : ndarray of shape (N,)
        Distance to the goal.
    """

    vertices: NDArray[np.intp]
    goals: NDArray[np.float64]
    projectors: NDArray[np.float64]
    weights: NDArray[np.float64]
    residuals_mm: NDArray[np.float64]


class LandmarkTerm:
    """Builds the pulls of a target's landmarks on a mesh.

    Parameters
    ----------
    face : Face
        The template: its ``fw74`` vertices and jaw line.

    Raises
    ------
    TopologyError
        If the face does not mark the ``fw74`` landmarks.
    """

    def __init__(self, face: Face) -> None:
        ids = face.topology.landmarks.get("fw74")
        if ids is None:
            raise TopologyError(f"topology {face.topology.name!r} must mark the 'fw74' landmarks.")
        scheme = load_scheme("fw74")
        self.ids = np.asarray(ids, dtype=np.intp)
        self.fixed = scheme.fixed[self.ids[scheme.fixed] >= 0]
        self.sliding = scheme.sliding
        self._rims = scheme.groups["inner_mouth"]
        self.strips: ContourStrips = build_contour_strips(face.topology, face.mean_shape)

    def pulls(self, vertices: NDArray[np.float64], rotation: NDArray[np.float64], target: ScanTarget) -> LandmarkPull:
        """Return the pulls on a mesh (V, 3) in the scan's frame; `rotation` is the head's, for the outline."""
        parts = [self._lifted(vertices, target)]
        if target.intrinsics is not None and target.contour_pixels is not None:
            parts.append(self._flat(vertices, target))
            parts.append(self._contour(vertices, rotation, target))
        ids, goals, projectors, confidence = (np.concatenate(column) for column in zip(*parts))
        distance = np.linalg.norm(np.einsum("nij,nj->ni", projectors, vertices[ids] - goals), axis=1)
        robust = (_FREEDOM + 2.0) / (_FREEDOM + (distance / _SCALE_MM) ** 2) * _FREEDOM / (_FREEDOM + 2.0)
        return LandmarkPull(ids, goals, projectors, confidence * robust, distance)

    def offsets(self, vertices: NDArray[np.float64], target: ScanTarget) -> NDArray[np.float64]:
        """Return how far 3D landmarks are from their vertices of a mesh in the scan's frame, (74, 3); 0 where unknown.

        Of each offset the share that is not the noise of a well-placed point (confidence 1) is kept: what a detector
        does alike in every picture of one person.
        """
        found = np.zeros((len(self.ids), 3))
        used = self.fixed[self._known(target)]
        found[used] = target.landmarks[used] - vertices[self.ids[used]]
        found *= (1.0 - target.confidence)[:, None]
        length = np.linalg.norm(found, axis=1, keepdims=True)
        return found * np.minimum(1.0, _LARGEST_OFFSET_MM / np.maximum(length, 1e-9))

    def _lifted(self, vertices: NDArray[np.float64], target: ScanTarget) -> tuple[NDArray, ...]:
        used = self.fixed[self._known(target) & ~self._only_flat(target)]
        eye = np.broadcast_to(np.eye(3), (len(used), 3, 3))
        return self.ids[used], target.landmarks[used], eye, target.confidence[used]

    def _known(self, target: ScanTarget) -> NDArray[np.bool_]:
        """Tell which fixed landmarks have a 3D position."""
        return np.isfinite(target.landmarks[self.fixed]).all(axis=1) & (target.confidence[self.fixed] > 0)

    def _only_flat(self, target: ScanTarget) -> NDArray[np.bool_]:
        """Tell which fixed landmarks count in the picture only: those without depth, and the inner rims of the lips.

        The depth at a rim is that of whatever fills the crack or lies behind it.
        """
        if target.contour_pixels is None or target.intrinsics is None:
            return np.zeros(len(self.fixed), dtype=bool)
        seen = np.isfinite(target.contour_pixels[self.fixed]).all(axis=1) & (target.confidence[self.fixed] > 0)
        return seen & (~self._known(target) | np.isin(self.fixed, self._rims))

    def _flat(self, vertices: NDArray[np.float64], target: ScanTarget) -> tuple[NDArray, ...]:
        """Landmarks that count in the picture: the depth stays that of the vertex, frozen at its current value."""
        assert target.contour_pixels is not None and target.intrinsics is not None
        used = self.fixed[self._only_flat(target)]
        ids = self.ids[used]
        camera = target.intrinsics
        z = vertices[ids, 2]
        goals = np.stack(
            [
                (target.contour_pixels[used, 0] - camera.centre_x) / camera.focal_x * z,
                (target.contour_pixels[used, 1] - camera.centre_y) / camera.focal_y * z,
                z,
            ],
            axis=1,
        )
        ray = goals / np.maximum(np.linalg.norm(goals, axis=1, keepdims=True), 1e-9)
        return ids, goals, np.eye(3) - ray[:, :, None] * ray[:, None, :], target.confidence[used]

    def _contour(
        self, vertices: NDArray[np.float64], rotation: NDArray[np.float64], target: ScanTarget
    ) -> tuple[NDArray, ...]:
        """Contour points: the nearest vertex of the outline, pulled across it and free to slide along it."""
        assert target.contour_pixels is not None and target.intrinsics is not None
        found = target.contour_pixels[self.sliding]
        usable = np.isfinite(found).all(axis=1) & (target.confidence[self.sliding] > 0)
        candidates = vertices[self.strips.vertices]
        if not usable.any() or candidates[..., 2].min() <= 0:
            return np.empty(0, dtype=np.intp), np.empty((0, 3)), np.empty((0, 3, 3)), np.empty(0)
        found = found[usable]
        chosen = self.strips.outline(target.intrinsics.project(candidates), rotation)
        corners = self.strips.vertices[np.arange(len(chosen)), chosen].astype(np.intp)
        outline = target.intrinsics.project(vertices[corners])
        place = slide_on_outline(found, outline)
        first, last = outline[place.first], outline[place.first + 1]
        on_line = first + place.fraction[:, None] * (last - first)
        along = (last - first) / np.maximum(np.linalg.norm(last - first, axis=1, keepdims=True), 1e-9)
        across = np.stack([-along[:, 1], along[:, 0]], axis=1)
        ids = corners[place.first + (place.fraction > 0.5)]
        z = vertices[ids, 2]
        # the miss across the outline, in millimetres at the vertex's depth, which stays frozen
        miss = np.einsum("nc,nc->n", found - on_line, across)
        focal = np.array([target.intrinsics.focal_x, target.intrinsics.focal_y])
        direction = np.concatenate([across / focal, np.zeros((len(ids), 1))], axis=1)
        length = np.linalg.norm(direction, axis=1, keepdims=True)
        direction /= length
        goals = vertices[ids] + direction * (miss * z * length[:, 0])[:, None]
        return ids, goals, direction[:, :, None] * direction[:, None, :], target.confidence[self.sliding][usable]
