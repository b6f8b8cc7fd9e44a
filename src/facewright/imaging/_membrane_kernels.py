"""Inner loops of the membrane on a grid."""

from __future__ import annotations

import numpy as np
from numba import njit


@njit(cache=True, nogil=True)
def relax(values, weight, moment, stiffness, fixed, sweeps, over):  # type: ignore[no-untyped-def]
    """Relax (weight + L_stiffness) values = moment in place, both components, by over-relaxed Gauss-Seidel sweeps."""
    rows, cols = fixed.shape
    half = np.float32(0.5)
    # stiffness of the edges below and to the right of each cell, with a frame of cells beyond the grid that do not pull
    below = np.zeros((rows + 1, cols), np.float32)
    beside = np.zeros((rows, cols + 1), np.float32)
    pull = np.empty((rows, cols, 2), np.float32)
    for i in range(rows):
        for j in range(cols):
            if i < rows - 1:
                below[i + 1, j] = half * (stiffness[i, j] + stiffness[i + 1, j])
            if j < cols - 1:
                beside[i, j + 1] = half * (stiffness[i, j] + stiffness[i, j + 1])
    held = np.zeros((rows + 2, cols + 2, 2), np.float32)
    for i in range(rows):
        for j in range(cols):
            total = below[i, j] + below[i + 1, j] + beside[i, j] + beside[i, j + 1]
            for k in range(2):
                pull[i, j, k] = total + weight[k, i, j]
                held[i + 1, j + 1, k] = values[k, i, j]
    for sweep in range(sweeps):
        for m in range(rows):
            i = m if sweep % 2 == 0 else rows - 1 - m
            for n in range(cols):
                j = n if sweep % 2 == 0 else cols - 1 - n
                if fixed[i, j]:
                    continue
                up, down, left, right = below[i, j], below[i + 1, j], beside[i, j], beside[i, j + 1]
                u, v = np.uint64(i + 1), np.uint64(j + 1)
                one = np.uint64(1)
                for k in range(2):
                    total = up * held[u - one, v, k] + down * held[u + one, v, k]
                    total += left * held[u, v - one, k] + right * held[u, v + one, k]
                    new = (total + moment[k, i, j]) / pull[i, j, k]
                    held[u, v, k] += over * (new - held[u, v, k])
    for i in range(rows):
        for j in range(cols):
            for k in range(2):
                values[k, i, j] = held[i + 1, j + 1, k]


@njit(cache=True, nogil=True)
def coarsen(weight, moment, stiffness, fixed):  # type: ignore[no-untyped-def]
    """Halve the grid: data add up, stiffness is averaged, a cell is fixed where all of it is."""
    rows, cols = fixed.shape
    r2, c2 = (rows + 1) // 2, (cols + 1) // 2
    w2 = np.zeros((2, r2, c2), np.float32)
    m2 = np.zeros((2, r2, c2), np.float32)
    s2 = np.zeros((r2, c2), np.float32)
    count = np.zeros((r2, c2), np.float32)
    f2 = np.ones((r2, c2), np.bool_)
    for i in range(rows):
        for j in range(cols):
            for k in range(2):
                w2[k, i // 2, j // 2] += weight[k, i, j]
                m2[k, i // 2, j // 2] += moment[k, i, j]
            s2[i // 2, j // 2] += stiffness[i, j]
            count[i // 2, j // 2] += 1
            if not fixed[i, j]:
                f2[i // 2, j // 2] = False
    s2 /= count
    return w2, m2, s2, f2


@njit(cache=True, nogil=True)
def refine(coarse, fixed):  # type: ignore[no-untyped-def]
    """Interpolate a coarse solution (2, r, c) at the cells of the finer grid; 0 where it is fixed."""
    rows, cols = fixed.shape
    r2, c2 = coarse.shape[1:]
    out = np.zeros((2, rows, cols), np.float32)
    near, far = np.float32(0.75), np.float32(0.25)
    for i in range(rows):
        a = i // 2
        b = min(max(a + (1 if i % 2 else -1), 0), r2 - 1)
        for j in range(cols):
            if fixed[i, j]:
                continue
            c = j // 2
            d = min(max(c + (1 if j % 2 else -1), 0), c2 - 1)
            for k in range(2):
                out[k, i, j] = near * (near * coarse[k, a, c] + far * coarse[k, a, d]) + far * (
                    near * coarse[k, b, c] + far * coarse[k, b, d]
                )
    return out
