"""Products and solves of the sizes that a landmark fit has, where a threaded BLAS spends its time waiting."""

from __future__ import annotations

import numpy as np
from numba import njit

# All kernels take C-contiguous arrays. Sums may be reordered, so that they vectorise; NaN keeps its meaning.
_REORDER = {"reassoc", "contract", "nsz"}


@njit(cache=True, fastmath=_REORDER)
def contract_last(core, w):  # type: ignore[no-untyped-def]
    """Return core (K, N, E) times w (E,): (K, N) float64."""
    K, N, E = core.shape
    out = np.empty((K, N))
    for k in range(K):
        for n in range(N):
            total = np.float32(0.0)
            for e in range(E):
                total += core[k, n, e] * w[e]
            out[k, n] = total
    return out


@njit(cache=True, fastmath=_REORDER)
def contract_between(core, first, second, fraction, w):  # type: ignore[no-untyped-def]
    """Return core (K, N, 3, E) times w (E,) at places between `first` (C,) and `second`: (K, C, 3) float64."""
    K, _, D, E = core.shape
    C = first.size
    out = np.empty((K, C, D))
    for k in range(K):
        for i in range(C):
            for d in range(D):
                a, b = core[k, first[i], d], core[k, second[i], d]
                at_a, at_b = np.float32(0.0), np.float32(0.0)
                for e in range(E):
                    at_a += a[e] * w[e]
                    at_b += b[e] * w[e]
                out[k, i, d] = (1.0 - fraction[i]) * at_a + fraction[i] * at_b
    return out


@njit(cache=True, fastmath=_REORDER)
def contract_points(core, w):  # type: ignore[no-untyped-def]
    """Return core (N, 3, E) times w (E,): (N, 3) float64."""
    N, D, E = core.shape
    out = np.empty((N, D))
    for n in range(N):
        for d in range(D):
            total = 0.0
            for e in range(E):
                total += core[n, d, e] * w[e]
            out[n, d] = total
    return out


@njit(cache=True, fastmath=_REORDER)
def contract_first(core, c):  # type: ignore[no-untyped-def]
    """Return c (K,) times core (K, M): (M,) float64; the first weight is 1."""
    K, M = core.shape
    out = core[0].copy()
    whole = 1 + 4 * ((K - 1) // 4)
    for k in range(1, whole, 4):  # four rows for each pass over the sum
        c0, c1, c2, c3 = c[k], c[k + 1], c[k + 2], c[k + 3]
        row0, row1, row2, row3 = core[k], core[k + 1], core[k + 2], core[k + 3]
        for m in range(M):
            out[m] += c0 * row0[m] + c1 * row1[m] + c2 * row2[m] + c3 * row3[m]
    for k in range(whole, K):
        ck = c[k]
        row = core[k]
        for m in range(M):
            out[m] += ck * row[m]
    return out.astype(np.float64)


@njit(cache=True, fastmath=_REORDER)
def normal_equations(J, w, r):  # type: ignore[no-untyped-def]
    """Return J^T diag(w) J (P, P) and J^T diag(w) r (P,) of J (N, P)."""
    N, P = J.shape
    H = np.zeros((P, P))
    g = np.zeros(P)
    whole = 4 * (N // 4)
    for n in range(0, whole, 4):  # four rows for each pass over the sums
        row0, row1, row2, row3 = J[n], J[n + 1], J[n + 2], J[n + 3]
        w0, w1, w2, w3 = w[n], w[n + 1], w[n + 2], w[n + 3]
        for i in range(P):
            a0, a1, a2, a3 = w0 * row0[i], w1 * row1[i], w2 * row2[i], w3 * row3[i]
            g[i] += a0 * r[n] + a1 * r[n + 1] + a2 * r[n + 2] + a3 * r[n + 3]
            target = H[i]
            for j in range(i, P):
                target[j] += a0 * row0[j] + a1 * row1[j] + a2 * row2[j] + a3 * row3[j]
    for n in range(whole, N):
        row = J[n]
        for i in range(P):
            scaled = w[n] * row[i]
            g[i] += scaled * r[n]
            target = H[i]
            for j in range(i, P):
                target[j] += scaled * row[j]
    for i in range(P):
        for j in range(i):
            H[i, j] = H[j, i]
    return H, g


@njit(cache=True, fastmath=_REORDER)
def solve_spd(A, B):  # type: ignore[no-untyped-def]
    """Solve A X = B for symmetric positive definite A (P, P) and B (P, M); NaN where A is not definite."""
    P = A.shape[0]
    M = B.shape[1]
    L = A.copy()
    X = B.copy()
    for j in range(P):
        for k in range(j):
            f = L[j, k]
            for i in range(j, P):
                L[i, j] -= f * L[i, k]
        pivot = L[j, j]
        if not pivot > 0.0:
            X[:] = np.nan
            return X
        root = np.sqrt(pivot)
        for i in range(j, P):
            L[i, j] /= root
    for i in range(P):
        for k in range(i):
            f = L[i, k]
            for m in range(M):
                X[i, m] -= f * X[k, m]
        for m in range(M):
            X[i, m] /= L[i, i]
    for i in range(P - 1, -1, -1):
        for k in range(i + 1, P):
            f = L[k, i]
            for m in range(M):
                X[i, m] -= f * X[k, m]
        for m in range(M):
            X[i, m] /= L[i, i]
    return X
