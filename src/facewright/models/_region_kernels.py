"""Numba kernels of posing: coefficients to positions, and the few constraints' update of a prefactored system."""

from __future__ import annotations

import numpy as np
from numba import njit

# Sums may be reordered for vector units; NaN and infinity keep their meaning.
_REORDERED = {"reassoc", "contract", "nsz", "arcp"}


@njit(cache=True, nogil=True, fastmath=_REORDERED)
def displace_copies(zeta, starts, offsets, basis, basis_starts, means, copies):  # type: ignore[no-untyped-def]
    """Write the displacement of every region's vertices, mean^i + B^i c^i, into `copies` (S, 3)."""
    for i in range(starts.size - 1):
        first, P = offsets[i], offsets[i + 1] - offsets[i]
        place = basis_starts[i]
        for s in range(starts[i], starts[i + 1]):
            x, y, z = means[s, 0], means[s, 1], means[s, 2]
            for p in range(P):
                c = zeta[first + p]
                x += basis[place + p] * c
                y += basis[place + P + p] * c
                z += basis[place + 2 * P + p] * c
            copies[s, 0], copies[s, 1], copies[s, 2] = x, y, z
            place += 3 * P


@njit(cache=True, nogil=True, fastmath=_REORDERED)
def blend_copies(  # type: ignore[no-untyped-def]
    copies, starts, vertices, shares, edge_starts, edges, spread_starts, spread, moved
):
    """Average the copies of shared vertices into `moved` (N, 3), and spread what that changed over each region.

    `edges` lists, region after region, the copies at shared vertices; `spread` each region's matrix (N_i, Q_i) by which
    a change there reaches its vertices. Without `spread` the averages alone.
    """
    moved[:] = 0.0
    for s in range(vertices.size):
        v = vertices[s]
        w = shares[v]
        for c in range(3):
            moved[v, c] += w * copies[s, c]
    if spread.size == 0:
        return
    for i in range(starts.size - 1):
        first, Q = edge_starts[i], edge_starts[i + 1] - edge_starts[i]
        change = np.empty((Q, 3))
        for q in range(Q):
            s = edges[first + q]
            for c in range(3):
                change[q, c] = moved[vertices[s], c] - copies[s, c]
        place = spread_starts[i]
        for s in range(starts[i], starts[i + 1]):
            v = vertices[s]
            if shares[v] == 1.0:
                x, y, z = 0.0, 0.0, 0.0
                for q in range(Q):
                    h = spread[place + q]
                    x += h * change[q, 0]
                    y += h * change[q, 1]
                    z += h * change[q, 2]
                moved[v, 0] += x
                moved[v, 1] += y
                moved[v, 2] += z
            place += Q


@njit(cache=True, nogil=True, fastmath=_REORDERED)
def add_rest(neutral, moved, out):  # type: ignore[no-untyped-def]
    """Write neutral + moved into the caller's buffer (N, 3), float32 or float64."""
    for v in range(neutral.shape[0]):
        for c in range(3):
            out[v, c] = neutral[v, c] + moved[v, c]


@njit(cache=True, nogil=True, fastmath=_REORDERED)
def settle(L, constant, pull, rest, free):  # type: ignore[no-untyped-def]
    """Write into `free` what the model does without constraints: L L' free = constant + pull rest."""
    P = rest.size
    for p in range(P):
        free[p] = constant[p] + pull[p] * rest[p]
    for p in range(P):
        value = free[p]
        for q in range(p):
            value -= L[p, q] * free[q]
        free[p] = value / L[p, p]
    for p in range(P - 1, -1, -1):
        value = free[p] / L[p, p]
        free[p] = value
        for q in range(p):
            free[q] -= L[p, q] * value


@njit(cache=True, nogil=True, fastmath=_REORDERED)
def update(rows, origin, owner, axis, gain, targets, free, zeta):  # type: ignore[no-untyped-def]
    """Write into `zeta` the free state plus gain times how far each constrained copy is from its target.

    rows (R, P) and origin (R,): a copy's coordinate is origin + rows zeta; owner and axis (R,): its target.
    """
    zeta[:] = free
    for r in range(owner.size):
        miss = targets[owner[r], axis[r]] - origin[r]
        for p in range(free.size):
            miss -= rows[r, p] * free[p]
        for p in range(free.size):
            zeta[p] += gain[r, p] * miss
