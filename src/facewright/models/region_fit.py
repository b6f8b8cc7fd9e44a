"""Finding the coefficients of a region-based model in data (Tena et al. 2011, section 3.1, eq. 5-7, and eq. 13)."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import cho_solve, cholesky

from facewright.errors import ShapeError, ValueRangeError
from facewright.models._region_boundary import boundary_form
from facewright.models._region_layout import RegionLayout
from facewright.models.region_blend import Blend, blended_sequence
from facewright.models.region_model import RegionModel
from facewright.numeric.box_pivoting import BoxPivoting
from facewright.numeric.check import check_finite, check_shape
from facewright.numeric.threads import one_blas_thread

_FLOOR = 1e-12  # of the system's scale: what no vertex says is zero
_BOUNDED_RIDGE = 1e-6  # of a bounded coefficient's own share: shapes that look alike in a region share what they say


class RegionFitter:
    r"""Minimise eq. 6 for many frames: every region's reconstruction, and agreement at the shared vertices.

    .. math:: E(\zeta) = \sum_i \|v^i - B^i c^i\|^2 + \beta \sum_{i<j} \|B_j^i c^i - B_i^j c^j\|^2

    The sum over j = i..M of eq. 6 counts each pair of regions once. Its derivative is (eq. 7, whose last product is
    printed as :math:`B_j^{iT} B_j^j c^j`, and whose second term is printed transposed):

    .. math:: B^{iT} B^i c^i - B^{iT} v^i + \beta \sum_j (B_j^{iT} B_j^i c^i - B_j^{iT} B_i^j c^j) = 0

    One positive definite system for all regions, factored once for full data. With one region this is eq. 4.

    Parameters
    ----------
    model : RegionModel
    beta : float
        Weight of the boundaries against the reconstruction; no unit. The paper's: 0.5.
    gamma : float
        Weight of the coefficients' size, in `RegionModel.units`; zero as in eq. 6. For partial data it says what is not
        seen: small, near zero.

    Raises
    ------
    ValueRangeError
        If beta or gamma is negative or not finite.
    """

    def __init__(self, model: RegionModel, beta: float = 0.5, gamma: float = 0.0) -> None:
        for name, value in (("beta", beta), ("gamma", gamma)):
            if not (np.isfinite(value) and value >= 0.0):
                raise ValueRangeError(f"{name} must be finite and not negative, got {value}.")
        self.model, self.beta, self.gamma = model, float(beta), float(gamma)
        self._layout = RegionLayout.of(model)
        boundary, self._offset = boundary_form(model, self._layout)
        units = np.concatenate([np.zeros(0), *model.units])
        self._soft = beta * boundary + np.diag(gamma * units**2)
        self._floor = _FLOOR * max(float((units**2).max(initial=1.0)), float(np.diag(self._soft).max(initial=0.0)))
        self._lower = np.concatenate([np.zeros(0), *model.lower])
        self._upper = np.concatenate([np.zeros(0), *model.upper])
        self._bounded = bool(np.isfinite(self._lower).any() or np.isfinite(self._upper).any())
        self._everything = np.ones(model.n_vertices, dtype=bool)
        self._full = self._system(self._everything)

    def fit(
        self, displacements: NDArray[np.floating[Any]], present: NDArray[np.bool_] | None = None
    ) -> NDArray[np.float64]:
        """Return the coefficients zeta (T, P) of displacements from the neutral.

        Parameters
        ----------
        displacements : ndarray of shape (T, N, 3), millimetres
            Without head motion. Anything, NaN too, where a vertex is not present.
        present : ndarray of shape (N,) or (T, N), bool, optional
            Vertices that count; all by default.

        Raises
        ------
        ShapeError, ValueRangeError
            If arrays do not match or a present vertex is not finite.
        """
        N = self.model.n_vertices
        sizes = check_shape("displacements", displacements, "T", N, 3)
        if present is None:
            return self._fit(displacements, self._everything, self._full)
        mask = np.asarray(present, dtype=bool)
        if mask.shape == (N,):
            return self._fit(displacements, mask, self._system(mask))
        check_shape("present", mask, "T", N, **sizes)
        zeta = np.zeros((sizes["T"], self.model.n_coefficients))
        patterns, which = np.unique(mask, axis=0, return_inverse=True)
        for number, pattern in enumerate(patterns):  # frames that miss the same vertices share a factor
            frames = np.flatnonzero(which.ravel() == number)
            zeta[frames] = self._fit(displacements[frames], pattern, self._system(pattern))
        return zeta

    def reconstruct(self, zeta: NDArray[np.floating[Any]], blend: Blend = "average") -> NDArray[np.float64]:
        """Return the displacements (T, N, 3), mm, of coefficients (T, P), boundaries blended."""
        return blended_sequence(self.model, zeta, blend) - self.model.neutral

    def _system(self, present: NDArray[np.bool_]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Return the matrix of eq. 7 and its Cholesky factor."""
        layout, H = self._layout, self._soft.copy()
        for i in range(layout.n_regions):
            place = layout.coefficients(i)
            B = layout.matrix(i)[np.repeat(present[self.model.regions.members[i]], 3)]
            H[place, place] += B.T @ B
        if self._bounded:
            H[np.diag_indices_from(H)] *= 1.0 + _BOUNDED_RIDGE
        H[np.diag_indices_from(H)] += self._floor
        return H, cholesky(H, lower=True) if H.size else H

    def _fit(
        self,
        displacements: NDArray[np.floating[Any]],
        present: NDArray[np.bool_],
        system: tuple[NDArray[np.float64], NDArray[np.float64]],
    ) -> NDArray[np.float64]:
        layout, T = self._layout, len(displacements)
        data = np.asarray(displacements)[:, present]
        check_finite("displacements", data)
        column = np.cumsum(present) - 1
        c = np.tile(-self.beta * self._offset, (T, 1))
        for i, ids in enumerate(self.model.regions.members):
            seen = present[ids]
            B = layout.matrix(i)[np.repeat(seen, 3)]
            wanted = data[:, column[ids[seen]]].astype(np.float64) - self.model.means[i][seen]
            c[:, layout.coefficients(i)] += wanted.reshape(T, 3 * int(seen.sum())) @ B
        H, factor = system
        if self._bounded:
            box = BoxPivoting(H, self._lower, self._upper)  # frames are near the ones before them
            with one_blas_thread():  # ten times as fast as two threads that wait for each other
                return np.stack([box.solve(row) for row in c]) if T else c
        return np.ascontiguousarray(cho_solve((factor, True), c.T).T) if H.size else c


def reconstruction_rms(truth: NDArray[np.floating[Any]], reconstructed: NDArray[np.floating[Any]]) -> float:
    """Return E_RMS of eq. 13, mm: the root mean squared distance of a vertex over frames and vertices.

    Raises
    ------
    ShapeError
        If the arrays are not both (F, N, 3), or empty.
    """
    sizes = check_shape("truth", truth, "F", "N", 3)
    check_shape("reconstructed", reconstructed, "F", "N", 3, **sizes)
    if not np.size(truth):
        raise ShapeError("truth must hold at least one vertex of one frame.")
    difference = np.asarray(truth, dtype=np.float64) - reconstructed
    return float(np.sqrt(np.einsum("fnc,fnc->", difference, difference) / (sizes["F"] * sizes["N"])))
