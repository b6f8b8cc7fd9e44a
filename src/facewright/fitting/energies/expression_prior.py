"""The expression prior: FACS coefficients between 0 and 1, few of them active."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray


@dataclass(frozen=True)
class ExpressionPrior:
    """Energy sum_i sparsity beta_i + beta_i^2 / (2 spread^2), with beta in [0, 1].

    Parameters
    ----------
    spread : float
        Standard deviation of a coefficient.
    sparsity : float
        Slope at zero; draws coefficients that the picture does not ask for to exactly zero.
    """

    spread: float = 0.35
    sparsity: float = 1.0

    def energy(self, beta: NDArray[np.floating]) -> float:
        """Return the energy of coefficients (B,)."""
        return float(self.sparsity * beta.sum() + 0.5 * (beta @ beta) / self.spread**2)

    def gradient(self, beta: NDArray[np.floating]) -> NDArray[np.float64]:
        """Return the gradient (B,)."""
        return self.sparsity + np.asarray(beta, dtype=np.float64) / self.spread**2
