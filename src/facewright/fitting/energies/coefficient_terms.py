"""What is known of a frame's FACS coefficients besides its points: few are active, sides act alike, lids are seen."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from types import MappingProxyType

import numpy as np
from numpy.typing import NDArray

from facewright.faces.blendshape_names import mirrored_name
from facewright.fitting.energies.expression_prior import ExpressionPrior
from facewright.numeric.check import check_shape

#: Standard deviation of the difference between the two sides of a face.
_SIDES_APART = 0.25
#: Standard deviation of a lid's closure about what its coefficients say.
_LID_ERROR = 0.15
#: How shapes add to a lid's closure, from renders of 44 simulated people.
_LID_CLOSURE = {
    "eyeBlink": 1.0,
    "eyeSquint": 0.2,
    "cheekSquint": 0.2,
    "eyesLookDown": 0.5,
    "eyeWide": -0.2,
}
#: Points see little of these shapes, and they are seldom claimed wrongly: sparsity counts by this share only.
_FAINT = {"cheekSquint": 0.4, "eyeSquint": 0.5, "eyeWide": 0.4, "brow": 0.5, "noseSneer": 0.4}
#: And their spread is wider.
_FAINT_SPREAD = 0.8
#: Pictures tell less of a lid that slides over the eye than the lid's height does.
PICTURE_SHARES = {**_FAINT, "eyeBlink": 0.2}


@dataclass(frozen=True, eq=False)
class CoefficientTerms:
    """Energy prior(beta) + beta^T Q beta / 2 + l^T beta + constant, for beta in [0, 1].

    Parameters
    ----------
    prior : ExpressionPrior
        Of each coefficient on its own.
    coupling : ndarray of shape (B, B)
        Q: differences between the sides, and the lids' rows.
    linear : ndarray of shape (B,)
        l, a frame's own.
    lid_rows : ndarray of shape (2, B)
        Closure of the right and the left eye by the coefficients; zero where the shapes are missing.
    """

    prior: ExpressionPrior
    coupling: NDArray[np.float64]
    linear: NDArray[np.float64]
    lid_rows: NDArray[np.float64]

    @classmethod
    def of(
        cls, names: Sequence[str], prior: ExpressionPrior, shares: Mapping[str, float] = MappingProxyType(_FAINT)
    ) -> CoefficientTerms:
        """Return the terms of shapes by their names, without any frame's own; `shares` of the sparsity are theirs."""
        B = len(names)
        index = {name: i for i, name in enumerate(names)}
        Q = np.zeros((B, B))
        for name, i in index.items():
            j = index.get(mirrored_name(name), i)
            if name.endswith("_L") and j != i:
                Q[[i, j], [i, j]] += 1.0 / _SIDES_APART**2
                Q[[i, j], [j, i]] -= 1.0 / _SIDES_APART**2
        linear = np.zeros(B)
        for name, i in index.items():
            share = next((share for start, share in shares.items() if name.startswith(start)), None)
            if share is not None:  # beta >= 0, so that sparsity is a slope
                linear[i] = -(1.0 - share) * prior.sparsity
                Q[i, i] += min(1.0 / _FAINT_SPREAD**2 - 1.0 / prior.spread**2, 0.0)
        rows = np.zeros((2, B))
        for side, row in zip("RL", rows, strict=True):
            for name, share in _LID_CLOSURE.items():
                i = index.get(f"{name}_{side}", index.get(name, -1))
                if i >= 0:
                    row[i] = share
        return cls(prior, Q, linear, rows)

    def with_lids(self, closure: NDArray[np.floating]) -> CoefficientTerms:
        """Return the terms of a frame whose lids are closed by (2,), right and left: 0 open, 1 closed."""
        check_shape("closure", closure, 2)
        precision = 1.0 / _LID_ERROR**2
        return replace(
            self,
            coupling=self.coupling + precision * self.lid_rows.T @ self.lid_rows,
            linear=self.linear - precision * np.asarray(closure, dtype=np.float64) @ self.lid_rows,
        )

    @property
    def hessian(self) -> NDArray[np.float64]:
        """Second derivative (B, B)."""
        return self.coupling + np.eye(len(self.linear)) / self.prior.spread**2

    def energy(self, beta: NDArray[np.floating]) -> float:
        """Return the energy of coefficients (B,), up to a constant."""
        return self.prior.energy(beta) + float(0.5 * beta @ self.coupling @ beta + self.linear @ beta)

    def gradient(self, beta: NDArray[np.floating]) -> NDArray[np.float64]:
        """Return the gradient (B,)."""
        return self.prior.gradient(beta) + self.coupling @ beta + self.linear
