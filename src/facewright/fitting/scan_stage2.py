"""Stage 2 of scan fitting: Laplacian deformation to landmarks and depth (FaceWarehouse 3.2.1, eq. 6-7)."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import sparse

from facewright.mesh.laplacian import cotangent_laplacian
from facewright.mesh.normals import face_area_vectors
from facewright.numeric.sparse_solve import SymmetricSolver

#: Relative residual at which a solve stops: far below what one Gauss-Newton step leaves.
_TOLERANCE = 1e-4
_MOST_ITERATIONS = 40
#: Solves that took more iterations than this with an old factor get a new one.
_PATIENCE = 14
#: Laplacian coordinates shorter than this have no direction to keep; mm.
_SHORTEST_MM = 1e-6
#: A triangle is folded if its normal turned by more than about 75 degrees or its area shrank to less than this share.
_LEAST_COSINE, _LEAST_AREA = 0.25, 0.2
#: Triangles of less than half of this have no side to speak of; mm^2.
_SLIVER_MM2 = 0.1
#: At most so many times are folds repaired, each time by so many rounds of averaging.
_MOST_REPAIRS, _SMOOTHINGS = 6, 30


@dataclass(frozen=True, eq=False)
class Pulls:
    """What holds the vertices in one Gauss-Newton step, besides the Laplacian energy.

    Parameters
    ----------
    diagonal : ndarray of shape (V,)
        Summed weights of each vertex.
    rhs : ndarray of shape (V, 3)
        Weights times goals.
    coupling : sparse matrix of shape (V, V) or None
        Weighted Laplacian of vertex pairs (contact); its right-hand side is in `rhs`.
    """

    diagonal: NDArray[np.float64]
    rhs: NDArray[np.float64]
    coupling: sparse.csr_matrix | None = None


class LaplacianDeformer:
    """Deform a mesh so that its Laplacian coordinates keep their length and turn freely.

    Parameters
    ----------
    faces : ndarray of shape (F, 3)
        Triangles.
    rest : ndarray of shape (V, 3), millimetres
        The mesh whose cotangents make the Laplacian.

    Notes
    -----
    Only the diagonal of L^T L + D changes between steps, and it changes little: a factor of an earlier step is a
    preconditioner with which conjugate gradients need a handful of iterations, each far cheaper than a new factor.
    """

    def __init__(self, faces: NDArray[np.integer], rest: NDArray[np.float64]) -> None:
        self.faces = faces
        self.L = cotangent_laplacian(rest, faces)
        self.LtL = (self.L.T @ self.L).tocsr()
        self._factor: SymmetricSolver | None = None
        self._factored = np.empty(0)
        self.factorisations = 0
        self.iterations = 0

    def deform(
        self,
        start: NDArray[np.float64],
        pulls: Callable[[NDArray[np.float64], int], Pulls],
        steps: int,
        *,
        smoothness: float = 1.0,
    ) -> NDArray[np.float64]:
        """Return the deformed mesh after `steps` inexact Gauss-Newton steps.

        Parameters
        ----------
        start : ndarray of shape (V, 3), millimetres
            First guess, whose Laplacian coordinates have the lengths to keep.
        pulls : callable
            Called with the current mesh and the number of the step; returns what holds it.
        steps : int
            Gauss-Newton steps.
        smoothness : float
            w'3 of eq. (7).
        """
        lengths = np.linalg.norm(self.L @ start, axis=1)
        x = start.copy()
        for step in range(steps):
            held = pulls(x, step)
            goal = self.L @ x
            size = np.linalg.norm(goal, axis=1)
            scale = np.divide(lengths, size, out=np.zeros_like(size), where=size > _SHORTEST_MM)
            goal *= scale[:, None]  # Eq. (6): original length, current direction
            matrix = smoothness * self.LtL + sparse.diags(held.diagonal)
            if held.coupling is not None:
                matrix = matrix + held.coupling
            x = self._solve(matrix.tocsr(), smoothness * (self.L.T @ goal) + held.rhs, x, smoothness)  # Eq. (7)
        return x

    def _solve(
        self, matrix: sparse.csr_matrix, rhs: NDArray[np.float64], x: NDArray[np.float64], smoothness: float
    ) -> NDArray[np.float64]:
        if self._factor is not None:
            x, used = _conjugate_gradients(matrix, rhs, x, self._factor)
            self.iterations += used
            if used <= _PATIENCE:
                return x
        self._factor = SymmetricSolver(matrix)
        self.factorisations += 1
        return self._factor.solve(rhs)


def _conjugate_gradients(
    matrix: sparse.csr_matrix, rhs: NDArray[np.float64], x: NDArray[np.float64], preconditioner: SymmetricSolver
) -> tuple[NDArray[np.float64], int]:
    """Solve for the columns of `rhs` together; return the solution and the number of iterations."""
    r = rhs - matrix @ x
    limit = _TOLERANCE * np.linalg.norm(rhs - matrix @ np.broadcast_to(x.mean(axis=0), x.shape), axis=0)
    if (np.linalg.norm(r, axis=0) <= limit).all():
        return x, 0
    z = preconditioner.solve(r)
    p, rz = z.copy(), (r * z).sum(axis=0)
    for iteration in range(1, _MOST_ITERATIONS + 1):
        q = matrix @ p
        alpha = rz / np.maximum((p * q).sum(axis=0), 1e-300)
        x = x + alpha * p
        r = r - alpha * q
        if (np.linalg.norm(r, axis=0) <= limit).all():
            return x, iteration
        z = preconditioner.solve(r)
        new = (r * z).sum(axis=0)
        p = z + (new / np.maximum(rz, 1e-300)) * p
        rz = new
    return x, _MOST_ITERATIONS


def unfold(
    before: NDArray[np.float64],
    after: NDArray[np.float64],
    faces: NDArray[np.integer],
    adjacency: sparse.csr_matrix,
) -> NDArray[np.float64]:
    """Return the deformed mesh without triangles that the deformation turned over or squeezed flat.

    Slivers at the rims of lips and lids fold when their corners are pulled to points a tenth of a millimetre apart.
    There the displacement is replaced by the mean of the neighbours' displacements, again and again over one ring of
    vertices more, until nothing is folded or the mesh has had its chances.

    Parameters
    ----------
    before, after : ndarray of shape (V, 3), millimetres
        The mesh before and after, in one frame.
    faces : ndarray of shape (F, 3)
        Triangles.
    adjacency : sparse matrix of shape (V, V)
        1 where an edge joins two vertices.
    """
    moved = after - before
    smoothed = np.zeros(len(before), dtype=bool)
    old = face_area_vectors(before, faces)
    size = np.linalg.norm(old, axis=1)
    for _ in range(_MOST_REPAIRS):
        new = face_area_vectors(before + moved, faces)
        folded = np.einsum("fc,fc->f", old, new) < _LEAST_COSINE * size * np.linalg.norm(new, axis=1)
        folded |= np.linalg.norm(new, axis=1) < _LEAST_AREA * size
        folded &= size > _SLIVER_MM2
        if not folded.any():
            break
        seeds = np.zeros(len(before))
        seeds[faces[folded]] = 1.0
        smoothed |= (adjacency @ (smoothed + seeds) + seeds) > 0
        ids = np.flatnonzero(smoothed)
        rows = adjacency[ids]
        count = np.asarray(rows.sum(axis=1))
        for _ in range(_SMOOTHINGS):
            moved[ids] = (rows @ moved) / count
    return before + moved
