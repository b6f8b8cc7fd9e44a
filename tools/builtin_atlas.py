"""Flatten the skin: cut along the back, square border, convex combinations that even out the stretch.

Convex combinations with a convex border give no overlaps (Tutte); weights are divided by the neighbours' stretch until
it stops falling (Yoshizawa, Belyaev, Seidel 2004). The face counts more than the rest, so that it gets more texture.
"""

from __future__ import annotations

import numpy as np
from scipy import sparse
from scipy.sparse.linalg import splu

FACE_GAIN = 2.0
ROUNDS = 12


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
    flat = np.stack([np.interp(s, stops, corners[:, 0]), np.interp(s, stops, corners[:, 1])], axis=1)
    # strictly convex: sides bulge a little, or triangles with three corners on a side would vanish
    centred = 2.0 * flat - 1.0
    bulge = 1.0 - np.abs(centred[:, ::-1]) ** 2
    side = np.abs(centred) > 1.0 - 1e-9
    flat = 0.5 + 0.485 * centred + 0.015 * np.sign(centred) * side * bulge
    return dict(zip(order, map(tuple, flat)))


def _relax(points: np.ndarray, triangles: np.ndarray, fixed: dict, gain: np.ndarray) -> np.ndarray:
    n = len(points)
    i, j, weight = _mean_value(points, triangles)
    held = np.zeros(n, bool)
    held[list(fixed)] = True
    target = np.zeros((n, 2))
    target[list(fixed)] = list(fixed.values())
    both = sparse.csr_matrix((np.ones(len(i)), (i, j)), (n, n)) + sparse.identity(n)
    blur = sparse.diags(1 / np.asarray(both.sum(axis=1)).ravel()) @ both
    for _ in range(20):
        gain = blur @ gain
    best, best_value = None, np.inf
    for _ in range(ROUNDS):
        W = sparse.csr_matrix((weight, (i, j)), (n, n))
        W = sparse.diags(1 / np.asarray(W.sum(axis=1)).ravel()) @ W
        A = sparse.identity(n) - sparse.diags((~held).astype(float)) @ W
        uv = splu(A.tocsc()).solve(target * held[:, None])
        sigma, value = _stretch(points, triangles, uv, gain)
        if value > best_value:
            break
        best, best_value = uv, value
        wanted = np.log(np.clip(sigma * gain, 0.3, 3.0))
        for _ in range(4):  # even out slowly and smoothly, so that lines stay lines
            wanted = blur @ wanted
        weight = weight / np.exp(0.6 * wanted)[j]
    return best


def _mean_value(points: np.ndarray, triangles: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return mean value weights (Floater 2003) of all directed edges: positive, nearly angle-preserving."""
    i, j, w = [], [], []
    for k in range(3):
        a, b, c = triangles[:, k], triangles[:, (k + 1) % 3], triangles[:, (k + 2) % 3]
        u, v = points[b] - points[a], points[c] - points[a]
        lu, lv = np.linalg.norm(u, axis=1), np.linalg.norm(v, axis=1)
        half = np.tan(0.5 * np.arccos(np.clip((u * v).sum(axis=1) / np.maximum(lu * lv, 1e-12), -1, 0.99999)))
        i += [a, a]
        j += [b, c]
        w += [half / np.maximum(lu, 1e-6), half / np.maximum(lv, 1e-6)]
    n = len(points)
    matrix = sparse.coo_matrix((np.concatenate(w), (np.concatenate(i), np.concatenate(j))), (n, n)).tocsr().tocoo()
    return matrix.row, matrix.col, matrix.data


def _stretch(points: np.ndarray, triangles: np.ndarray, uv: np.ndarray, gain: np.ndarray) -> tuple[np.ndarray, float]:
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
    return sigma / np.median(sigma), float(np.sqrt((gain**2 * top).sum() / (gain**2 * bottom).sum()))
