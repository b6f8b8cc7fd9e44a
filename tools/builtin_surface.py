"""Points on the measured model's mean surface: by texture coordinates, by ray, by closest point."""

from __future__ import annotations

import numpy as np
from scipy import sparse
from scipy.spatial import cKDTree


def triangulate(quads: np.ndarray) -> np.ndarray:
    """Split quads (-1 pads a triangle) into triangles."""
    whole = quads[:, 3] >= 0
    return np.concatenate([quads[:, :3], quads[whole][:, [0, 2, 3]]])


class MeasuredSurface:
    """The skin of the measured model; every query answers with (triangle, barycentric weights)."""

    def __init__(self, data, n_skin: int = 11248):
        self.vertices = data["vertices"].astype(float)
        on_skin = (data["faces"][:, :3] < n_skin).all(axis=1)
        self.triangles = triangulate(data["faces"][on_skin])
        corners = triangulate(data["uv_faces"][on_skin])
        uv = data["uv"].astype(float)
        plane = np.stack([uv[:, 0] * 1000, (1 - uv[:, 1]) * 1000], axis=1)[corners]  # (F, 3, 2)
        sheet_b = plane[:, :, 0].min(axis=1) > 1000 - 1e-6
        self.sheets = {}
        for name, rows, shift in (("A", np.flatnonzero(~sheet_b), 0.0), ("B", np.flatnonzero(sheet_b), 1000.0)):
            flat = plane[rows] - [shift, 0.0]
            self.sheets[name] = (rows, flat, cKDTree(flat.mean(axis=1)))
        corner_points = self.vertices[self.triangles]
        self.centres = cKDTree(corner_points.mean(axis=1))
        normal = np.cross(corner_points[:, 1] - corner_points[:, 0], corner_points[:, 2] - corner_points[:, 0])
        self.normals = normal / np.linalg.norm(normal, axis=1, keepdims=True)

    def at(self, triangle: np.ndarray, weights: np.ndarray) -> np.ndarray:
        return np.einsum("nk,nkc->nc", weights, self.vertices[self.triangles[triangle]])

    def matrix(self, triangle: np.ndarray, weights: np.ndarray) -> sparse.csr_matrix:
        """Rows that interpolate any field of the measured model's vertices at the given points."""
        rows = np.repeat(np.arange(len(triangle)), 3)
        shape = (len(triangle), len(self.vertices))
        return sparse.csr_matrix((weights.ravel(), (rows, self.triangles[triangle].ravel())), shape)

    def by_uv(self, sheet: str, points: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Locate texture points; also returns how far (negative) a point is outside its triangle."""
        rows, flat, tree = self.sheets[sheet]
        _, near = tree.query(points, k=40)
        a, b, c = (flat[near][:, :, k] for k in range(3))
        area = _cross(b - a, c - a)
        p = points[:, None] - a
        w1, w2 = _cross(p, c - a) / area, _cross(b - a, p) / area
        weights = np.stack([1 - w1 - w2, w1, w2], axis=-1)
        best = weights.min(axis=-1).argmax(axis=1)
        chosen = weights[np.arange(len(points)), best]
        outside = chosen.min(axis=1)
        chosen = np.clip(chosen, 0, None)
        chosen /= chosen.sum(axis=1, keepdims=True)
        return rows[near[np.arange(len(points)), best]], chosen, outside

    def by_ray(self, origin, direction) -> np.ndarray:
        """Nearest point that a ray from inside meets."""
        a, b, c = (self.vertices[self.triangles[:, k]] for k in range(3))
        direction = np.asarray(direction, float)
        p = np.cross(direction, c - a)
        det = np.einsum("nk,nk->n", b - a, p)
        det = np.where(np.abs(det) < 1e-12, np.inf, det)
        t = np.asarray(origin, float) - a
        u = np.einsum("nk,nk->n", t, p) / det
        q = np.cross(t, b - a)
        v = q @ direction / det
        s = np.einsum("nk,nk->n", c - a, q) / det
        hit = (u >= -1e-9) & (v >= -1e-9) & (u + v <= 1 + 1e-9) & (s > 1.0)
        return np.asarray(origin) + direction * s[hit].min()

    def closest(self, points: np.ndarray, normals: np.ndarray | None = None) -> tuple[np.ndarray, np.ndarray]:
        """Closest point among nearby triangles whose normal agrees (cosine above 0.2) with `normals`."""
        _, near = self.centres.query(points, k=80)
        corner = self.vertices[self.triangles[near]]
        weights = _closest_weights(points[:, None], corner)
        distance = np.linalg.norm(np.einsum("nmk,nmkc->nmc", weights, corner) - points[:, None], axis=-1)
        if normals is not None:
            agree = np.einsum("nmc,nc->nm", self.normals[near], normals)
            distance = distance + np.where(agree < 0.2, 1e3, 0.0)
        best = distance.argmin(axis=1)
        row = np.arange(len(points))
        return near[row, best], weights[row, best]


def _cross(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    return a[..., 0] * b[..., 1] - a[..., 1] * b[..., 0]


def _closest_weights(p: np.ndarray, corner: np.ndarray) -> np.ndarray:
    """Barycentric weights of the closest point of each triangle: plane foot point, else the best edge."""
    a, b, c = corner[..., 0, :], corner[..., 1, :], corner[..., 2, :]
    ab, ac, ap = b - a, c - a, p - a
    d00, d01, d11 = (ab * ab).sum(-1), (ab * ac).sum(-1), (ac * ac).sum(-1)
    d20, d21 = (ap * ab).sum(-1), (ap * ac).sum(-1)
    det = np.maximum(d00 * d11 - d01 * d01, 1e-18)
    v, w = (d11 * d20 - d01 * d21) / det, (d00 * d21 - d01 * d20) / det
    best = np.stack([1 - v - w, v, w], axis=-1)
    inside = (best >= 0).all(axis=-1)
    options, distances = [], []
    for i, j in ((0, 1), (1, 2), (2, 0)):
        start, edge = corner[..., i, :], corner[..., j, :] - corner[..., i, :]
        t = np.clip(((p - start) * edge).sum(-1) / np.maximum((edge * edge).sum(-1), 1e-18), 0, 1)
        weight = np.zeros((*t.shape, 3))
        weight[..., i], weight[..., j] = 1 - t, t
        options.append(weight)
        distances.append(np.linalg.norm(start + t[..., None] * edge - p, axis=-1))
    pick = np.stack(distances).argmin(axis=0)
    on_edge = np.take_along_axis(np.stack(options), pick[None, ..., None], axis=0)[0]
    return np.where(inside[..., None], best, on_edge)
