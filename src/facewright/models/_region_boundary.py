"""The boundary term of eq. 6 and 9: how far the copies of shared vertices are apart, as a quadratic form."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from facewright.models._region_layout import RegionLayout
from facewright.models.region_model import RegionModel


def boundary_form(model: RegionModel, layout: RegionLayout) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return L (P, P) and l (P,): the boundary term is zeta' L zeta + 2 l' zeta + constant.

    Eq. 6 sums over j = i..M, so every pair of regions counts once (its terms with j = i are zero). Its gradient, eq. 7,
    has B_i^j c^j where the paper prints B_j^j c^j, and sums over all j.
    """
    P = model.n_coefficients
    L, l = np.zeros((P, P)), np.zeros(P)
    members = model.regions.members
    for i in range(layout.n_regions):
        for j in range(i + 1, layout.n_regions):
            _, at_i, at_j = np.intersect1d(members[i], members[j], assume_unique=True, return_indices=True)
            if not len(at_i):
                continue
            rows = [_rows(layout, i, at_i), -_rows(layout, j, at_j)]  # B_j^i and -B_i^j
            apart = (model.means[i][at_i] - model.means[j][at_j]).ravel()
            places = layout.coefficients(i), layout.coefficients(j)
            for a, place_a in zip(rows, places, strict=True):
                l[place_a] += a.T @ apart
                for b, place_b in zip(rows, places, strict=True):
                    L[place_a, place_b] += a.T @ b
    return L, l


def _rows(layout: RegionLayout, region: int, local: NDArray[np.intp]) -> NDArray[np.float64]:
    matrix = layout.matrix(region)
    return matrix.reshape(len(matrix) // 3, 3, matrix.shape[1])[local].reshape(3 * len(local), matrix.shape[1])
