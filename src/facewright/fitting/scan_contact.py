"""Lips and lids that the capture shows closed stay closed."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import sparse

from facewright.faces.face import Face

#: Lips whose landmarks are nearer than the first are closed, further than the second open; mm.
_CLOSED_MM, _OPEN_MM = 1.5, 4.0


@dataclass(frozen=True, eq=False)
class ContactTerm:
    """Springs between vertices that touch: sum_k w_k |(x_u - x_l) - offset_k|^2, quadratic with a fixed matrix.

    Parameters
    ----------
    matrix : scipy.sparse matrix of shape (V, V)
        Weighted Laplacian of the pairs.
    rhs : ndarray of shape (V, 3)
        Its right-hand side.
    """

    matrix: sparse.csr_matrix
    rhs: NDArray[np.float64]


class ContactPairs:
    """The pairs of a face that may touch, with their offsets at rest.

    Parameters
    ----------
    face : Face
        With ``lip_contact_*`` and ``lid_contact_*`` masks, or some of them.
    """

    def __init__(self, face: Face) -> None:
        masks = face.topology.masks
        empty = np.empty(0, dtype=np.int32)
        lids = [(f"lid_contact_upper_{side}", f"lid_contact_lower_{side}") for side in ("left", "right")]
        names = {"lips": [("lip_contact_upper", "lip_contact_lower")], "lids": lids}
        self.pairs = {}
        for kind, both in names.items():
            kept = [(masks.get(u, empty), masks.get(lo, empty)) for u, lo in both]
            kept = [(u, lo) for u, lo in kept if len(u) and len(u) == len(lo)]
            upper = np.concatenate([empty, *(u for u, _ in kept)]).astype(np.intp)
            lower = np.concatenate([empty, *(lo for _, lo in kept)]).astype(np.intp)
            self.pairs[kind] = (upper, lower)
        self.n_vertices = face.topology.n_vertices

    def gaps(self, kind: str, vertices: NDArray[np.floating]) -> NDArray[np.float64]:
        """Return the distances (K,) within the pairs of ``"lips"`` or ``"lids"``, millimetres."""
        upper, lower = self.pairs[kind]
        return np.linalg.norm(vertices[upper].astype(np.float64) - vertices[lower], axis=1)

    def term(self, kind: str, weights: NDArray[np.float64], offsets: NDArray[np.float64]) -> ContactTerm:
        """Return springs of weights (K,) towards offsets (K, 3), upper minus lower."""
        upper, lower = self.pairs[kind]
        V = self.n_vertices
        rows = np.concatenate([upper, lower, upper, lower])
        columns = np.concatenate([upper, lower, lower, upper])
        values = np.concatenate([weights, weights, -weights, -weights])
        rhs = np.zeros((V, 3))
        np.add.at(rhs, upper, weights[:, None] * offsets)
        np.add.at(rhs, lower, -weights[:, None] * offsets)
        return ContactTerm(sparse.csr_matrix((values, (rows, columns)), shape=(V, V)), rhs)
