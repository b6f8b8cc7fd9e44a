"""Sparse symmetric solvers on the matrices of this project: factor and solve times side by side.

Peers that are not installed are left out: pip install cholespy pypardiso scikit-sparse (the last needs SuiteSparse).
"""

from __future__ import annotations

import os
import platform
from collections.abc import Callable
from functools import partial
from pathlib import Path
from time import perf_counter

import numpy as np
from scipy import sparse
from scipy.sparse.linalg import splu

from facewright.deform.deformation_transfer import DeformationTransfer
from facewright.errors import MissingFaceError
from facewright.faces import load_face
from facewright.mesh.laplacian import cotangent_laplacian, mass_matrix
from facewright.numeric.sparse_solve import SymmetricSolver

Solve = Callable[[np.ndarray], np.ndarray]
REPEATS = 7
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


CANDIDATES = (superlu_own_sweeps, superlu_symmetric, superlu_default, cholespy, pypardiso, scikit_sparse)


def median_ms(work: Callable[[], object]) -> float:
    work()
    times = []
    for _ in range(REPEATS):
        start = perf_counter()
        work()
        times.append(perf_counter() - start)
    return 1e3 * float(np.median(times))


def matrices() -> dict[str, sparse.csc_matrix]:
    compact = Path(os.environ.get("FACEWRIGHT_TEST_DATA", "") or "/nonexistent") / "ict_facekit.npz"
    try:
        face = load_face(compact if compact.is_file() else "ict").skin()
    except MissingFaceError:
        face = load_face("builtin").skin()
    vertices, faces = face.mean_shape.astype(np.float64), face.topology.faces
    print(f"mesh: {face.name}, {len(vertices)} vertices; {platform.machine()}, {os.cpu_count()} cores")
    transfer = DeformationTransfer(vertices, vertices, faces)
    L, M = cotangent_laplacian(vertices, faces), mass_matrix(vertices, faces)
    return {
        "deformation transfer": (transfer._matrix + sparse.diags(transfer._pins)).tocsc(),
        "bi-Laplacian": (L @ sparse.diags(1 / M.diagonal()) @ L + 1e-3 * M).tocsc(),
    }


def measure(candidate: Callable[[sparse.csc_matrix], Solve], A: sparse.csc_matrix) -> tuple[list[float], float]:
    """Return factor and solve times, ms, and the largest residual."""
    solve = candidate(A)
    times, residual = [median_ms(lambda: candidate(A))], 0.0
    for columns in COLUMNS:
        B = np.random.default_rng(0).normal(size=(A.shape[0], columns))
        times.append(median_ms(partial(solve, B)))
        residual = max(residual, float(np.abs(A @ solve(B) - B).max()))
    return times, residual


def main() -> None:
    for name, A in matrices().items():
        print(f"\n{name}: {A.nnz} nonzeros")
        heads = "".join(f"{f'{k} solves ms':>16s}" for k in COLUMNS)
        print(f"{'solver':22s}{'factor ms':>11s}{heads}{'residual':>11s}")
        for candidate in CANDIDATES:
            try:
                times, residual = measure(candidate, A)
            except ImportError:
                print(f"{candidate.__name__:22s} not installed")
                continue
            figures = "".join(f"{t:16.1f}" for t in times[1:])
            print(f"{candidate.__name__:22s}{times[0]:11.1f}{figures}{residual:11.1e}")


if __name__ == "__main__":
    main()
