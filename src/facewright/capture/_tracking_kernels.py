"""Numba kernels of frame-to-model tracking: normal equations, residuals, and what of a frame belongs to the head."""

from __future__ import annotations

import numpy as np
from numba import njit


@njit(cache=True, nogil=True, error_model="numpy")
def _match(p, R, t, model_depth, model_camera, Rm, tm, point, seen):  # type: ignore[no-untyped-def]
    """Move a frame's point to the volume's frame (`point`), look the model up on its ray; return row, column or -1.

    (R, t): volume_from_frame; (Rm, tm): model camera_from_volume; `seen`: the point in the model's camera.
    """
    for k in range(3):
        point[k] = R[k, 0] * p[0] + R[k, 1] * p[1] + R[k, 2] * p[2] + t[k]
    for k in range(3):
        seen[k] = Rm[k, 0] * point[0] + Rm[k, 1] * point[1] + Rm[k, 2] * point[2] + tm[k]
    if seen[2] <= 1.0:
        return -1, -1
    u = model_camera[0] * seen[0] / seen[2] + model_camera[2]
    v = model_camera[1] * seen[1] / seen[2] + model_camera[3]
    if not (-0.5 < u < model_depth.shape[1] - 0.5 and -0.5 < v < model_depth.shape[0] - 0.5):
        return -1, -1
    row, column = int(v + 0.5), int(u + 0.5)
    if model_depth[row, column] <= 0.0:
        return -1, -1
    return row, column


@njit(cache=True, nogil=True, error_model="numpy")
def normal_equations(  # type: ignore[no-untyped-def]
    points, R, t, model_depth, normals, model_camera, Rm, tm, centre, step, gate, scale, H, g
):
    """Sum the point-to-plane normal equations of a small turn about `centre` and shift of a frame's points (N, 3).

    Every `step`-th point; pairs further apart than `gate` mm are left out, residuals are weighted by Tukey's function
    of `scale` mm. Returns pairs within reach, the sum of their weights, and the weighted squares.
    """
    H[:] = 0.0
    g[:] = 0.0
    point, seen, row_of = np.empty(3), np.empty(3), np.empty(6)
    pairs, total, squares = 0, 0.0, 0.0
    for p in range(0, points.shape[0], step):
        i, j = _match(points[p], R, t, model_depth, model_camera, Rm, tm, point, seen)
        if i < 0:
            continue
        z = model_depth[i, j]
        dx = seen[0] - (j - model_camera[2]) / model_camera[0] * z
        dy = seen[1] - (i - model_camera[3]) / model_camera[1] * z
        dz = seen[2] - z
        if dx * dx + dy * dy + dz * dz > gate * gate:
            continue
        n0, n1, n2 = normals[i, j, 0], normals[i, j, 1], normals[i, j, 2]
        # the offset turned to the volume's frame (Rm transposed), on the normal
        r = (
            n0 * (Rm[0, 0] * dx + Rm[1, 0] * dy + Rm[2, 0] * dz)
            + n1 * (Rm[0, 1] * dx + Rm[1, 1] * dy + Rm[2, 1] * dz)
            + n2 * (Rm[0, 2] * dx + Rm[1, 2] * dy + Rm[2, 2] * dz)
        )
        pairs += 1
        if abs(r) >= scale:
            continue
        w = (1.0 - (r / scale) ** 2) ** 2
        a0, a1, a2 = point[0] - centre[0], point[1] - centre[1], point[2] - centre[2]
        row_of[0] = a1 * n2 - a2 * n1
        row_of[1] = a2 * n0 - a0 * n2
        row_of[2] = a0 * n1 - a1 * n0
        row_of[3], row_of[4], row_of[5] = n0, n1, n2
        for k in range(6):
            g[k] += w * row_of[k] * r
            for m in range(k, 6):
                H[k, m] += w * row_of[k] * row_of[m]
        total += w
        squares += w * r * r
    for k in range(6):
        for m in range(k):
            H[k, m] = H[m, k]
    return pairs, total, squares


@njit(cache=True, nogil=True, error_model="numpy")
def align_points(  # type: ignore[no-untyped-def]
    points, R, t, model_depth, normals, model_camera, Rm, tm, centre, levels, small_turn, small_shift
):
    """Overwrite (R, t) by point-to-plane ICP; return the weight share of the last level's points, and their rms.

    levels: rows of step, gate, scale, most steps. Here and not in NumPy, whose solver waits for its threads longer
    than all of this takes.
    """
    H, g, turn = np.zeros((6, 6)), np.zeros(6), np.empty((3, 3))
    total, squares, step = 0.0, 0.0, 1
    for level in range(levels.shape[0]):
        step = int(levels[level, 0])
        for _ in range(int(levels[level, 3])):
            pairs, total, squares = normal_equations(
                points, R, t, model_depth, normals, model_camera, Rm, tm, centre, step,
                levels[level, 1], levels[level, 2], H, g,
            )  # fmt: skip
            if pairs < 50:
                return 0.0, np.inf
            if not _solve(H, g):
                return 0.0, np.inf
            _rotation(-g[0], -g[1], -g[2], turn)
            moved = np.empty(3)
            for k in range(3):
                moved[k] = centre[k] - g[3 + k]
                for m in range(3):
                    moved[k] += turn[k, m] * (t[m] - centre[m])
            new = np.zeros((3, 3))
            for k in range(3):
                t[k] = moved[k]
                for m in range(3):
                    for n in range(3):
                        new[k, m] += turn[k, n] * R[n, m]
            R[:] = new
            if np.abs(g[:3]).max() < small_turn and np.abs(g[3:]).max() < small_shift:
                break
    used = (points.shape[0] + step - 1) // step
    return total / max(used, 1), np.sqrt(squares / max(total, 1e-12))


@njit(cache=True, nogil=True, error_model="numpy")
def _solve(H, g):  # type: ignore[no-untyped-def]
    """Overwrite g by the solution of H x = g (6, 6), by Cholesky's factor in place of H; False where it is singular."""
    for k in range(6):
        # the smallest ridge that keeps a flat or round patch from sliding without bound
        H[k, k] *= 1.0 + 1e-6
    for k in range(6):
        for m in range(k):
            for n in range(m):
                H[k, m] -= H[k, n] * H[m, n]
            H[k, m] /= H[m, m]
        for n in range(k):
            H[k, k] -= H[k, n] ** 2
        if not H[k, k] > 1e-12:
            return False
        H[k, k] = np.sqrt(H[k, k])
    for k in range(6):
        for n in range(k):
            g[k] -= H[k, n] * g[n]
        g[k] /= H[k, k]
    for k in range(5, -1, -1):
        for n in range(k + 1, 6):
            g[k] -= H[n, k] * g[n]
        g[k] /= H[k, k]
    return True


@njit(cache=True, nogil=True, error_model="numpy")
def _rotation(x, y, z, out):  # type: ignore[no-untyped-def]
    """Write the matrix of a rotation vector (Rodrigues' formula)."""
    square = x * x + y * y + z * z
    angle = np.sqrt(square)
    a = 1.0 - square / 6.0 if angle < 1e-4 else np.sin(angle) / angle
    b = 0.5 - square / 24.0 if angle < 1e-4 else (1.0 - np.cos(angle)) / square
    out[0, 0], out[0, 1], out[0, 2] = 1.0 - b * (y * y + z * z), b * x * y - a * z, b * x * z + a * y
    out[1, 0], out[1, 1], out[1, 2] = b * x * y + a * z, 1.0 - b * (x * x + z * z), b * y * z - a * x
    out[2, 0], out[2, 1], out[2, 2] = b * x * z - a * y, b * y * z + a * x, 1.0 - b * (x * x + y * y)


@njit(cache=True, nogil=True, error_model="numpy")
def axial_residuals(points, R, t, model_depth, model_camera, Rm, tm, gate, out):  # type: ignore[no-untyped-def]
    """Write each point's depth minus the model's along the model camera's axis; NaN where there is no pair."""
    point, seen = np.empty(3), np.empty(3)
    for p in range(points.shape[0]):
        out[p] = np.nan
        i, j = _match(points[p], R, t, model_depth, model_camera, Rm, tm, point, seen)
        if i >= 0 and abs(seen[2] - model_depth[i, j]) <= gate:
            out[p] = seen[2] - model_depth[i, j]


@njit(cache=True, nogil=True, error_model="numpy")
def keep_region(depth, camera, R, t, region_camera, box, near, far, edge, out):  # type: ignore[no-untyped-def]
    """Write the depths that lie in a frustum of the volume's frame and not at an edge of depth; 0 elsewhere.

    box: left, top, right, bottom in the picture of the region's camera, whose frame is the volume's.
    """
    height, width = depth.shape
    for v in range(height):
        for u in range(width):
            out[v, u] = 0.0
            z = depth[v, u]
            if z <= 0.0:
                continue
            x, y = (u - camera[2]) / camera[0] * z, (v - camera[3]) / camera[1] * z
            p0 = R[0, 0] * x + R[0, 1] * y + R[0, 2] * z + t[0]
            p1 = R[1, 0] * x + R[1, 1] * y + R[1, 2] * z + t[1]
            p2 = R[2, 0] * x + R[2, 1] * y + R[2, 2] * z + t[2]
            if p2 < near or p2 > far:
                continue
            column = region_camera[0] * p0 / p2 + region_camera[2]
            row = region_camera[1] * p1 / p2 + region_camera[3]
            if column < box[0] or row < box[1] or column > box[2] or row > box[3]:
                continue
            torn = False
            for a in range(max(v - 1, 0), min(v + 2, height)):
                for b in range(max(u - 1, 0), min(u + 2, width)):
                    # a pixel beside a nearer surface may hold a mixture of both
                    torn = torn or (depth[a, b] > 0.0 and abs(depth[a, b] - z) > edge)
            if not torn:
                out[v, u] = z


@njit(cache=True, nogil=True, error_model="numpy")
def smooth_depth(depth, spatial, reach_mm, first, last, out):  # type: ignore[no-untyped-def]
    """Smooth rows [first, last) of a depth map but not across steps: a bilateral filter with Tukey weights of depth.

    spatial (2 r + 1, 2 r + 1): weight of each neighbour by its place; neighbours off by `reach_mm` have none.
    """
    height, width = depth.shape
    r = spatial.shape[0] // 2
    scale = 1.0 / (reach_mm * reach_mm)
    for v in range(first, last):
        for u in range(width):
            z = depth[v, u]
            out[v, u] = 0.0
            if z <= 0.0:
                continue
            total, weights = 0.0, 0.0
            for a in range(max(v - r, 0), min(v + r + 1, height)):
                for b in range(max(u - r, 0), min(u + r + 1, width)):
                    d = depth[a, b]
                    off = 1.0 - (d - z) * (d - z) * scale
                    if d > 0.0 and off > 0.0:
                        w = spatial[a - v + r, b - u + r] * off * off
                        total += w * (d - z)
                        weights += w
            out[v, u] = z + total / weights


@njit(cache=True, nogil=True, error_model="numpy")
def halve_depth(depth, step, out):  # type: ignore[no-untyped-def]
    """Write the mean of each 2 x 2 pixels' depths that are within `step` mm of the nearest of them; 0 for none."""
    for v in range(out.shape[0]):
        for u in range(out.shape[1]):
            nearest = 0.0
            for a in range(2):
                for b in range(2):
                    z = depth[2 * v + a, 2 * u + b]
                    if z > 0.0 and (nearest == 0.0 or z < nearest):
                        nearest = z
            total, n = 0.0, 0
            for a in range(2):
                for b in range(2):
                    z = depth[2 * v + a, 2 * u + b]
                    if z > 0.0 and z - nearest <= step:
                        total += z - nearest
                        n += 1
            out[v, u] = nearest + total / n if n else 0.0
