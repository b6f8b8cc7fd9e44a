"""Sparse symmetric solvers on the matrices of this project: factor and solve times side by side.

Ours is SuperLU with a symmetric ordering and sweeps of our own (`SymmetricSolver`); the peers are SuperLU's other ways,
CHOLMOD (cholespy, scikit-sparse) and Pardiso (pypardiso, whose MKL takes 1 GB of disk). Ratios are ours/theirs.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import partial

import numpy as np
from scipy import sparse
from scipy.sparse.linalg import splu

from benchmarks.common import benchmark_face, best_ms, has_peer, quick_from_command_line
from facewright.deform.deformation_transfer import DeformationTransfer
from facewright.mesh.laplacian import cotangent_laplacian, mass_matrix
from facewright.numeric.sparse_solve import SymmetricSolver

Solve = Callable[[np.ndarray], np.ndarray]
COLUMNS = (3, 138)  # one expression; 46 blendshapes


def superlu_own_sweeps(A: sparse.csc_matrix) -> Solve:
    return SymmetricSolver(A).solve


def superlu_symmetric(A: sparse.csc_matrix) -> Solve:
    options = {"SymmetricMode": True, "Equil": False}
    return splu(A, permc_spec="MMD_AT_PLUS_A", diag_pivot_thresh=0.0, options=options).solve


def superlu_default(A: sparse.csc_matrix) -> Solve:
    return splu(A).solve


def cholespy(A: sparse.csc_matrix) -> Solve:
    from cholespy import CholeskySolverD, MatrixType

    solver = CholeskySolverD(A.shape[0], A.indptr, A.indices, A.data, MatrixType.CSC)

    def solve(B: np.ndarray) -> np.ndarray:
        X = np.zeros_like(B)
        for start in range(0, B.shape[1], 128):  # its limit
            block = np.ascontiguousarray(B[:, start : start + 128])
            x = np.zeros_like(block)
            solver.solve(block, x)
            X[:, start : start + 128] = x
        return X

    return solve


def pypardiso(A: sparse.csc_matrix) -> Solve:
    from pypardiso import PyPardisoSolver

    upper = sparse.triu(A, format="csr")
    solver = PyPardisoSolver(mtype=2)
    solver.factorize(upper)
    return lambda B: solver.solve(upper, np.asfortranarray(B))


def scikit_sparse(A: sparse.csc_matrix) -> Solve:
    from sksparse import cholmod

    return cholmod.cholesky(A)


CANDIDATES = {
    superlu_own_sweeps: None,  # ours first: the others are compared with it
    superlu_symmetric: None,
    superlu_default: None,
    cholespy: "cholespy",
    pypardiso: "pypardiso",
    scikit_sparse: "sksparse",
}


def matrices() -> dict[str, sparse.csc_matrix]:
    face = benchmark_face().skin()
    vertices, faces = face.mean_shape.astype(np.float64), face.topology.faces
    transfer = DeformationTransfer(vertices, vertices, faces)
    L, M = cotangent_laplacian(vertices, faces), mass_matrix(vertices, faces)
    return {
        "deformation transfer": (transfer._matrix + sparse.diags(transfer._pins)).tocsc(),
        "bi-Laplacian": (L @ sparse.diags(1 / M.diagonal()) @ L + 1e-3 * M).tocsc(),
    }


def measure(
    candidate: Callable[[sparse.csc_matrix], Solve], A: sparse.csc_matrix, repeats: int
) -> tuple[list[float], float]:
    """Return factor and solve times, ms, and the largest residual."""
    solve = candidate(A)
    times, residual = [best_ms(partial(candidate, A), repeats)], 0.0
    for columns in COLUMNS:
        B = np.random.default_rng(0).normal(size=(A.shape[0], columns))
        times.append(best_ms(partial(solve, B), repeats))
        residual = max(residual, float(np.abs(A @ solve(B) - B).max()))
    return times, residual


def main() -> None:
    repeats = 2 if quick_from_command_line(__doc__) else 7
    systems = matrices()
    candidates = [solver for solver, module in CANDIDATES.items() if module is None or has_peer(module)]
    for name, A in systems.items():
        print(f"  {name}: {A.shape[0]} unknowns, {A.nnz} nonzeros; ms (ours/theirs)")
        heads = "".join(f"{f'{k} solves':>18s}" for k in COLUMNS)
        print(f"    {'solver':20s}{'factor':>18s}{heads}{'residual':>10s}")
        ours: list[float] = []
        for candidate in candidates:
            times, residual = measure(candidate, A, repeats)
            ours = ours or times
            figures = "".join(f"{t:10.1f} ({o / t:5.2f})" for o, t in zip(ours, times, strict=True))
            print(f"    {candidate.__name__:20s}{figures}{residual:10.0e}", flush=True)


if __name__ == "__main__":
    main()
