"""Numba kernel of `solve_bounded`: projected Newton steps on a batch of small quadratic problems."""

from __future__ import annotations

import numpy as np
from numba import njit


@njit(cache=True, nogil=True)
def minimise_in_box(H, C, lower, upper, X, max_iterations, tolerance):  # type: ignore[no-untyped-def]
    """Overwrite X (K, N) by the minimisers of x'H_k x / 2 - c_k'x in the boxes; return how many did not converge.

    H (1 or K, N, N); C, lower, upper (K, N). Converged: every projected gradient entry is below tolerance times the
    scale of its row of H and c. Newton step on the free variables with a search along the projected path, else a
    sweep of coordinate descent.
    """
    K, N = C.shape
    g, d, trial = np.zeros(N), np.zeros(N), np.zeros(N)
    L = np.zeros((N, N))
    free = np.zeros(N, np.int64)
    failures = 0
    for k in range(K):
        h = H[k if H.shape[0] > 1 else 0]
        x = X[k]
        ridge = 0.0
        for i in range(N):
            ridge = max(ridge, h[i, i])
            x[i] = min(max(x[i], lower[k, i]), upper[k, i])
        ridge = 1e-14 * ridge + 1e-300
        done = False
        for _ in range(max_iterations):
            n_free, done = 0, True
            for i in range(N):
                value, scale = -C[k, i], abs(C[k, i]) + 1e-300
                for j in range(N):
                    value += h[i, j] * x[j]
                    scale += abs(h[i, j] * x[j])
                g[i] = value
                held = (x[i] <= lower[k, i] and value >= 0.0) or (x[i] >= upper[k, i] and value <= 0.0)
                if not held:
                    free[n_free] = i
                    n_free += 1
                    if abs(value) > tolerance * scale:
                        done = False
            if done:
                break
            for a in range(n_free):  # Cholesky of the free block
                for b in range(a + 1):
                    s = h[free[a], free[b]]
                    for j in range(b):
                        s -= L[a, j] * L[b, j]
                    if a == b:
                        L[a, a] = np.sqrt(max(s + ridge, ridge))
                    else:
                        L[a, b] = s / L[b, b]
            for a in range(n_free):
                s = -g[free[a]]
                for j in range(a):
                    s -= L[a, j] * d[j]
                d[a] = s / L[a, a]
            for a in range(n_free - 1, -1, -1):
                s = d[a]
                for j in range(a + 1, n_free):
                    s -= L[j, a] * d[j]
                d[a] = s / L[a, a]
            step = 1.0
            accepted = False
            for _ in range(40):
                for i in range(N):
                    trial[i] = x[i]
                for a in range(n_free):
                    i = free[a]
                    trial[i] = min(max(x[i] + step * d[a], lower[k, i]), upper[k, i])
                slope, curve = 0.0, 0.0  # change of the objective, exactly
                for i in range(N):
                    u = trial[i] - x[i]
                    if u != 0.0:
                        slope += g[i] * u
                        for j in range(N):
                            curve += u * h[i, j] * (trial[j] - x[j])
                if slope + 0.5 * curve <= 1e-4 * slope and slope < 0.0:
                    accepted = True
                    break
                step *= 0.5
            if accepted:
                for i in range(N):
                    x[i] = trial[i]
                continue
            moved = False  # variables close to their bounds bent the Newton path: one sweep of coordinate descent
            for i in range(N):
                if h[i, i] > 0.0:
                    value = -C[k, i]
                    for j in range(N):
                        value += h[i, j] * x[j]
                    better = min(max(x[i] - value / h[i, i], lower[k, i]), upper[k, i])
                    moved = moved or abs(better - x[i]) > 1e-15 * (1.0 + abs(x[i]))
                    x[i] = better
            if not moved:  # no progress is possible in floating point
                done = True
                break
        if not done:
            failures += 1
    return failures
