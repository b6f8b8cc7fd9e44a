"""Fit the bilinear model to meshes of its own topology: alternating least squares with priors, then Newton."""

from __future__ import annotations

import warnings
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from facewright.errors import ConvergenceWarning, ShapeError, ValueRangeError
from facewright.models.bilinear import BilinearModel
from facewright.numeric.check import check_finite, check_indices, check_shape

_COLUMNS = 8448  # float32 products are summed over this many columns, the sums in double
_DOUBLE_BELOW = 6000  # coordinates; a small subset can be nearly singular and costs nothing in double
_ALTERNATIONS = 3


class BilinearFit(NamedTuple):
    """Result of `BilinearProjector.fit`.

    Attributes
    ----------
    identity_weights : ndarray of shape (I,)
    expression_weights : ndarray of shape (E,)
        In gauge: ``model.expression_gauge @ expression_weights == 1``.
    rms_mm : float
        Root of the (weighted) mean squared distance between given and fitted vertices.
    iterations : int
    """

    identity_weights: NDArray[np.float64]
    expression_weights: NDArray[np.float64]
    rms_mm: float
    iterations: int


class BilinearProjector:
    r"""Finds (w_id, w_exp) of meshes; what depends only on the model and the vertices used is computed once.

    Minimises :math:`\sum_v \omega_v \|x_v - C_v \times_2 w_{id} \times_3 w_{exp}\|^2 + \sigma^2 (q_{id} + q_{exp})`
    with q the squared Mahalanobis distance from the training weights' mean (not from zero), under
    ``expression_gauge @ w_exp == 1``. With the Gram matrix of the core's (I E) rows, an iteration costs (I E)^2,
    whatever the number of vertices.

    Parameters
    ----------
    model : BilinearModel
    vertex_ids : ndarray of shape (L,), optional
        Vertices that are given; all by default.
    vertex_weights : ndarray of shape (L,), optional
        Trust omega in each given vertex, 0 for none; 1 by default.

    Notes
    -----
    FaceWarehouse 3.3, Fig. 4, does not say how it fits; alternating least squares is Vlasic et al. (2005). Three
    alternations, each half a linear solve, find the basin; damped Newton steps on both together converge in a few
    iterations where alternation creeps along the valley between a wide mouth and a wide smile.
    """

    def __init__(
        self,
        model: BilinearModel,
        *,
        vertex_ids: NDArray[np.integer] | None = None,
        vertex_weights: NDArray[np.floating] | None = None,
    ) -> None:
        self.model = model
        rows = model.core_rows
        if vertex_ids is not None:
            ids = np.asarray(vertex_ids)
            check_shape("vertex_ids", ids, "L")
            check_indices("vertex_ids", ids, model.n_vertices)
            rows = rows[:, :, ids]
        L = rows.shape[2]
        weights = np.ones(L) if vertex_weights is None else np.asarray(vertex_weights, dtype=np.float64)
        check_shape("vertex_weights", weights, L)
        check_finite("vertex_weights", weights)
        if (weights < 0).any() or not weights.any():
            raise ValueRangeError("vertex_weights must be non-negative and not all zero.")
        self._weights = weights
        self._roots = np.repeat(np.sqrt(weights), 3)
        flat = rows.reshape(model.n_identity * model.n_expression, -1)
        self._rows = flat if vertex_weights is None else flat * self._roots.astype(np.float32)
        self._gram = gram_of_rows(self._rows)

        m = model.expression_mean
        self._tangent = np.linalg.qr(m[:, None], mode="complete")[0][:, 1:]  # w_exp = m + tangent @ y stays in gauge
        self._identity_precision = model.identity_precision
        self._tangent_precision = self._tangent.T @ model.expression_precision @ self._tangent

    def fit(
        self,
        vertices: NDArray[np.floating],
        *,
        noise_mm: float = 0.0,
        start: tuple[NDArray[np.floating], NDArray[np.floating]] | None = None,
        max_iterations: int = 50,
        tolerance_mm: float = 1e-5,
    ) -> BilinearFit:
        """Fit one mesh.

        Parameters
        ----------
        vertices : ndarray of shape (L, 3), millimetres
            Positions of the projector's vertices, in model space. Not modified; may be NaN where the weight is 0.
        noise_mm : float
            Sigma, the standard deviation of the measurement noise: larger trusts the prior more. 0 is plain least
            squares, for which ``fit(synthesise(w))`` returns w (in gauge).
        start : (w_id, w_exp), optional
            Where to start; the prior's mean by default.
        max_iterations : int
            Limit of Newton steps.
        tolerance_mm : float
            Stop when a step moves the face by less than this, RMS.

        Returns
        -------
        BilinearFit

        Raises
        ------
        ShapeError
            If `vertices` is not (L, 3): a mesh of another topology.
        ValueRangeError
            If a used vertex is not finite or `noise_mm` is negative.

        Warns
        -----
        ConvergenceWarning
            If the limit is reached first.
        """
        target = self._weighted_target(vertices)
        if not noise_mm >= 0:
            raise ValueRangeError(f"noise_mm must not be negative, got {noise_mm}.")
        model = self.model
        state = (model.identity_mean, model.expression_mean) if start is None else model.in_gauge(*start)
        iterations, moved = 0, np.inf
        # Twice: the second time about a nearby face, whose residual is small and therefore exact in float32.
        for alternations in (_ALTERNATIONS, 0):
            problem = _Problem(self, target, state, noise_mm)
            for _ in range(alternations):
                problem.step(identity=True, expression=False)
                problem.step(identity=False, expression=True)
            while iterations < max_iterations:
                iterations += 1
                moved = problem.step(identity=True, expression=True) / np.sqrt(self._weights.sum())
                if moved < tolerance_mm:
                    break
            state = problem.w_id, problem.w_exp
        if not moved < tolerance_mm:
            warnings.warn(
                f"the bilinear fit stopped after {iterations} iterations, still moving {moved:.2g} mm.",
                ConvergenceWarning,
                stacklevel=2,
            )
        residual = target - self._synthesise(*state)
        return BilinearFit(*state, float(np.sqrt(residual @ residual / self._weights.sum())), iterations)

    def _weighted_target(self, vertices: NDArray[np.floating]) -> NDArray[np.float64]:
        L = len(self._weights)
        if np.shape(vertices) != (L, 3):
            raise ShapeError(f"vertices must have shape ({L}, 3) for this model, got {np.shape(vertices)}.")
        flat = np.asarray(vertices, dtype=np.float64).reshape(-1)
        check_finite("vertices", flat[self._roots > 0])
        return np.where(self._roots > 0, flat, 0.0) * self._roots

    def _synthesise(self, w_id: NDArray[np.float64], w_exp: NDArray[np.float64]) -> NDArray[np.float64]:
        return (np.outer(w_id, w_exp).astype(np.float32).reshape(-1) @ self._rows).astype(np.float64)


class _Problem:
    """The energy about a reference face, as a polynomial in the weights (no vertices left)."""

    def __init__(
        self,
        projector: BilinearProjector,
        target: NDArray[np.float64],
        state: tuple[NDArray[np.float64], NDArray[np.float64]],
        noise_mm: float,
    ) -> None:
        self.w_id, self.w_exp = state
        I, E = len(self.w_id), len(self.w_exp)
        self.projector = projector
        self.gram = projector._gram
        self.reference = np.outer(*state).reshape(-1)
        residual = (target - projector._synthesise(*state)).astype(np.float32)
        self.slope = (projector._rows @ residual).astype(np.float64)
        # Without a prior, a trace of one keeps directions that the data do not see where they are.
        floor = 1e-12 * np.trace(self.gram) / (I * E)
        self.prior_id = noise_mm**2 * projector._identity_precision
        self.prior_exp = noise_mm**2 * projector._tangent_precision
        self.floor_id, self.floor_exp = floor * np.eye(I), floor * np.eye(E - 1)
        self.damping = 0.0
        self.energy = self._energy(self.w_id, self.w_exp)[0]

    def _energy(self, w_id: NDArray[np.float64], w_exp: NDArray[np.float64]) -> tuple[float, NDArray[np.float64]]:
        """Return energy (up to a constant) and the residual seen by each core row, (I, E)."""
        model = self.projector.model
        offset = np.outer(w_id, w_exp).reshape(-1) - self.reference
        pull = self.gram @ offset
        d = w_id - model.identity_mean
        y = self.projector._tangent.T @ (w_exp - model.expression_mean)
        energy = offset @ pull - 2 * offset @ self.slope + d @ self.prior_id @ d + y @ self.prior_exp @ y
        return float(energy), (self.slope - pull).reshape(len(w_id), -1)

    def step(self, *, identity: bool, expression: bool) -> float:
        """Take one damped Newton step in one or both blocks; return how far it moves the face, sqrt(sum mm^2)."""
        I = len(self.w_id)
        tangent = self.projector._tangent
        data, curvature, rhs = self._normal_equations()
        ridge = np.zeros_like(data)
        ridge[:I, :I] = self.prior_id + self.floor_id
        ridge[I:, I:] = self.prior_exp + self.floor_exp
        active = np.r_[np.full(I, identity), np.full(len(rhs) - I, expression)]
        block = np.ix_(active, active)
        data, ridge = data[block], ridge[block]
        # Newton's matrix where it is positive definite: with a large residual, Gauss-Newton only creeps.
        hessian = data + ridge - curvature[block]
        if not _is_positive_definite(hessian):
            hessian = data + ridge
        for _ in range(12):
            x = np.zeros_like(rhs)
            x[active] = _solve(hessian + self.damping * np.diag(np.diag(data)), rhs[active])
            w_id, w_exp = self.w_id + x[:I], self.w_exp + tangent @ x[I:]
            energy = self._energy(w_id, w_exp)[0]
            moved = float(np.sqrt(max(x[active] @ data @ x[active], 0.0)))
            if energy <= self.energy + 1e-12 * abs(self.energy):
                self.w_id, self.w_exp, self.energy = w_id, w_exp, energy
                self.damping = self.damping / 10 if self.damping > 1e-6 else 0.0
                return moved
            self.damping = max(10 * self.damping, 1e-4)
        return 0.0  # no descent left within rounding

    def _normal_equations(self) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]]:
        """Return J^T J of the data, the residual's own curvature and the right-hand side, for (w_id, y)."""
        model, tangent = self.projector.model, self.projector._tangent
        I, E = len(self.w_id), len(self.w_exp)
        by_identity = (self.w_id @ self.gram.reshape(I, -1)).reshape(E, I, E)  # [e, i', e'], summed over i
        by_both = (self.w_exp @ self.gram.reshape(I, E, -1)).reshape(I, I, E) @ self.w_exp  # [i, i']
        expression = np.tensordot(by_identity, self.w_id, axes=(1, 0))  # [e, e']
        cross = by_identity @ self.w_exp  # [e, i']: row (w_id, e) with row (i', w_exp)
        _, pull = self._energy(self.w_id, self.w_exp)
        matrix = np.block([[by_both, cross.T @ tangent], [tangent.T @ cross, tangent.T @ expression @ tangent]])
        d = self.w_id - model.identity_mean
        y = tangent.T @ (self.w_exp - model.expression_mean)
        rhs_id = pull @ self.w_exp - self.prior_id @ d
        rhs_exp = tangent.T @ (self.w_id @ pull) - self.prior_exp @ y
        # The face is bilinear, so its second derivative is the core itself and only couples w_id with w_exp.
        mixed = pull @ tangent
        curvature = np.block([[np.zeros((I, I)), mixed], [mixed.T, np.zeros((E - 1, E - 1))]])
        return matrix, curvature, np.concatenate([rhs_id, rhs_exp])


def gram_of_rows(rows: NDArray[np.float32]) -> NDArray[np.float64]:
    """Return rows @ rows.T: products in single (double for few columns), sums over blocks of columns in double."""
    gram = np.zeros((len(rows), len(rows)))
    dtype = np.float64 if rows.shape[1] <= _DOUBLE_BELOW else np.float32
    for start in range(0, rows.shape[1], _COLUMNS):
        block: NDArray[Any] = rows[:, start : start + _COLUMNS].astype(dtype, copy=False)
        gram += block @ block.T
    return gram


def _is_positive_definite(matrix: NDArray[np.float64]) -> bool:
    scale = 1.0 / np.sqrt(np.maximum(np.diag(matrix), 1e-300))
    try:
        np.linalg.cholesky(matrix * scale * scale[:, None])
    except np.linalg.LinAlgError:
        return False
    return True


def _solve(matrix: NDArray[np.float64], rhs: NDArray[np.float64]) -> NDArray[np.float64]:
    if not len(rhs):
        return rhs
    scale = 1.0 / np.sqrt(np.maximum(np.diag(matrix), 1e-300))  # weights of mean and detail differ by 1e5 in effect
    try:
        return scale * np.linalg.solve(matrix * scale * scale[:, None], rhs * scale)
    except np.linalg.LinAlgError:
        return scale * np.linalg.lstsq(matrix * scale * scale[:, None], rhs * scale, rcond=None)[0]
