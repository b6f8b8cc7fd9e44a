"""Inner loops of in-painting by patches: nearest patches by random search, and the picture that they vote for."""

from __future__ import annotations

import numpy as np
from numba import njit

_R = 2  # patches are 5 x 5 pixels

#: Roles of pixels.
UNUSED, KNOWN, WANTED = 0, 1, 2


@njit(cache=True, nogil=True)
def _distance(picture, role, trust, y, x, v, u, best):  # type: ignore[no-untyped-def]
    """Return the trust-weighted mean squared difference of two patches, or early anything above `best`."""
    height, width = role.shape
    total, weight = np.float32(0), np.float32(1e-6)
    full = np.float32(0)
    for k in range(-_R, _R + 1):
        for m in range(-_R, _R + 1):
            if 0 <= y + k < height and 0 <= x + m < width and role[y + k, x + m] != UNUSED:
                full += trust[y + k, x + m]
    limit = best * (full + np.float32(1e-6))
    for k in range(-_R, _R + 1):
        i, p = y + k, v + k
        if i < 0 or i >= height:
            continue
        for m in range(-_R, _R + 1):
            j, q = x + m, u + m
            if j < 0 or j >= width or role[i, j] == UNUSED:
                continue
            w = trust[i, j]
            a = picture[i, j, 0] - picture[p, q, 0]
            b = picture[i, j, 1] - picture[p, q, 1]
            c = picture[i, j, 2] - picture[p, q, 2]
            total += w * (a * a + b * b + c * c)
            weight += w
        if total > limit:
            return total / full
    return total / weight


@njit(cache=True, nogil=True)
def match_patches(picture, role, source, trust, ys, xs, nearest, cost, rounds, near, seed):  # type: ignore[no-untyped-def]
    """Improve, in place, the nearest source patch of every patch that holds wanted pixels (PatchMatch).

    `source` (h, w) bool: centres of patches that hold known pixels only. `ys`, `xs` (N,): centres of the wanted
    patches in the order of rows. `nearest` (h, w, 2) int32: their sources' row and column; `cost` (h, w). Patches
    farther away cost more: `near` per squared pixel.
    """
    height, width = role.shape
    state = np.uint64(seed)
    n = ys.size
    for i in range(n):
        y, x = ys[i], xs[i]
        v, u = nearest[y, x, 0], nearest[y, x, 1]
        cost[y, x] = _distance(picture, role, trust, y, x, v, u, np.float32(1e9)) + near * ((v - y) ** 2 + (u - x) ** 2)
    reach = max(height, width)
    for r in range(rounds):
        step = 1 if r % 2 == 0 else -1
        for i in range(n):
            at = i if step == 1 else n - 1 - i
            y, x = ys[at], xs[at]
            best, bv, bu = cost[y, x], nearest[y, x, 0], nearest[y, x, 1]
            for k in range(2):
                a, b = (y - step, x) if k == 0 else (y, x - step)
                if 0 <= a < height and 0 <= b < width and cost[a, b] < np.float32(1e29):
                    v, u = nearest[a, b, 0] + y - a, nearest[a, b, 1] + x - b
                    if 0 <= v < height and 0 <= u < width and source[v, u] and (v != bv or u != bu):
                        far = near * ((v - y) ** 2 + (u - x) ** 2)
                        if far < best:
                            found = _distance(picture, role, trust, y, x, v, u, best - far) + far
                            if found < best:
                                best, bv, bu = found, v, u
            size = reach
            while size >= 1:
                state = state * np.uint64(6364136223846793005) + np.uint64(1442695040888963407)
                v = bv + np.int64((state >> np.uint64(33)) % np.uint64(2 * size + 1)) - size
                state = state * np.uint64(6364136223846793005) + np.uint64(1442695040888963407)
                u = bu + np.int64((state >> np.uint64(33)) % np.uint64(2 * size + 1)) - size
                if 0 <= v < height and 0 <= u < width and source[v, u]:
                    far = near * ((v - y) ** 2 + (u - x) ** 2)
                    if far < best:
                        found = _distance(picture, role, trust, y, x, v, u, best - far) + far
                        if found < best:
                            best, bv, bu = found, v, u
                size //= 2
            cost[y, x], nearest[y, x, 0], nearest[y, x, 1] = best, bv, bu


@njit(cache=True, nogil=True)
def vote(picture, role, trust, nearest, cost, spread, out):  # type: ignore[no-untyped-def]
    """Give every wanted pixel the mean of what the patches over it propose; good and well founded ones count more."""
    height, width = role.shape
    for y in range(height):
        for x in range(width):
            if role[y, x] != WANTED:
                continue
            total = np.float32(0)
            r, g, b = np.float32(0), np.float32(0), np.float32(0)
            for k in range(-_R, _R + 1):
                for m in range(-_R, _R + 1):
                    i, j = y + k, x + m
                    if i < 0 or i >= height or j < 0 or j >= width or cost[i, j] > np.float32(1e29):
                        continue
                    v, u = nearest[i, j, 0] - k, nearest[i, j, 1] - m
                    w = trust[i, j] * np.exp(-cost[i, j] / spread) + np.float32(1e-12)
                    total += w
                    r += w * picture[v, u, 0]
                    g += w * picture[v, u, 1]
                    b += w * picture[v, u, 2]
            if total > 0:
                out[y, x, 0], out[y, x, 1], out[y, x, 2] = r / total, g / total, b / total


@njit(cache=True, nogil=True)
def add_detail(part, smooth, role, nearest, cost, n, top, out):  # type: ignore[no-untyped-def]
    """Add, in place, to wanted pixels the detail that the n times finer picture has where their patches come from.

    `part` (H, W, 3) uint8 is fine; `smooth` (h, w, 3), its blocks without detail, is interpolated; `out` (k, W, 3)
    holds the rows from `top` on.
    """
    height, width = part.shape[:2]
    rows, cols = role.shape
    for y in range(top, top + out.shape[0]):
        i = min(y // n, rows - 1)
        for x in range(width):
            j = min(x // n, cols - 1)
            if role[i, j] != WANTED or cost[i, j] > np.float32(1e29):
                continue
            v, u = y + n * (nearest[i, j, 0] - i), x + n * (nearest[i, j, 1] - j)
            if not (0 <= v < height and 0 <= u < width):
                continue
            at_y = min(max((v + 0.5) / n - 0.5, 0.0), rows - 1.0)
            at_x = min(max((u + 0.5) / n - 0.5, 0.0), cols - 1.0)
            k, m = int(at_y), int(at_x)
            a, b = np.float32(at_y - k), np.float32(at_x - m)
            k1, m1 = min(k + 1, rows - 1), min(m + 1, cols - 1)
            for c in range(3):
                upper = smooth[k, m, c] + b * (smooth[k, m1, c] - smooth[k, m, c])
                lower = smooth[k1, m, c] + b * (smooth[k1, m1, c] - smooth[k1, m, c])
                out[y - top, x, c] += part[v, u, c] - (upper + a * (lower - upper))
