"""Flatten the skin: cut along the back, square border, convex combinations that even out the stretch.

Convex combinations with a convex border give no overlaps (Tutte); weights are divided by the neighbours' stretch until
it stops falling (Yoshizawa, Belyaev, Seidel 2004). The face counts more than the rest, so that it gets more texture.
"""

from __future__ import annotations

import numpy as np
from scipy import sparse
from scipy.sparse.linalg import splu

FACE_GAIN = 1.5


def flatten(
    points: np.ndarray, triangles: np.ndarray, seam: np.ndarray, important: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Return uv (U, 2) in the unit square and uv triangles; `seam` runs from the neck's rim to its tip inside.

    uv point i < V belongs to vertex i; the further ones are the seam's second copies, on the side x < 0.
    """
    V = len(points)
    copies = seam[:-1]
    duplicate = {int(v): V + k for k, v in enumerate(copies)}
    on_right = points[triangles].mean(axis=1)[:, 0] < 0
    flat = triangles.copy()
    for v, w in duplicate.items():
        flat[on_right] = np.where(triangles[on_right] == v, w, flat[on_right])
    where = np.concatenate([points, points[copies]])
    gain = np.concatenate([important, important[copies]])

    loops = _loops(flat)
    border = next(loop for loop in loops if int(seam[-1]) in loop)
    closed, n = [flat], len(where)
    for loop in loops:  # close eyes and mouth with a fan each
        if loop is not border:
            ring = np.array(loop)
            closed.append(np.stack([np.roll(ring, -1), ring, np.full(len(ring), n)], axis=1))
            where = np.concatenate([where, where[ring].mean(axis=0, keepdims=True)])
            gain = np.append(gain, 1.0)
            n += 1
    mesh = np.concatenate(closed)
    uv = _relax(where, mesh, _square(where, border, int(seam[-1])), gain)
    return uv[: V + len(copies)], flat


def flatten_disc(triangles: np.ndarray, n: int) -> np.ndarray:
    """Lay a disc-shaped mesh on the unit disc (in the unit square), border evenly round, no overlaps (Tutte)."""
    border = np.array(max(_loops(triangles), key=len))
    turn = 2 * np.pi * np.arange(len(border)) / len(border)
    target = np.full((n, 2), 0.5)
    target[border] = 0.5 + 0.5 * np.stack([np.cos(turn), np.sin(turn)], axis=1)
    held = np.zeros(n, bool)
    held[border] = True
    ends = np.concatenate([triangles[:, [0, 1]], triangles[:, [1, 2]], triangles[:, [2, 0]]])
    W = sparse.csr_matrix((np.ones(len(ends)), (ends[:, 0], ends[:, 1])), (n, n))
    W = ((W + W.T) > 0).astype(float)
    W = sparse.diags((~held) / np.asarray(W.sum(axis=1)).ravel()) @ W
    return splu((sparse.identity(n) - W).tocsc()).solve(target * held[:, None])


def _loops(triangles: np.ndarray) -> list[list[int]]:
    directed = np.concatenate([triangles[:, [0, 1]], triangles[:, [1, 2]], triangles[:, [2, 0]]])
    have = set(map(tuple, directed.tolist()))
    following = {a: b for a, b in have if (b, a) not in have}
    loops = []
    while following:
        start, v = next(iter(following.items()))
        loop = [start]
        del following[start]
        while v != start:
            loop.append(v)
            v = following.pop(v)
        loops.append(loop)
    return loops


def _square(points: np.ndarray, border: list[int], tip: int) -> dict[int, tuple[float, float]]:
    """Lay the border on the unit square by arc length, the tip in the middle of the upper side."""
    k = border.index(tip)
    order = border[k:] + border[:k]
    lengths = np.linalg.norm(np.diff(points[order + [tip]], axis=0), axis=1)
    s = 4.0 * np.concatenate([[0.0], np.cumsum(lengths)[:-1]]) / lengths.sum()
    corners = np.array([[0.5, 1], [0, 1], [0, 0], [1, 0], [1, 1], [0.5, 1]], float)  # counter-clockwise
    stops = np.array([0.0, 0.5, 1.5, 2.5, 3.5, 4.0])
    return {v: (np.interp(t, stops, corners[:, 0]), np.interp(t, stops, corners[:, 1])) for v, t in zip(order, s)}


def _relax(points: np.ndarray, triangles: np.ndarray, fixed: dict, gain: np.ndarray) -> np.ndarray:
    n = len(points)
    rows = np.concatenate([triangles[:, [0, 1]], triangles[:, [1, 2]], triangles[:, [2, 0]]])
    pairs = np.unique(np.sort(rows, axis=1), axis=0)
    i, j = np.concatenate([pairs, pairs[:, ::-1]]).T
    weight = np.ones(len(i))
    held = np.zeros(n, bool)
    held[list(fixed)] = True
    target = np.zeros((n, 2))
    target[list(fixed)] = list(fixed.values())
    best, best_value = None, np.inf
    for _ in range(30):
        W = sparse.csr_matrix((weight, (i, j)), (n, n))
        W = sparse.diags(1 / np.asarray(W.sum(axis=1)).ravel()) @ W
        A = sparse.identity(n) - sparse.diags((~held).astype(float)) @ W
        uv = splu(A.tocsc()).solve(target * held[:, None])
        sigma, value = _stretch(points, triangles, uv)
        if value > best_value:
            break
        best, best_value = uv, value
        weight = weight / (sigma * gain)[j] ** 0.7
    return best


def _stretch(points: np.ndarray, triangles: np.ndarray, uv: np.ndarray) -> tuple[np.ndarray, float]:
    """Root-mean-square stretch of the map from the plane to the surface, per vertex and in all (Sander 2001)."""
    a, b, c = (points[triangles[:, k]] for k in range(3))
    p, q, r = (uv[triangles[:, k]] for k in range(3))
    area2 = (q - p)[:, 0] * (r - p)[:, 1] - (q - p)[:, 1] * (r - p)[:, 0]
    area2 = np.maximum(area2, 1e-14)[:, None]
    ds = (a * (q - r)[:, 1:] + b * (r - p)[:, 1:] + c * (p - q)[:, 1:]) / area2
    dt = (a * (r - q)[:, :1] + b * (p - r)[:, :1] + c * (q - p)[:, :1]) / area2
    squared = 0.5 * ((ds**2).sum(axis=1) + (dt**2).sum(axis=1))
    area = 0.5 * np.linalg.norm(np.cross(b - a, c - a), axis=1)
    top, bottom = np.zeros(len(points)), np.zeros(len(points))
    for k in range(3):
        np.add.at(top, triangles[:, k], area * squared)
        np.add.at(bottom, triangles[:, k], area)
    sigma = np.sqrt(top / np.maximum(bottom, 1e-12))
    return sigma / np.median(sigma), float(np.sqrt((area * squared).sum() / area.sum()))
