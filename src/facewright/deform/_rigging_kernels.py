"""Numba kernel of `RigFitter`: one small regularised least-squares problem per triangle."""

from __future__ import annotations

import numpy as np
from numba import njit


@njit(cache=True, nogil=True)
def correct_gradients(gram, ridge, residuals, variances, weights, gradients):  # type: ignore[no-untyped-def]
    """Add w^-1 A' (A w^-1 A' + ridge)^-1 r of every triangle to its blendshape gradients.

    gram (F, N, N) holds A w^-1 A' of each triangle, residuals r (F, N, C), variances w^-1 (F, B), weights A (N, B),
    gradients (F, B, C). This is the minimiser of |r - A m|^2 + ridge sum_b w_b |m_b|^2, written with an N x N Cholesky
    factor instead of a B x B one (N poses, B > N blendshapes).
    """
    F, N, C = residuals.shape
    B = weights.shape[1]
    L = np.zeros((N, N))
    Y = np.zeros((N, C))
    for f in range(F):
        for i in range(N):
            for j in range(i + 1):
                s = gram[f, i, j]
                if i == j:
                    s += ridge
                for k in range(j):
                    s -= L[i, k] * L[j, k]
                if i == j:
                    L[i, i] = np.sqrt(s)
                else:
                    L[i, j] = s / L[j, j]
        for i in range(N):
            for c in range(C):
                s = residuals[f, i, c]
                for k in range(i):
                    s -= L[i, k] * Y[k, c]
                Y[i, c] = s / L[i, i]
        for i in range(N - 1, -1, -1):
            for c in range(C):
                s = Y[i, c]
                for k in range(i + 1, N):
                    s -= L[k, i] * Y[k, c]
                Y[i, c] = s / L[i, i]
        for b in range(B):
            variance = variances[f, b]
            for n in range(N):
                product = variance * weights[n, b]
                if product != 0.0:
                    for c in range(C):
                        gradients[f, b, c] += product * Y[n, c]
