"""From coefficients to one face: copies of boundary vertices averaged, or their difference spread over regions."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray
from scipy import sparse

from facewright.errors import ShapeError
from facewright.mesh.connectivity import unique_edges
from facewright.models._region_kernels import add_rest, blend_copies, displace_copies
from facewright.models._region_layout import RegionLayout
from facewright.models.region_model import RegionModel
from facewright.numeric.check import check_choice, check_shape
from facewright.numeric.sparse_solve import SymmetricSolver

Blend = Literal["average", "gradient"]
BLENDS: tuple[Blend, ...] = ("average", "gradient")

_HOLD = 1e-6  # keeps what no boundary reaches where it is


@dataclass(frozen=True)
class BoundaryGaps:
    """How far the copies of shared vertices lie apart before blending, mm; zero where nothing is shared."""

    mean_mm: float
    max_mm: float


class RegionBlend:
    """Turn coefficients into vertices, boundaries made one (section 3.1, last paragraph).

    Parameters
    ----------
    model : RegionModel
    method : {"average", "gradient"}
        "average": "the mean value of the boundary vertices shared by the sub-models". "gradient": what that moves at a
        boundary is spread over the region so that the region's Laplacian coordinates change least (Sorkine et al.
        2004), a fixed small matrix for each region.

    Raises
    ------
    ValueRangeError
        If `method` is unknown.
    """

    def __init__(self, model: RegionModel, method: Blend = "average") -> None:
        check_choice("blend", method, list(BLENDS))
        self.model, self.method = model, method
        self.layout = RegionLayout.of(model)
        layout = self.layout
        shared = model.regions.count[layout.vertices] > 1
        self._edges = np.flatnonzero(shared).astype(np.int64)
        counts = [int(shared[layout.copies(i)].sum()) for i in range(layout.n_regions)]
        self._edge_starts = np.concatenate([[0], np.cumsum(counts)]).astype(np.int64)
        spreads = [_spread(model, i) for i in range(layout.n_regions)] if method == "gradient" else []
        self._spread = np.concatenate([np.zeros(0), *(matrix.ravel() for matrix in spreads)])
        self._spread_starts = np.concatenate([[0], np.cumsum([matrix.size for matrix in spreads])]).astype(np.int64)
        self._copies = np.empty((len(layout.vertices), 3))
        self._moved = np.empty((model.n_vertices, 3))
        self._neutral = np.ascontiguousarray(model.neutral, dtype=np.float64)

    def copies(self, zeta: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return every region's displacements before blending, (S, 3), mm, in the order of the regions' members."""
        self._displace(zeta)
        return self._copies.copy()

    def displacements(self, zeta: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return blended displacements from the neutral (N, 3), mm, in a buffer that the next call overwrites."""
        self._displace(zeta)
        layout = self.layout
        blend_copies(
            self._copies, layout.starts, layout.vertices, layout.shares, self._edge_starts, self._edges,
            self._spread_starts, self._spread, self._moved,
        )  # fmt: skip
        return self._moved

    def positions(self, zeta: NDArray[np.float64], out: NDArray[np.floating] | None = None) -> NDArray[np.floating]:
        """Return blended positions (N, 3), mm, in `out` (float32 or float64, C order) where given.

        Raises
        ------
        ShapeError
            If `zeta` is not (P,) or `out` not (N, 3).
        """
        if out is None:
            out = np.empty((self.model.n_vertices, 3))
        elif out.shape != self._moved.shape:
            raise ShapeError(f"out must have shape {self._moved.shape}, got {out.shape}.")
        add_rest(self._neutral, self.displacements(zeta), out)
        return out

    def gaps(self, zeta: NDArray[np.float64]) -> BoundaryGaps:
        """Return mean and largest distance between the copies of a shared vertex, mm."""
        copies, vertices = self.copies(zeta)[self._edges], self.layout.vertices[self._edges]
        order = np.argsort(vertices, kind="stable")
        copies, vertices = copies[order], vertices[order]
        pairs = [
            np.linalg.norm(copies[step:] - copies[:-step], axis=1)[vertices[step:] == vertices[:-step]]
            for step in range(1, int(self.model.regions.count.max(initial=1)))
        ]
        lengths = np.concatenate([np.zeros(0), *pairs])
        return BoundaryGaps(float(lengths.mean()) if lengths.size else 0.0, float(lengths.max(initial=0.0)))

    def linear_map(self) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Return the blended mean (N, 3) and basis (P, N, 3): positions = neutral + mean + zeta basis."""
        P = self.model.n_coefficients
        mean = self.displacements(np.zeros(P)).copy()
        basis = np.stack([self.displacements(row) - mean for row in np.eye(P)]) if P else np.zeros((0, *mean.shape))
        return mean, basis

    def _displace(self, zeta: NDArray[np.float64]) -> None:
        layout = self.layout
        if zeta.shape != (self.model.n_coefficients,):
            raise ShapeError(f"zeta must have shape ({self.model.n_coefficients},), got {zeta.shape}.")
        displace_copies(
            np.ascontiguousarray(zeta, dtype=np.float64), layout.starts, layout.offsets, layout.basis,
            layout.basis_starts, layout.means, self._copies,
        )  # fmt: skip


def blended_sequence(model: RegionModel, zeta: NDArray[np.floating], method: Blend = "average") -> NDArray[np.float64]:
    """Return blended positions (T, N, 3), mm, of many rows of coefficients (T, P)."""
    check_shape("zeta", zeta, "T", model.n_coefficients)
    mean, basis = RegionBlend(model, method).linear_map()
    moved = np.asarray(zeta, dtype=np.float64) @ basis.reshape(len(basis), mean.size)
    return moved.reshape(len(moved), *mean.shape) + (model.neutral + mean)


def _spread(model: RegionModel, region: int) -> NDArray[np.float64]:
    """Return (N_i, Q_i): how the region's vertices follow its Q_i shared ones, their Laplacian coordinates kept."""
    ids = model.regions.members[region]
    place = np.full(model.n_vertices, -1)
    place[ids] = np.arange(len(ids))
    inside = model.faces[(place[model.faces] >= 0).all(axis=1)]
    edges = place[unique_edges(inside)] if len(inside) else np.zeros((0, 2), int)
    n = len(ids)
    A = sparse.coo_matrix((np.ones(len(edges)), (edges[:, 0], edges[:, 1])), shape=(n, n))
    A = (A + A.T).tocsr()
    degree = np.asarray(A.sum(axis=1)).ravel()
    laplacian = sparse.diags(1.0 / np.maximum(degree, 1.0)) @ (sparse.diags(degree) - A)
    H = (laplacian.T @ laplacian).tocsr()
    shared = model.regions.count[ids] > 1
    fixed, free = np.flatnonzero(shared), np.flatnonzero(~shared)
    result = np.zeros((n, len(fixed)))
    result[fixed, np.arange(len(fixed))] = 1.0
    if len(free) and len(fixed):
        system = H[free][:, free] + _HOLD * sparse.identity(len(free))
        result[free] = SymmetricSolver(system).solve(-H[free][:, fixed].toarray())
    return result
