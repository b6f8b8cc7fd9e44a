"""Numba kernels of frame-to-model tracking: normal equations, residuals, and what of a frame belongs to the head."""

from __future__ import annotations

import numpy as np
from numba import njit


@njit(cache=True, nogil=True)
def _match(depth, v, u, camera, R, t, model_depth, model_camera, Rm, tm, point, seen):  # type: ignore[no-untyped-def]
    """Move pixel (v, u) to the volume's frame (`point`), look the model up along its ray; return row, column or -1.

    (R, t): volume_from_frame; (Rm, tm): model camera_from_volume; `seen`: the point in the model's camera.
    """
    z = depth[v, u]
    x, y = (u - camera[2]) / camera[0] * z, (v - camera[3]) / camera[1] * z
    for k in range(3):
        point[k] = R[k, 0] * x + R[k, 1] * y + R[k, 2] * z + t[k]
    for k in range(3):
        seen[k] = Rm[k, 0] * point[0] + Rm[k, 1] * point[1] + Rm[k, 2] * point[2] + tm[k]
    if seen[2] <= 0.0:
        return -1, -1
    column = int(np.floor(model_camera[0] * seen[0] / seen[2] + model_camera[2] + 0.5))
    row = int(np.floor(model_camera[1] * seen[1] / seen[2] + model_camera[3] + 0.5))
    if column < 0 or row < 0 or row >= model_depth.shape[0] or column >= model_depth.shape[1]:
        return -1, -1
    if model_depth[row, column] <= 0.0:
        return -1, -1
    return row, column


@njit(cache=True, nogil=True)
def normal_equations(  # type: ignore[no-untyped-def]
    depth, camera, R, t, model_depth, normals, model_camera, Rm, tm, centre, step, gate, scale, H, g
):
    """Sum the point-to-plane normal equations of a small turn about `centre` and shift of the frame.

    Pixels on a grid of `step`; pairs further apart than `gate` mm are left out, residuals are weighted by Tukey's
    function of `scale` mm. Returns pairs within reach, the sum of their weights, and the weighted squares.
    """
    H[:] = 0.0
    g[:] = 0.0
    point, seen, row_of = np.empty(3), np.empty(3), np.empty(6)
    pairs, total, squares = 0, 0.0, 0.0
    for v in range(0, depth.shape[0], step):
        for u in range(0, depth.shape[1], step):
            if depth[v, u] <= 0.0:
                continue
            i, j = _match(depth, v, u, camera, R, t, model_depth, model_camera, Rm, tm, point, seen)
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


@njit(cache=True, nogil=True)
def axial_residuals(depth, camera, R, t, model_depth, model_camera, Rm, tm, gate, out):  # type: ignore[no-untyped-def]
    """Write each pixel's depth minus the model's along the model camera's axis; NaN where there is no pair."""
    point, seen = np.empty(3), np.empty(3)
    for v in range(depth.shape[0]):
        for u in range(depth.shape[1]):
            out[v, u] = np.nan
            if depth[v, u] <= 0.0:
                continue
            i, j = _match(depth, v, u, camera, R, t, model_depth, model_camera, Rm, tm, point, seen)
            if i >= 0 and abs(seen[2] - model_depth[i, j]) <= gate:
                out[v, u] = seen[2] - model_depth[i, j]


@njit(cache=True, nogil=True)
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


@njit(cache=True, nogil=True)
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
