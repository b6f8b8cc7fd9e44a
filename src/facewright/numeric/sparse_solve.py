"""Sparse symmetric positive definite systems: factor once, solve for many right-hand sides."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy import sparse
from scipy.sparse.linalg import splu

from facewright.errors import DegenerateError, ShapeError
from facewright.numeric.check import check_finite
from facewright.numeric.threads import for_blocks

_BLOCK = 48  # right-hand sides per sweep: the block of 11K rows then stays in the second-level cache


class SymmetricSolver:
    """Factor a sparse symmetric positive definite matrix and solve with it many times.

    SuperLU factors in symmetric mode with a minimum-degree ordering of ``A^T + A`` and without pivoting, which gives
    A = P^T L D L^T P; the triangular sweeps are our own, because SuperLU's take one right-hand side at a time:
    ours read L once for a block of them (`benchmarks/sparse_solvers.py` compares this with CHOLMOD and Pardiso).

    Parameters
    ----------
    A : scipy sparse matrix of shape (n, n), float64
        Symmetric positive definite; both triangles stored. Not modified.

    Raises
    ------
    ShapeError
        If `A` is not square.
    DegenerateError
        If `A` is singular or not positive definite.

    Examples
    --------
    >>> A = sparse.diags_array([2.0, 4.0]).tocsc()
    >>> SymmetricSolver(A).solve(np.array([2.0, 8.0])).tolist()
    [1.0, 2.0]
    """

    def __init__(self, A: Any) -> None:
        if len(A.shape) != 2 or A.shape[0] != A.shape[1]:
            raise ShapeError(f"A must be square, got {tuple(A.shape)}.")
        matrix = sparse.csc_matrix(A, dtype=np.float64)
        check_finite("A", matrix.data)
        self.n = int(matrix.shape[0])
        try:
            lu = splu(
                matrix,
                permc_spec="MMD_AT_PLUS_A",
                diag_pivot_thresh=0.0,
                options={"SymmetricMode": True, "Equil": False},
            )
        except RuntimeError as error:  # SuperLU: "Factor is exactly singular"
            raise DegenerateError("A must be positive definite, got a singular matrix.") from error
        diagonal = lu.U.diagonal()
        # Without row exchanges U = D L^T, and D > 0 exactly when A is positive definite.
        if not np.array_equal(lu.perm_r, lu.perm_c) or diagonal.min(initial=np.inf) <= 0.0:
            raise DegenerateError("A must be symmetric and positive definite, got a matrix that is not.")
        if diagonal.size and diagonal.min() <= 1e-15 * diagonal.max():
            raise DegenerateError("A must be positive definite, got a numerically singular matrix.")
        lower = sparse.tril(lu.L, k=-1, format="csc")
        self._indptr = lower.indptr.astype(np.int32)
        self._indices = lower.indices.astype(np.int32)
        self._values = lower.data
        self._inverse_diagonal = 1.0 / diagonal
        # lu.perm_r[i] is the place of row i: L U = A[order][:, order].
        self._order = np.argsort(lu.perm_r)

    def solve(self, B: NDArray[np.floating[Any]]) -> NDArray[np.float64]:
        """Solve A X = B.

        Parameters
        ----------
        B : ndarray of shape (n,) or (n, K) or (n, ...)
            Right-hand sides along the first axis; many at once cost far less than one by one.

        Returns
        -------
        ndarray of the shape of `B`, float64
            The solutions X.

        Raises
        ------
        ShapeError
            If the first axis is not n.
        """
        from facewright.numeric._triangular_sweeps import solve_ldl

        values = np.asarray(B, dtype=np.float64)
        if values.ndim < 1 or values.shape[0] != self.n:
            raise ShapeError(f"B must have shape (n={self.n}, ...), got {tuple(values.shape)}.")
        columns = values.reshape(self.n, -1)
        X = np.zeros_like(columns)

        def solve_block(start: int, stop: int) -> None:
            block = np.ascontiguousarray(columns[self._order, start:stop])
            solve_ldl(self._indptr, self._indices, self._values, self._inverse_diagonal, block)
            X[self._order, start:stop] = block

        for_blocks(columns.shape[1], _BLOCK, solve_block)
        return X.reshape(values.shape)

    @property
    def factor_nonzeros(self) -> int:
        """Number of stored entries of L, diagonal included."""
        return self._values.size + self.n


def solve_symmetric(A: Any, B: NDArray[np.floating[Any]]) -> NDArray[np.float64]:
    """Solve A X = B once; use `SymmetricSolver` where A is used again."""
    return SymmetricSolver(A).solve(B)
