"""The arrays of a region-based model laid end to end, as the compiled kernels read them."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from facewright.models.region_model import RegionModel


@dataclass(frozen=True, eq=False)
class RegionLayout:
    """Bases, means and vertices of all regions in one array each; a vertex of two regions has two copies.

    Parameters
    ----------
    starts : ndarray of shape (M + 1,), int64
        Where each region's copies begin among all S copies.
    vertices : ndarray of shape (S,), int32
        Vertex of each copy.
    offsets : ndarray of shape (M + 1,), int64
        Where each region's coefficients begin.
    basis : ndarray of shape (sum of 3 N_i P_i,), float64
        Each region's B^i as (3 N_i, P_i), one after the other.
    basis_starts : ndarray of shape (M + 1,), int64
    means : ndarray of shape (S, 3), float64, millimetres
    shares : ndarray of shape (N,), float64
        One over the number of regions that a vertex lies in.
    """

    starts: NDArray[np.int64]
    vertices: NDArray[np.int32]
    offsets: NDArray[np.int64]
    basis: NDArray[np.float64]
    basis_starts: NDArray[np.int64]
    means: NDArray[np.float64]
    shares: NDArray[np.float64]

    @classmethod
    def of(cls, model: RegionModel) -> RegionLayout:
        """Lay out a model."""
        members = model.regions.members
        matrices = [
            np.ascontiguousarray(basis.reshape(len(basis), 3 * len(ids)).T, dtype=np.float64)
            for basis, ids in zip(model.bases, members, strict=True)
        ]
        return cls(
            starts=_starts([len(ids) for ids in members]),
            vertices=np.concatenate(members).astype(np.int32),
            offsets=model.offsets.astype(np.int64),
            basis=np.concatenate([matrix.ravel() for matrix in matrices]),
            basis_starts=_starts([matrix.size for matrix in matrices]),
            means=np.concatenate(model.means).astype(np.float64),
            shares=1.0 / model.regions.count,
        )

    @property
    def n_regions(self) -> int:
        """Number of regions M."""
        return len(self.starts) - 1

    def matrix(self, region: int) -> NDArray[np.float64]:
        """Return B^i as (3 N_i, P_i), a view."""
        part = self.basis[self.basis_starts[region] : self.basis_starts[region + 1]]
        rows, columns = np.diff(self.starts)[region], np.diff(self.offsets)[region]
        return part.reshape(3 * int(rows), int(columns))

    def coefficients(self, region: int) -> slice:
        """Return where the region's coefficients lie in zeta."""
        return slice(int(self.offsets[region]), int(self.offsets[region + 1]))

    def copies(self, region: int) -> slice:
        """Return where the region's vertices lie among all copies."""
        return slice(int(self.starts[region]), int(self.starts[region + 1]))


def _starts(sizes: list[int]) -> NDArray[np.int64]:
    return np.concatenate([[0], np.cumsum(sizes)]).astype(np.int64)
