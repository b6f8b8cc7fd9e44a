"""Which point of a scan belongs to which vertex: closest points behind gates of distance, direction and visibility."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from facewright.camera.pinhole import Intrinsics
from facewright.errors import NoFaceError
from facewright.fitting.scan_target import ScanTarget
from facewright.mesh.closest_point import ClosestPoints
from facewright.mesh.connectivity import boundary_edges
from facewright.mesh.normals import vertex_normals
from facewright.numeric.robust import median_scale, tukey_weights

#: Cells of the coarse depth buffer, mm, and how far behind its front a vertex still counts as seen.
_CELL_MM, _BEHIND_MM = 1.5, 3.0
#: Samples of a triangle in the buffer: a lattice of this many steps.
_LATTICE = 4
#: A vertex is exposed in a direction to which its normal is at least this near.
_FACING_COSINE = 0.3
#: Scale of the robust weights: this many standard deviations, at least so many millimetres.
_OUTLIER_SIGMAS, _LEAST_SCALE_MM = 4.0, 0.8


@dataclass(frozen=True, eq=False)
class Gates:
    """How far and how askew a closest point may be.

    Parameters
    ----------
    distance_mm : float
        Largest distance.
    angle_degrees : float
        Largest angle between the normals of mesh and scan.
    """

    distance_mm: float
    angle_degrees: float = 50.0


@dataclass(frozen=True, eq=False)
class Matches:
    """Vertices of the mesh and their points of the scan.

    Parameters
    ----------
    vertices : ndarray of shape (N,), int
        Vertices.
    points, normals : ndarray of shape (N, 3)
        Points of the scan and its normals there.
    weights : ndarray of shape (N,)
        In (0, 1]; small for outliers.
    """

    vertices: NDArray[np.intp]
    points: NDArray[np.float64]
    normals: NDArray[np.float64]
    weights: NDArray[np.float64]


class ScanSurface:
    """The surface of a scan, ready for many searches.

    Parameters
    ----------
    target : ScanTarget
        The scan.

    Raises
    ------
    NoFaceError
        If it has no triangles.
    """

    def __init__(self, target: ScanTarget) -> None:
        if not len(target.faces):
            raise NoFaceError("the scan must hold a surface, got points without triangles.")
        self.target = target
        self._search = ClosestPoints(target.points, target.faces)
        rim = np.zeros(len(target.points), dtype=bool)
        rim[boundary_edges(target.faces)] = True
        self._rim = rim[target.faces]  # (F, 3)

    def match(
        self,
        vertices: NDArray[np.float64],
        normals: NDArray[np.float64],
        candidates: NDArray[np.intp],
        gates: Gates,
    ) -> Matches:
        """Match candidate vertices (N,) of a mesh in the scan's frame with their closest points.

        A vertex whose closest point lies on the rim of the scan is beyond what was seen and stays unmatched.
        """
        found = self._search.query(vertices[candidates], gates.distance_mm)
        hit = found.faces >= 0
        triangles = self.target.faces[found.faces]
        share = found.barycentric
        normal = np.einsum("nk,nkc->nc", share, self.target.normals[triangles])
        normal /= np.maximum(np.linalg.norm(normal, axis=1, keepdims=True), 1e-12)
        on_rim = (self._rim[found.faces] | (share <= 1e-6)).all(axis=1)
        facing = np.einsum("nc,nc->n", normal, normals[candidates]) >= np.cos(np.deg2rad(gates.angle_degrees))
        keep = hit & ~on_rim & facing
        if not keep.any():
            empty = np.empty((0, 3))
            return Matches(np.empty(0, dtype=np.intp), empty, empty, np.empty(0))
        chosen, points, normal = candidates[keep], found.points[keep], normal[keep]
        across = np.einsum("nc,nc->n", vertices[chosen] - points, normal)
        scale = max(_OUTLIER_SIGMAS * median_scale(across), _LEAST_SCALE_MM)
        weights = tukey_weights(across, scale)
        used = weights > 1e-3
        return Matches(chosen[used], points[used], normal[used], weights[used])


def seen_from_camera(
    vertices: NDArray[np.float64], faces: NDArray[np.integer], intrinsics: Intrinsics | None
) -> NDArray[np.bool_]:
    """Tell which vertices (V, 3) of the camera's frame a camera sees: a coarse depth buffer of 1.5 mm cells.

    Parameters
    ----------
    vertices : ndarray of shape (V, 3), millimetres
        The mesh, z away from the camera.
    faces : ndarray of shape (F, 3)
        Its triangles.
    intrinsics : Intrinsics or None
        The camera; None looks along z without perspective.
    """
    depth = vertices[:, 2]
    flat = vertices[:, :2]
    if intrinsics is not None:
        middle = float(np.median(depth))
        flat = flat / np.maximum(depth, 1.0)[:, None] * middle
    corners = np.concatenate([flat, depth[:, None]], axis=1)[faces]
    first, second = (corners[:, k, :2] - corners[:, 0, :2] for k in (1, 2))
    front_side = first[:, 0] * second[:, 1] - first[:, 1] * second[:, 0] < 0  # y points down
    lattice = np.array([(i, j, _LATTICE - i - j) for i in range(_LATTICE + 1) for j in range(_LATTICE + 1 - i)])
    samples = np.matmul(lattice / _LATTICE, corners[front_side]).reshape(-1, 3)
    low = flat.min(axis=0)
    size = np.floor((flat.max(axis=0) - low) / _CELL_MM).astype(np.int64) + 1

    def cell(points: NDArray[np.float64]) -> NDArray[np.int64]:
        at = np.floor((points[:, :2] - low) / _CELL_MM).astype(np.int64)
        return at[:, 0] * size[1] + at[:, 1]

    front = np.full(int(size.prod()), np.inf)
    np.minimum.at(front, cell(samples), samples[:, 2])
    return np.asarray(depth <= front[cell(flat)] + _BEHIND_MM)


def exposed_vertices(vertices: NDArray[np.float64], faces: NDArray[np.integer]) -> NDArray[np.bool_]:
    """Tell which vertices of a mesh in model space are seen from somewhere in front or at the sides.

    The insides of mouth, nostrils and lids are not: no scan shows them, and what lies nearest to them is not theirs.
    """
    seen = np.zeros(len(vertices), dtype=bool)
    normals = vertex_normals(vertices, faces)
    for yaw in np.deg2rad([-75.0, -40.0, 0.0, 40.0, 75.0]):
        for pitch in np.deg2rad([-25.0, 0.0, 25.0]):
            turn_y = np.array([[np.cos(yaw), 0, np.sin(yaw)], [0, 1, 0], [-np.sin(yaw), 0, np.cos(yaw)]])
            turn_x = np.array([[1, 0, 0], [0, np.cos(pitch), -np.sin(pitch)], [0, np.sin(pitch), np.cos(pitch)]])
            turn = np.diag([1.0, -1.0, -1.0]) @ turn_x @ turn_y
            facing = (normals @ turn.T)[:, 2] < -_FACING_COSINE
            seen |= facing & seen_from_camera(vertices @ turn.T, faces, None)
    return seen
