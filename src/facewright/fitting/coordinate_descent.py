"""Weak-perspective fitting by coordinate descent: pose, identity, expression in turn (FaceWarehouse 4.1.2)."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from facewright.camera.weak_perspective import WeakPerspective, estimate_weak_perspective
from facewright.fitting.box_quadratic import minimise_in_box
from facewright.fitting.energies.expression_prior import ExpressionPrior
from facewright.fitting.energies.landmark_term import noise_px, robust_weights
from facewright.fitting.landmark_model import LandmarkModel, PersonPoints
from facewright.fitting.small_algebra import normal_equations, solve_spd


@dataclass(frozen=True, eq=False)
class FitState:
    """Where a fit is: coefficients and camera.

    Parameters
    ----------
    person : PersonPoints
        Identity.
    beta : ndarray of shape (B,)
        FACS coefficients in [0, 1].
    camera : WeakPerspective
        s, R, t of eq. 13.
    """

    person: PersonPoints
    beta: NDArray[np.float64]
    camera: WeakPerspective

    @property
    def c(self) -> NDArray[np.float64]:
        """Identity, in standard deviations along the prior's axes, (K,)."""
        return self.person.c


@dataclass(frozen=True, eq=False)
class Targets:
    """What is to be matched: the fixed landmarks and then the contour points, as `LandmarkModel` orders them.

    Parameters
    ----------
    pixels : ndarray of shape (P + C, 2)
        Found points; 0 where missing.
    confidence : ndarray of shape (P + C,)
        Relative precision; 0 where missing.
    n_fixed : int
        P.
    noise_mm : float
        Standard deviation of a point of confidence 1 on the face, per coordinate.
    """

    pixels: NDArray[np.float64]
    confidence: NDArray[np.float64]
    n_fixed: int
    noise_mm: float

    @property
    def contour(self) -> NDArray[np.float64]:
        """Contour points (C, 2)."""
        return self.pixels[self.n_fixed :]


def start_state(model: LandmarkModel, targets: Targets) -> FitState:
    """Return the mean face at rest under the pose that its fixed landmarks give."""
    person, w = model.person(np.zeros(model.n_identity)), targets.confidence[: targets.n_fixed]
    camera = estimate_weak_perspective(person.fixed @ model.neutral, targets.pixels[: targets.n_fixed], w, iterations=4)
    return FitState(person, np.zeros(len(model.mixture)), camera)


def descend(model: LandmarkModel, targets: Targets, prior: ExpressionPrior, state: FitState, rounds: int) -> FitState:
    """Run rounds of contour, pose, identity and expression steps.

    Parameters
    ----------
    model : LandmarkModel
        Small cores.
    targets : Targets
        Landmarks.
    prior : ExpressionPrior
        Of the FACS coefficients.
    state : FitState
        Where to start.
    rounds : int
        Number of rounds.

    Returns
    -------
    FitState
        Where it ended.
    """
    for _ in range(rounds):
        w_exp = model.expression(state.beta)
        pixels = state.camera.project(state.person.candidates(w_exp))
        places = model.place_contour(pixels, state.camera.rotation, targets.contour)
        A = model.identity_matrix(w_exp, places)
        state = _pose_step(A, targets, state)
        state = _identity_step(A, model, targets, state)
        state = _expression_step(state.person.expression_matrix(places), model, targets, prior, state)
    return state


def _weights(points: NDArray[np.float64], targets: Targets, camera: WeakPerspective) -> NDArray[np.float64]:
    sigma = noise_px(camera.scale, targets.noise_mm, targets.confidence)
    return robust_weights(camera.project(points) - targets.pixels, sigma)


def _pose_step(A: NDArray[np.float64], targets: Targets, state: FitState) -> FitState:
    """Fit s, R and t to the present face, an orthogonal problem."""
    points = A[0] + np.tensordot(state.c, A[1:], 1)
    w = _weights(points, targets, state.camera)
    return replace(state, camera=estimate_weak_perspective(points, targets.pixels, w, start=state.camera, iterations=2))


def _identity_step(A: NDArray[np.float64], model: LandmarkModel, targets: Targets, state: FitState) -> FitState:
    """Solve eq. (14) for the identity with its prior |c|^2 / 2: a linear system."""
    camera = state.camera
    w = _weights(A[0] + np.tensordot(state.c, A[1:], 1), targets, camera)
    seen = A @ camera.matrix.T  # (1 + K, L, 2)
    J = np.ascontiguousarray(seen[1:].reshape(len(seen) - 1, -1).T)
    wanted = (targets.pixels - camera.translation - seen[0]).ravel()
    H, g = normal_equations(J, np.repeat(w, 2), wanted)
    H[np.diag_indices_from(H)] += 1.0
    return replace(state, person=model.person(solve_spd(H, g[:, None])[:, 0]))


def _expression_step(
    B: NDArray[np.float64], model: LandmarkModel, targets: Targets, prior: ExpressionPrior, state: FitState
) -> FitState:
    """Solve eq. (14) for the expression, w_exp = u_0 + sum_i beta_i (u_i - u_0): a least squares within bounds."""
    camera = state.camera
    w = _weights(B @ model.expression(state.beta), targets, camera)
    seen = np.einsum("rc,lce->lre", camera.matrix, B).reshape(-1, B.shape[2])
    J = seen @ model.mixture.T  # (2 L, B)
    wanted = (targets.pixels - camera.translation).ravel() - seen @ model.neutral
    H, g = normal_equations(J, np.repeat(w, 2), wanted)
    H[np.diag_indices_from(H)] += 1.0 / prior.spread**2
    return replace(state, beta=minimise_in_box(H, prior.sparsity - g, state.beta))
