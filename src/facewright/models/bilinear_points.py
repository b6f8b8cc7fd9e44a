"""A few points of the bilinear model as a small dense tensor, for landmark fitting."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from facewright.models.bilinear import BilinearModel
from facewright.numeric.check import check_indices, check_shape


@dataclass(frozen=True, eq=False)
class BilinearPoints:
    """The core at L vertices; made by `BilinearModel.at_vertices`.

    Parameters
    ----------
    core : ndarray of shape (L, 3, I, E), float64, millimetres
    model : BilinearModel
        The model it was cut from: weights, priors and gauge are the same.
    """

    core: NDArray[np.float64]
    model: BilinearModel

    def __post_init__(self) -> None:
        check_shape("core", self.core, "L", 3, self.model.n_identity, self.model.n_expression)

    def positions(self, w_id: NDArray[np.floating], w_exp: NDArray[np.floating]) -> NDArray[np.float64]:
        """Return the points (L, 3), mm: eq. (10) at these vertices."""
        return self.core.reshape(*self.core.shape[:2], -1) @ np.outer(w_id, w_exp).reshape(-1)

    def identity_matrix(self, w_exp: NDArray[np.floating]) -> NDArray[np.float64]:
        """Return C x3 w_exp, (L, 3, I): the points are this times w_id."""
        return self.core @ np.asarray(w_exp, dtype=np.float64)

    def expression_matrix(self, w_id: NDArray[np.floating]) -> NDArray[np.float64]:
        """Return C x2 w_id, (L, 3, E): the points are this times w_exp."""
        return np.asarray(w_id, dtype=np.float64) @ self.core

    def select(self, rows: NDArray[np.integer]) -> BilinearPoints:
        """Return the points `rows` (with repetition and in any order), for contour points that slide."""
        check_indices("rows", rows, len(self.core))
        return BilinearPoints(self.core[rows], self.model)
