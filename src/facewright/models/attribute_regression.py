"""From attributes in words to identity weights: FaceWarehouse 4.1.1."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from facewright.errors import DegenerateError
from facewright.numeric.check import check_choice, check_finite, check_shape


@dataclass(frozen=True, eq=False)
class AttributeRegression:
    """A linear map from changes of attributes to changes of identity weights.

    Parameters
    ----------
    names : tuple of str
        The A attributes.
    matrix : ndarray of shape (I, A + 1), float64
        M_fea: identity weights from standardised attributes and a constant.
    mean, standard_deviation : ndarray of shape (A,), float64
        Of each attribute over the population, in its own unit.
    r_squared : ndarray of shape (A,), float64
        Share of each attribute's variance over people that a linear map from the *other* people's identity weights
        predicts (leave one out); can be negative when there are few people.
    """

    names: tuple[str, ...]
    matrix: NDArray[np.float64]
    mean: NDArray[np.float64]
    standard_deviation: NDArray[np.float64]
    r_squared: NDArray[np.float64]

    def change(self, deviations: Mapping[str, float]) -> NDArray[np.float64]:
        """Return the change of identity weights, shape (I,), for changes of attributes, the others held.

        Parameters
        ----------
        deviations : mapping of str to float
            Change of each named attribute in the population's standard deviations.

        Raises
        ------
        ValueRangeError
            If a name is unknown.
        """
        delta = np.zeros(len(self.names))
        for name, value in deviations.items():
            check_choice("attribute", name, self.names)
            delta[self.names.index(name)] = value
        return self.matrix[:, :-1] @ delta


def fit_attribute_regression(
    identity_weights: NDArray[np.floating], attributes: NDArray[np.floating], names: tuple[str, ...]
) -> AttributeRegression:
    r"""Learn M_fea with :math:`M_{fea} [f_1 .. f_l, 1]^T = w_{id}` over a population.

    Parameters
    ----------
    identity_weights : ndarray of shape (N, I)
        One row per person.
    attributes : ndarray of shape (N, A)
        Measured attributes of the same people.
    names : tuple of str
        Name of each column of `attributes`.

    Raises
    ------
    ShapeError, ValueRangeError
        If shapes differ or values are not finite.
    DegenerateError
        If there are too few people or an attribute does not vary, so that F F^T is singular.

    Notes
    -----
    FaceWarehouse eq. 11-12: M_fea = W_id F^+, F^+ = F^T (F F^T)^-1.
    """
    sizes = check_shape("identity_weights", identity_weights, "N", "I")
    check_shape("attributes", attributes, sizes["N"], len(names))
    check_finite("attributes", attributes)
    check_finite("identity_weights", identity_weights)
    mean, deviation = attributes.mean(axis=0), attributes.std(axis=0)
    if len(attributes) < len(names) + 2 or (deviation <= 1e-9).any():
        raise DegenerateError(
            f"attributes must vary over at least {len(names) + 2} people, got {len(attributes)} people and a smallest "
            f"deviation of {deviation.min():.2g}."
        )
    F = np.concatenate([(attributes - mean) / deviation, np.ones((len(attributes), 1))], axis=1).T
    W = np.asarray(identity_weights, dtype=np.float64).T
    matrix = np.linalg.solve(F @ F.T, F @ W.T).T  # Eq. (12)
    design = np.concatenate([W.T, np.ones((len(attributes), 1))], axis=1)
    r_squared = _leave_one_out_r_squared(design, F[:-1].T)
    return AttributeRegression(tuple(names), matrix, mean, deviation, r_squared)


def _leave_one_out_r_squared(design: NDArray[np.float64], targets: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return R^2 of ridge predictions for people left out, by the hat matrix, shape (A,)."""
    ridge = 1e-2 * np.trace(design.T @ design) / design.shape[1]
    hat = design @ np.linalg.solve(design.T @ design + ridge * np.eye(design.shape[1]), design.T)
    residual = (targets - hat @ targets) / (1.0 - np.diag(hat))[:, None]
    return 1.0 - (residual**2).mean(axis=0) / targets.var(axis=0)
