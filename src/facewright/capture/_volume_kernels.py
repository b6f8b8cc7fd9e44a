"""Numba kernels of the truncated signed distance volume: fusing a depth map, and casting rays into it."""

from __future__ import annotations

import numpy as np
from numba import njit

#: Voxels along a block's edge.
BLOCK = 8


@njit(cache=True, nogil=True)
def mark_blocks(depth, camera, R, t, origin, voxel, truncation, marked):  # type: ignore[no-untyped-def]
    """Mark the blocks (Z, Y, X) that a depth map's surface crosses within the truncation.

    camera: fx, fy, cx, cy of the map; (R, t): volume_from_camera.
    """
    height, width = depth.shape
    size = voxel * BLOCK
    pad = 2.0 * voxel
    nz, ny, nx = marked.shape
    for v in range(0, height, 2):
        for u in range(0, width, 2):
            z = depth[v, u]
            if z <= 0.0:
                continue
            for k in range(-2, 3):
                d = z + 0.5 * k * truncation
                x, y = (u - camera[2]) / camera[0] * d, (v - camera[3]) / camera[1] * d
                p_x = R[0, 0] * x + R[0, 1] * y + R[0, 2] * d + t[0] - origin[0]
                p_y = R[1, 0] * x + R[1, 1] * y + R[1, 2] * d + t[1] - origin[1]
                p_z = R[2, 0] * x + R[2, 1] * y + R[2, 2] * d + t[2] - origin[2]
                # with a margin: interpolation needs the next voxel, which may lie in the next block
                for m in range(max(int(np.floor((p_z - pad) / size)), 0), min(int((p_z + pad) / size) + 1, nz)):
                    for j in range(max(int(np.floor((p_y - pad) / size)), 0), min(int((p_y + pad) / size) + 1, ny)):
                        for i in range(max(int(np.floor((p_x - pad) / size)), 0), min(int((p_x + pad) / size) + 1, nx)):
                            marked[m, j, i] = True


@njit(cache=True, nogil=True)
def depth_at(depth, u, v, step):  # type: ignore[no-untyped-def]
    """Depth between pixels: bilinear, or the nearest pixel's where a neighbour is missing or off by more than step."""
    height, width = depth.shape
    iu, iv = int(np.floor(u + 0.5)), int(np.floor(v + 0.5))
    if iu < 0 or iv < 0 or iu >= width or iv >= height:
        return 0.0
    nearest = depth[iv, iu]
    u0, v0 = int(np.floor(u)), int(np.floor(v))
    if nearest <= 0.0 or u0 < 0 or v0 < 0 or u0 + 1 >= width or v0 + 1 >= height:
        return nearest
    a, b, c, d = depth[v0, u0], depth[v0, u0 + 1], depth[v0 + 1, u0], depth[v0 + 1, u0 + 1]
    if min(min(a, b), min(c, d)) < nearest - step or max(max(a, b), max(c, d)) > nearest + step:
        return nearest
    fu, fv = u - u0, v - v0
    return (1 - fv) * ((1 - fu) * a + fu * b) + fv * ((1 - fu) * c + fu * d)


@njit(cache=True, nogil=True)
def integrate_blocks(  # type: ignore[no-untyped-def]
    tsdf, weight, blocks, first, last, depth, share, camera, R, t, origin, voxel, truncation, step
):
    """Take a depth map into the voxels of blocks[first:last] (rows of m, j, i): a running weighted mean.

    camera: fx, fy, cx, cy; (R, t): camera_from_volume; share (H, W): each pixel's weight. tsdf is in truncations.
    """
    for k in range(first, last):
        for c in range(BLOCK):
            z_v = origin[2] + voxel * (blocks[k, 0] * BLOCK + c)
            for b in range(BLOCK):
                y_v = origin[1] + voxel * (blocks[k, 1] * BLOCK + b)
                x_v = origin[0] + voxel * (blocks[k, 2] * BLOCK)
                x = R[0, 0] * x_v + R[0, 1] * y_v + R[0, 2] * z_v + t[0]
                y = R[1, 0] * x_v + R[1, 1] * y_v + R[1, 2] * z_v + t[1]
                z = R[2, 0] * x_v + R[2, 1] * y_v + R[2, 2] * z_v + t[2]
                for a in range(BLOCK):
                    if z > 0.0:
                        u, v = camera[0] * x / z + camera[2], camera[1] * y / z + camera[3]
                        d = depth_at(depth, u, v, step)
                        if d > 0.0 and d - z >= -truncation:
                            w = share[int(np.floor(v + 0.5)), int(np.floor(u + 0.5))]
                            if w > 0.0:
                                m, j = blocks[k, 0] * BLOCK + c, blocks[k, 1] * BLOCK + b
                                i = blocks[k, 2] * BLOCK + a
                                value = min(1.0, (d - z) / truncation)
                                total = weight[m, j, i] + w
                                tsdf[m, j, i] += (value - tsdf[m, j, i]) * w / total
                                weight[m, j, i] = total
                    x += R[0, 0] * voxel
                    y += R[1, 0] * voxel
                    z += R[2, 0] * voxel


@njit(cache=True, nogil=True)
def _value_at(tsdf, weight, x, y, z, least):  # type: ignore[no-untyped-def]
    """Trilinear value at voxel coordinates; 2 where one of the eight voxels was seen less than `least`."""
    i, j, m = int(np.floor(x)), int(np.floor(y)), int(np.floor(z))
    nz, ny, nx = tsdf.shape
    if i < 0 or j < 0 or m < 0 or i + 1 >= nx or j + 1 >= ny or m + 1 >= nz:
        return 2.0
    total = 0.0
    fx, fy, fz = x - i, y - j, z - m
    for c in range(2):
        for b in range(2):
            for a in range(2):
                if weight[m + c, j + b, i + a] < least:
                    return 2.0
                share = (fx if a else 1 - fx) * (fy if b else 1 - fy) * (fz if c else 1 - fz)
                total += share * tsdf[m + c, j + b, i + a]
    return total


@njit(cache=True, nogil=True)
def cast_rays(  # type: ignore[no-untyped-def]
    tsdf, weight, active, first, last, camera, R, t, origin, voxel, truncation, least, near, far, depth, normals
):
    """Write depth and normal (volume frame) of the rows [first, last) that a camera sees; 0 where it sees nothing.

    camera: fx, fy, cx, cy; (R, t): volume_from_camera. The zero crossing is found on trilinear values.
    """
    width = depth.shape[1]
    bz, by, bx = active.shape
    o = np.empty(3)
    d = np.empty(3)
    for v in range(first, last):
        for u in range(width):
            depth[v, u] = 0.0
            x_c, y_c = (u - camera[2]) / camera[0], (v - camera[3]) / camera[1]
            length = np.sqrt(x_c * x_c + y_c * y_c + 1.0)
            enter, leave = near, far
            for k in range(3):
                # position = o + d * depth, in voxels
                d[k] = (R[k, 0] * x_c + R[k, 1] * y_c + R[k, 2]) / voxel
                o[k] = (t[k] - origin[k]) / voxel
                span = (bx if k == 0 else by if k == 1 else bz) * BLOCK - 1.001
                if abs(d[k]) > 1e-12:
                    s0, s1 = (0.0 - o[k]) / d[k], (span - o[k]) / d[k]
                    enter, leave = max(enter, min(s0, s1)), min(leave, max(s0, s1))
                elif o[k] < 0.0 or o[k] > span:
                    leave = -1.0
            s = enter + 1e-6
            smallest = 0.5 * voxel / length
            before, before_s = 2.0, s
            while s < leave:
                x, y, z = o[0] + d[0] * s, o[1] + d[1] * s, o[2] + d[2] * s
                i, j, m = int(x) // BLOCK, int(y) // BLOCK, int(z) // BLOCK
                if not active[m, j, i]:
                    # on to where the ray leaves this block
                    out = leave
                    for k in range(3):
                        cell = i if k == 0 else j if k == 1 else m
                        if d[k] > 1e-12:
                            out = min(out, ((cell + 1) * BLOCK - o[k]) / d[k])
                        elif d[k] < -1e-12:
                            out = min(out, (cell * BLOCK - o[k]) / d[k])
                    s = max(out, s) + 1e-3 * smallest + 1e-6
                    before = 2.0
                    continue
                value = _value_at(tsdf, weight, x, y, z, least)
                if value <= 0.0 and before < 1.5:
                    if before > 0.0:
                        lo, hi, f_lo, f_hi = before_s, s, before, value
                        for _ in range(3):
                            mid = lo + (hi - lo) * f_lo / (f_lo - f_hi)
                            f = _value_at(tsdf, weight, o[0] + d[0] * mid, o[1] + d[1] * mid, o[2] + d[2] * mid, least)
                            if f > 1.5 or abs(f) < 1e-4:
                                break
                            if f > 0.0:
                                lo, f_lo = mid, f
                            else:
                                hi, f_hi = mid, f
                        _write_hit(tsdf, weight, o, d, mid, least, v, u, depth, normals)
                    break
                before, before_s = value, s
                if value > 1.5 or value <= 0.0:
                    s += 2.0 * smallest
                else:
                    s += max(0.7 * value * truncation / length, smallest)


@njit(cache=True, nogil=True)
def _write_hit(tsdf, weight, o, d, s, least, v, u, depth, normals):  # type: ignore[no-untyped-def]
    x, y, z = o[0] + d[0] * s, o[1] + d[1] * s, o[2] + d[2] * s
    n = np.empty(3)
    for k in range(3):
        ex, ey, ez = (1.0 if k == 0 else 0.0), (1.0 if k == 1 else 0.0), (1.0 if k == 2 else 0.0)
        above = _value_at(tsdf, weight, x + ex, y + ey, z + ez, least)
        below = _value_at(tsdf, weight, x - ex, y - ey, z - ez, least)
        if above > 1.5 or below > 1.5:
            return
        n[k] = above - below
    size = np.sqrt(n[0] * n[0] + n[1] * n[1] + n[2] * n[2])
    if size < 1e-6:
        return
    depth[v, u] = s
    for k in range(3):
        normals[v, u, k] = n[k] / size
