"""Numba kernel of `SymmetricSolver`: forward and backward sweeps with a block of right-hand sides."""

from __future__ import annotations

from numba import njit


@njit(cache=True, nogil=True, fastmath={"contract", "reassoc"})
def solve_ldl(indptr, indices, values, inverse_diagonal, X):  # type: ignore[no-untyped-def]
    """Overwrite X (n, K) by (L D L^T)^-1 X; L unit lower in compressed columns, without its diagonal."""
    n, K = X.shape
    for j in range(n):  # L Y = X, column by column
        for p in range(indptr[j], indptr[j + 1]):
            i = indices[p]
            value = values[p]
            for k in range(K):
                X[i, k] -= value * X[j, k]
    for j in range(n - 1, -1, -1):  # L^T Z = D^-1 Y, the same columns read as rows
        for k in range(K):
            X[j, k] *= inverse_diagonal[j]
        for p in range(indptr[j], indptr[j + 1]):
            i = indices[p]
            value = values[p]
            for k in range(K):
                X[j, k] -= value * X[i, k]
