"""The identity prior: how the training people's weights spread."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from facewright.models.bilinear import BilinearModel


@dataclass(frozen=True, eq=False)
class IdentityPrior:
    """w_id = mean + axes c with c ~ N(0, 1): the energy is |c|^2 / 2.

    Parameters
    ----------
    mean : ndarray of shape (I,)
        Mean of the training weights (not zero: the model keeps the mean face in its core).
    axes : ndarray of shape (I, K)
        Principal axes of their covariance, scaled to one standard deviation.
    """

    mean: NDArray[np.float64]
    axes: NDArray[np.float64]

    @classmethod
    def of(cls, model: BilinearModel) -> IdentityPrior:
        """Take mean and covariance of the model."""
        variance, vectors = np.linalg.eigh(model.identity_covariance)
        kept = variance > 1e-9 * variance.max()
        return cls(model.identity_mean, vectors[:, kept] * np.sqrt(variance[kept]))

    def weights(self, c: NDArray[np.floating]) -> NDArray[np.float64]:
        """Return w_id (I,) of standard coefficients c (K,)."""
        return self.mean + self.axes @ c

    def ordered_by(self, effect: NDArray[np.floating], smallest: float) -> IdentityPrior:
        """Turn the axes so that they act on some quantity one by one, strongest first, and drop those that hardly do.

        The turned prior is the same, |c|^2 / 2; dropped axes keep their mean.

        Parameters
        ----------
        effect : ndarray of shape (M, K)
            Linear effect of the axes on M quantities.
        smallest : float
            Least root mean square effect, per quantity, of an axis that is kept.
        """
        _, strength, turn = np.linalg.svd(effect, full_matrices=False)
        kept = strength / np.sqrt(len(effect)) >= smallest
        return IdentityPrior(self.mean, self.axes @ turn[kept].T)
