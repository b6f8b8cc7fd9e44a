"""Inner loops of the membrane on a grid."""

from __future__ import annotations

import numpy as np
from numba import njit


@njit(cache=True, nogil=True)
def relax(values, weight, moment, stiffness, fixed, sweeps, over):  # type: ignore[no-untyped-def]
    """Relax (weight + L_stiffness) values = moment in place, both components, by over-relaxed Gauss-Seidel sweeps."""
    rows, cols = fixed.shape
    half = np.float32(0.5)
    for sweep in range(sweeps):
        for k in range(rows):
            i = k if sweep % 2 == 0 else rows - 1 - k
            for m in range(cols):
                j = m if sweep % 2 == 0 else cols - 1 - m
                if fixed[i, j]:
                    continue
                c = stiffness[i, j]
                total = np.float32(0)
                sx = np.float32(0)
                sy = np.float32(0)
                if i > 0:
                    e = half * (c + stiffness[i - 1, j])
                    total += e
                    sx += e * values[0, i - 1, j]
                    sy += e * values[1, i - 1, j]
                if i < rows - 1:
                    e = half * (c + stiffness[i + 1, j])
                    total += e
                    sx += e * values[0, i + 1, j]
                    sy += e * values[1, i + 1, j]
                if j > 0:
                    e = half * (c + stiffness[i, j - 1])
                    total += e
                    sx += e * values[0, i, j - 1]
                    sy += e * values[1, i, j - 1]
                if j < cols - 1:
                    e = half * (c + stiffness[i, j + 1])
                    total += e
                    sx += e * values[0, i, j + 1]
                    sy += e * values[1, i, j + 1]
                new_x = (sx + moment[0, i, j]) / (total + weight[0, i, j])
                new_y = (sy + moment[1, i, j]) / (total + weight[1, i, j])
                values[0, i, j] += over * (new_x - values[0, i, j])
                values[1, i, j] += over * (new_y - values[1, i, j])


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
