"""The skin that a camera in front sees, as points with normals that move with the blendshapes."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numba import njit
from numpy.typing import NDArray

from facewright.landmarks.contour import face_region
from facewright.mesh.normals import vertex_normals
from facewright.models.bilinear import BilinearModel
from facewright.models.blendshapes import BlendshapeRig

#: Points are at least so far apart, where the face has little detail and where it has much, millimetres.
_APART_MM, _APART_DETAILED_MM = 3.0, 1.5
#: Masks of what has much detail, by the start of their names; and of what is hidden when lips or lids meet.
_DETAILED, _HIDDEN = ("lips", "eyelid", "lash", "brow", "nose", "chin"), ("lip_contact", "lid_contact")
#: Points whose normal turns farther away from the front (cosine), or that lie so far behind the skin, are left out.
_FACING, _BEHIND_MM = 0.15, 3.0
#: Share of each shape by which normals are differentiated.
_STEP = 0.25


@dataclass(frozen=True, eq=False)
class FaceSurface:
    """A person's N points of skin.

    Parameters
    ----------
    rest : ndarray of shape (N, 3), float64, millimetres
        At rest, in model space.
    normals : ndarray of shape (N, 3), float64
        At rest, of unit length.
    deltas : ndarray of shape (N, 3, B), float32, millimetres
        Displacement by each blendshape.
    normal_deltas : ndarray of shape (N, 3, B), float32
        Change of the normal by each blendshape.
    """

    rest: NDArray[np.float64]
    normals: NDArray[np.float64]
    deltas: NDArray[np.float32]
    normal_deltas: NDArray[np.float32]

    def at(self, beta: NDArray[np.float64]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Return points and unit normals (N, 3) under coefficients (B,)."""
        small = beta.astype(np.float32)
        n = len(self.rest)
        points = self.rest + (self.deltas.reshape(3 * n, -1) @ small).reshape(n, 3)
        normals = self.normals + (self.normal_deltas.reshape(3 * n, -1) @ small).reshape(n, 3)
        return points, normals / np.linalg.norm(normals, axis=1, keepdims=True)

    def displaced(self, beta: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return how far coefficients (B,) move each point, (N,), millimetres."""
        moved = self.deltas.reshape(len(self.rest) * 3, -1) @ beta.astype(np.float32)
        return np.linalg.norm(moved.reshape(-1, 3), axis=1).astype(np.float64)


class SurfacePoints:
    """Which vertices of a model's mesh are looked at.

    Parameters
    ----------
    model : BilinearModel
        Its mean face says what is seen from in front.

    Raises
    ------
    TopologyError
        If the mesh has no face part or no jaw line.
    """

    def __init__(self, model: BilinearModel) -> None:
        topology, mean = model.topology, np.asarray(model.mean_face, dtype=np.float64)
        start, stop = topology.parts["face"]
        skin = topology.faces[((topology.faces >= start) & (topology.faces < stop)).all(axis=1)]
        ids = face_region(topology, mean)
        ids = ids[vertex_normals(mean, topology.faces)[ids, 2] > _FACING]
        hidden = [np.asarray(mask) for name, mask in topology.masks.items() if name.startswith(_HIDDEN)]
        ids = np.setdiff1d(ids, np.concatenate(hidden)) if hidden else np.unique(ids)
        ids = ids[~_covered(np.ascontiguousarray(mean[ids]), np.ascontiguousarray(mean[skin]), _BEHIND_MM)]
        apart = np.full(model.n_vertices, _APART_MM)
        for name, mask in topology.masks.items():
            if name.startswith(_DETAILED):
                apart[mask] = _APART_DETAILED_MM
        # in a fixed random order, so that no direction of the mesh is preferred
        order = np.random.default_rng(0).permutation(ids)
        self.vertices = np.sort(order[_thinned(np.ascontiguousarray(mean[order]), apart[order])]).astype(np.int32)
        touching = topology.faces[np.isin(topology.faces, self.vertices).any(axis=1)]
        self._around, local = np.unique(touching, return_inverse=True)
        self._faces = local.reshape(-1, 3)
        self._rows = np.searchsorted(self._around, self.vertices)

    def of(self, rig: BlendshapeRig) -> FaceSurface:
        """Return a person's points."""
        neutral = np.asarray(rig.neutral[self._around], dtype=np.float64)
        deltas = np.asarray(rig.deltas[:, self._around], dtype=np.float64)
        rest = vertex_normals(neutral, self._faces)[self._rows]
        turned = [(vertex_normals(neutral + _STEP * d, self._faces)[self._rows] - rest) / _STEP for d in deltas]
        return FaceSurface(
            neutral[self._rows],
            rest,
            np.ascontiguousarray(np.moveaxis(deltas[:, self._rows], 0, 2), dtype=np.float32),
            np.ascontiguousarray(np.moveaxis(np.array(turned), 0, 2), dtype=np.float32),
        )


@njit(cache=True)
def _covered(points, triangles, behind):  # type: ignore[no-untyped-def]
    """Tell which points have a triangle more than `behind` in front of them, seen along z."""
    hidden = np.zeros(len(points), np.bool_)
    for t in range(len(triangles)):
        a, b, c = triangles[t, 0], triangles[t, 1], triangles[t, 2]
        low_x, high_x = min(a[0], b[0], c[0]), max(a[0], b[0], c[0])
        low_y, high_y = min(a[1], b[1], c[1]), max(a[1], b[1], c[1])
        area = (b[0] - a[0]) * (c[1] - a[1]) - (b[1] - a[1]) * (c[0] - a[0])
        if area == 0.0:
            continue
        for i in range(len(points)):
            x, y = points[i, 0], points[i, 1]
            if x < low_x or x > high_x or y < low_y or y > high_y:
                continue
            v = ((x - a[0]) * (c[1] - a[1]) - (y - a[1]) * (c[0] - a[0])) / area
            w = ((b[0] - a[0]) * (y - a[1]) - (b[1] - a[1]) * (x - a[0])) / area
            if v >= 0.0 and w >= 0.0 and v + w <= 1.0:
                z = a[2] + v * (b[2] - a[2]) + w * (c[2] - a[2])
                hidden[i] |= z > points[i, 2] + behind
    return hidden


@njit(cache=True)
def _thinned(points, apart):  # type: ignore[no-untyped-def]
    """Choose points, the first ones first, none nearer to another than the smaller of their two distances."""
    n = len(points)
    kept = np.empty(n, np.int64)
    count = 0
    for i in range(n):
        free = True
        for k in range(count):
            j = kept[k]
            reach = min(apart[i], apart[j])
            dx, dy, dz = points[i, 0] - points[j, 0], points[i, 1] - points[j, 1], points[i, 2] - points[j, 2]
            if dx * dx + dy * dy + dz * dz < reach * reach:
                free = False
                break
        if free:
            kept[count] = i
            count += 1
    return kept[:count]
