"""Numba kernel of `DeformationTransfer`: the right-hand side from poses of the source."""

from __future__ import annotations

import numpy as np
from numba import njit


@njit(cache=True, nogil=True)
def accumulate_transfer(faces, frames, carriers, poses, rhs):  # type: ignore[no-untyped-def]
    """Add sum_j w_j (Q_j - 1) grad(hat) of every pose (T, V, 3) to rhs (T, V, 3).

    frames (F, 3, 3) are the source's neutral frames V; carriers (F, 3, 2) hold w_j V_j^-1 [grad hat_2, grad hat_3],
    the gradients being the target's, so that (V~ - V) carriers is the column pair that corners 2 and 3 receive;
    corner 1 receives minus their sum.
    """
    D = np.zeros((3, 3))
    for t in range(poses.shape[0]):
        x = poses[t]
        for j in range(faces.shape[0]):
            a, b, c = faces[j, 0], faces[j, 1], faces[j, 2]
            for r in range(3):
                D[r, 0] = x[b, r] - x[a, r]
                D[r, 1] = x[c, r] - x[a, r]
            n0 = D[1, 0] * D[2, 1] - D[2, 0] * D[1, 1]
            n1 = D[2, 0] * D[0, 1] - D[0, 0] * D[2, 1]
            n2 = D[0, 0] * D[1, 1] - D[1, 0] * D[0, 1]
            length = np.sqrt(n0 * n0 + n1 * n1 + n2 * n2)
            scale = 1.0 / np.sqrt(length) if length > 0.0 else 0.0
            D[0, 2], D[1, 2], D[2, 2] = n0 * scale, n1 * scale, n2 * scale
            for r in range(3):
                d0 = D[r, 0] - frames[j, r, 0]
                d1 = D[r, 1] - frames[j, r, 1]
                d2 = D[r, 2] - frames[j, r, 2]
                second = d0 * carriers[j, 0, 0] + d1 * carriers[j, 1, 0] + d2 * carriers[j, 2, 0]
                third = d0 * carriers[j, 0, 1] + d1 * carriers[j, 1, 1] + d2 * carriers[j, 2, 1]
                rhs[t, b, r] += second
                rhs[t, c, r] += third
                rhs[t, a, r] -= second + third
