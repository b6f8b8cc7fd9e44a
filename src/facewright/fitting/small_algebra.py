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
    for k in range(1, K):
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
    for n in range(N):
        if w[n] == 0.0:
            continue
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
