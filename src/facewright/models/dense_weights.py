"""How each vertex of a dense surface follows a few points of it: smooth, local weights, computed once."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy import sparse

from facewright.errors import ValueRangeError
from facewright.mesh.laplacian import cotangent_laplacian, mass_matrix
from facewright.numeric.check import check_finite, check_indices, check_shape
from facewright.numeric.sparse_solve import SymmetricSolver

SUPPORT = 14
"""Points that a vertex follows at most."""

#: Weight of the points, in the typical diagonal of the bending energy; firmer ones that lie close together on a coarse
#: mesh throw what lies beyond them far.
_FIRM = 10.0
_LOOSE = 1e-9  # what nothing reaches stays
_RESTORED = 1.5  # rows are scaled up by no more to make up for weights left out
_REACHED = 0.3  # rows that sum to less are hardly reached, and learn less
_COLUMNS = 64  # points solved for at a time
_ROWS = 1024  # vertices that learn at a time
_TRUST_MM = 3.0  # a misfit of this size in a shape is worth changing a whole weight of one


class SurfacePlaces(NamedTuple):
    """Points on a surface: corners of their triangles (N, 3) int, barycentric coordinates (N, 3)."""

    corners: NDArray[np.intp]
    barycentric: NDArray[np.float64]

    def of(self, vertices: NDArray[np.floating[Any]]) -> NDArray[np.float64]:
        """Return the points (..., N, 3), or any quantity, from values at the vertices (..., V, 3)."""
        return np.einsum("nk,...nkc->...nc", self.barycentric, np.asarray(vertices)[..., self.corners, :])

    @classmethod
    def at_vertices(cls, ids: NDArray[np.integer[Any]]) -> SurfacePlaces:
        """Return places that are vertices."""
        return cls(np.repeat(np.asarray(ids, np.intp)[:, None], 3, axis=1), np.tile([1.0, 0.0, 0.0], (len(ids), 1)))


def smooth_weights(
    vertices: NDArray[np.floating[Any]],
    faces: NDArray[np.integer[Any]],
    places: SurfacePlaces,
    still: NDArray[np.integer[Any]],
    *,
    support: int = SUPPORT,
) -> sparse.csr_matrix:
    """Return weights W (V, N) by which displacements at places spread over a surface with least bending.

    Biharmonic interpolation along the surface, so that nothing crosses an opening; of each vertex the `support` largest
    weights are kept and fade out where others take their place, so that neighbours never differ by a jump.

    Parameters
    ----------
    vertices : ndarray of shape (V, 3), millimetres
        The surface at rest.
    faces : ndarray of shape (F, 3), int
        Its triangles, all with an area; vertices of none do not move.
    places : SurfacePlaces
        The N points.
    still : ndarray of shape (K,), int
        Vertices that do not move.
    support : int
        Points that a vertex follows at most.

    Returns
    -------
    scipy.sparse.csr_matrix of shape (V, N), float64
        Rows sum to 1 where the points reach and to 0 at what is still.

    Raises
    ------
    ShapeError, ValueRangeError
        If arrays do not match, an index is out of range or `support` is not positive.
    """
    V = check_shape("vertices", vertices, "V", 3)["V"]
    N = check_shape("places.corners", places.corners, "N", 3)["N"]
    check_indices("places.corners", places.corners, V)
    check_indices("still", still, V)
    check_finite("vertices", vertices)
    if support < 1:
        raise ValueRangeError(f"support must be positive, got {support}.")
    used = np.unique(np.concatenate([np.asarray(faces).ravel(), places.corners.ravel()]))
    number = np.full(V, -1)
    number[used] = np.arange(len(used))
    points, triangles = np.asarray(vertices, dtype=np.float64)[used], number[np.asarray(faces)]
    L = cotangent_laplacian(points, triangles)
    area = mass_matrix(points, triangles).diagonal()
    bending = L.T @ sparse.diags(1.0 / np.maximum(area, 1e-3)) @ L
    firm = _FIRM * float(np.median(bending.diagonal()))
    C = sparse.csr_matrix(
        (places.barycentric.ravel(), (np.repeat(np.arange(N), 3), number[places.corners].ravel())), (N, len(used))
    )
    held = np.zeros(len(used))
    held[number[np.asarray(still)[number[still] >= 0]]] = firm
    solver = SymmetricSolver((bending + firm * (C.T @ C) + sparse.diags(held + _LOOSE * firm)).tocsc())
    order = min(support, N - 1)
    best = np.zeros((len(used), support + 1))
    which = np.zeros((len(used), support + 1), dtype=np.int64)
    for start in range(0, N, _COLUMNS):  # no (V, N) array of all weights
        block = solver.solve(firm * C[start : start + _COLUMNS].T.toarray())
        columns = np.broadcast_to(np.arange(start, start + block.shape[1]), block.shape)
        best, which = _largest(np.hstack([best, block]), np.hstack([which, columns]), support + 1)
    total = solver.solve(firm * np.asarray(C.sum(axis=0)).ravel()[:, None])[:, 0]
    kept = _faded(best, order)
    sums = kept.sum(axis=1)
    kept *= np.clip(np.clip(total, 0.0, 1.0) / np.maximum(sums, 1e-6), 0.0, _RESTORED)[:, None]
    rows = np.repeat(used, order)
    W = sparse.csr_matrix((kept.ravel(), (rows, which[:, :order].ravel())), shape=(V, N))
    W.eliminate_zeros()
    return W


def learned_weights(
    weights: sparse.csr_matrix, coarse: NDArray[np.floating[Any]], dense: NDArray[np.floating[Any]]
) -> sparse.csr_matrix:
    """Return weights near the given ones that reproduce a character's own shapes better.

    Each vertex weighs how well it repeats its motion in all shapes against how far its weights go; weights that are
    small stay small, so that what was smooth and local remains so.

    Parameters
    ----------
    weights : scipy.sparse.csr_matrix of shape (V, N)
        See `smooth_weights`.
    coarse : ndarray of shape (B, N, 3), millimetres
        Displacement of the points in each shape.
    dense : ndarray of shape (B, V, 3), millimetres
        Displacement of the vertices.

    Raises
    ------
    ShapeError
        If arrays do not match.
    """
    V, N = weights.shape
    B = check_shape("coarse", coarse, "B", N, 3)["B"]
    check_shape("dense", dense, B, V, 3)
    result = weights.tocsr().copy()
    result.sort_indices()
    counts = np.diff(result.indptr)
    order = np.argsort(counts, kind="stable")  # rows of about as many weights are padded together
    for start in range(0, V, _ROWS):
        rows = order[start : start + _ROWS]
        inside = np.arange(int(counts[rows].max(initial=0))) < counts[rows][:, None]
        if not inside.any():
            continue
        places = (result.indptr[rows][:, None] + np.arange(inside.shape[1]))[inside]
        ids, prior = np.zeros(inside.shape, np.int64), np.zeros(inside.shape)
        ids[inside], prior[inside] = result.indices[places], result.data[places]
        result.data[places] = _adapted(prior, ids, coarse, np.asarray(dense)[:, rows])[inside]
    return result


def _adapted(
    prior: NDArray[np.float64],
    ids: NDArray[np.int64],
    coarse: NDArray[np.floating[Any]],
    dense: NDArray[np.floating[Any]],
) -> NDArray[np.float64]:
    """Return weights (R, k) of the points `ids`, near `prior`, that give the motion `dense` (B, R, 3) more closely."""
    B, k = len(coarse), prior.shape[1]
    X = np.asarray(coarse, dtype=np.float64)[:, ids].transpose(1, 2, 0, 3).reshape(-1, k, 3 * B)
    Y = np.asarray(dense, dtype=np.float64).transpose(1, 0, 2).reshape(-1, 1, 3 * B)
    missing = Y - prior[:, None] @ X
    size = np.abs(prior)
    freedom = np.sqrt(size / np.maximum(size.sum(axis=1, keepdims=True), _REACHED)) / _TRUST_MM
    X *= freedom[..., None]
    gram = X @ X.transpose(0, 2, 1) + np.eye(k)
    return np.asarray(prior + freedom * np.linalg.solve(gram, X @ missing.transpose(0, 2, 1))[..., 0])


def _largest(
    values: NDArray[np.float64], ids: NDArray[np.int64], count: int
) -> tuple[NDArray[np.float64], NDArray[np.int64]]:
    """Return the `count` largest values by magnitude of each row, decreasing, and their ids."""
    order = np.argpartition(-np.abs(values), min(count, values.shape[1]) - 1, axis=1)[:, :count]
    part = np.take_along_axis(values, order, axis=1)
    rank = np.argsort(-np.abs(part), axis=1, kind="stable")
    order = np.take_along_axis(order, rank, axis=1)
    return np.take_along_axis(values, order, axis=1), np.take_along_axis(ids, order, axis=1)


def _faded(best: NDArray[np.float64], count: int) -> NDArray[np.float64]:
    """Return the first `count` weights of each row, faded to zero where they come down to the next one."""
    kept = best[:, :count]
    limit = np.abs(best[:, count : count + 1]) if best.shape[1] > count else np.zeros((len(best), 1))
    size = np.maximum(np.abs(kept), 1e-12)
    return kept * np.clip(1.0 - (limit / size) ** 2, 0.0, 1.0)
