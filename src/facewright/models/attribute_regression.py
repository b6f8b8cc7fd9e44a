"""From attributes in words to identity weights: FaceWarehouse 4.1.1, and the least change that obtains a request."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from facewright.errors import DegenerateError, ValueRangeError
from facewright.numeric.check import check_choice, check_finite, check_shape

_ASKED = 1e-4  # standard deviations by which what was asked for may be missed, where holding the others is soft
_LEAST_VARIANCE = 1e-10  # of the largest: directions in which the people do not vary


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
    return AttributeRegression(
        tuple(names), matrix, mean, deviation, leave_one_out_r_squared(identity_weights, F[:-1].T)
    )


def least_change(
    jacobian: NDArray[np.floating],
    covariance: NDArray[np.floating],
    request: NDArray[np.floating],
    asked: NDArray[np.bool_],
    hold: float,
) -> NDArray[np.float64]:
    r"""Return the most plausible change of identity weights that gives the attributes asked for, the others held.

    Minimises the squared Mahalanobis length :math:`\Delta w^T \Sigma^{-1} \Delta w` plus
    :math:`\sum_j (J_j \Delta w - r_j)^2 / hold^2` over the attributes not asked for, under
    :math:`J_k \Delta w = r_k` for those asked for (to 1e-4, or as near as the people's span allows).

    Parameters
    ----------
    jacobian : ndarray of shape (A, I)
        Change of each attribute, in standard deviations, with each identity weight.
    covariance : ndarray of shape (I, I)
        Of the population's identity weights.
    request : ndarray of shape (A,)
        Change wanted, standard deviations; for attributes not asked for usually 0.
    asked : ndarray of shape (A,), bool
        Which attributes were asked for.
    hold : float
        Standard deviations by which an attribute that was not asked for may move at the price of one of Mahalanobis
        length. Small holds firmly at the price of an unlikely face; large moves along with the population.

    Returns
    -------
    ndarray of shape (I,), float64

    Raises
    ------
    ShapeError, ValueRangeError
        If arrays do not match, or `hold` is not positive.

    Notes
    -----
    With Gaussian weights this is the conditional mean of w given the asked attributes and noisy readings of the others:
    for ``hold`` towards 0 it is eq. (12) of FaceWarehouse for a population of infinitely many people. Eq. (12) itself
    misses the request by what the attributes' residuals make of F F^T, and holds everything as firmly as the rest.
    """
    sizes = check_shape("jacobian", jacobian, "A", "I")
    check_shape("covariance", covariance, "I", "I", **sizes)
    check_shape("request", request, "A", **sizes)
    check_shape("asked", asked, "A", **sizes)
    check_finite("request", request)
    if not hold > 0:
        raise ValueRangeError(f"hold must be positive, got {hold}.")
    values, vectors = np.linalg.eigh(np.asarray(covariance, dtype=np.float64))
    kept = values > _LEAST_VARIANCE * max(values[-1], 1e-300)
    spread = vectors[:, kept] * np.sqrt(values[kept])  # a change is spread @ z, its Mahalanobis length |z|
    rows = np.asarray(jacobian, dtype=np.float64) @ spread
    tolerance = np.where(asked, min(_ASKED, 1e-3 * hold), hold)
    # (rows rows^T + tolerance^2) is small, A x A, and well conditioned where the rows are not
    return np.asarray(spread @ (rows.T @ np.linalg.solve(rows @ rows.T + np.diag(tolerance**2), request)))


def leave_one_out_r_squared(
    identity_weights: NDArray[np.floating], targets: NDArray[np.floating]
) -> NDArray[np.float64]:
    """Return R^2 of ridge predictions of `targets` (N, A) for people left out, by the hat matrix, shape (A,)."""
    design = np.concatenate([identity_weights, np.ones((len(targets), 1))], axis=1)
    ridge = 1e-2 * np.trace(design.T @ design) / design.shape[1]
    hat = design @ np.linalg.solve(design.T @ design + ridge * np.eye(design.shape[1]), design.T)
    residual = (targets - hat @ targets) / (1.0 - np.diag(hat))[:, None]
    return np.asarray(1.0 - (residual**2).mean(axis=0) / targets.var(axis=0))
