"""Weak-perspective fitting by coordinate descent: pose, identity, expression in turn (FaceWarehouse 4.1.2)."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from facewright.camera.weak_perspective import WeakPerspective, estimate_weak_perspective
from facewright.fitting.box_quadratic import minimise_in_box
from facewright.fitting.energies.expression_prior import ExpressionPrior
from facewright.fitting.energies.landmark_term import noise_px, robust_weights
from facewright.fitting.landmark_model import LandmarkModel, expression_matrix, identity_matrix
from facewright.landmarks.contour import slide_on_outline


@dataclass(frozen=True, eq=False)
class FitState:
    """Where a fit is: coefficients and camera.

    Parameters
    ----------
    c : ndarray of shape (K,)
        Identity, in standard deviations along the prior's axes.
    beta : ndarray of shape (B,)
        FACS coefficients in [0, 1].
    camera : WeakPerspective
        s, R, t of eq. 13.
    """

    c: NDArray[np.float64]
    beta: NDArray[np.float64]
    camera: WeakPerspective


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
    c, beta = np.zeros(model.n_identity), np.zeros(len(model.mixture))
    points = identity_matrix(model.core[:1], model.neutral)[0]
    w = targets.confidence[: targets.n_fixed]
    return FitState(c, beta, estimate_weak_perspective(points, targets.pixels[: targets.n_fixed], w))


def slide_contour(model: LandmarkModel, state: FitState, targets: Targets) -> NDArray[np.float64]:
    """Refresh the contour's correspondences under the present camera; return the core of all points."""
    outline = model.outline(state.c, state.beta)
    pixels = state.camera.project(outline)
    chosen = model.strips.outline(pixels, state.camera.rotation)
    corners = pixels[np.arange(len(chosen)), chosen]
    return model.with_contour(chosen, slide_on_outline(targets.contour, corners))


def descend(
    model: LandmarkModel, targets: Targets, prior: ExpressionPrior, state: FitState, rounds: int
) -> tuple[FitState, NDArray[np.float64]]:
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
    state : FitState
        Where it ended.
    core : ndarray of shape (1 + K, P + C, 3, E)
        Core of all points at the last correspondences.
    """
    core = slide_contour(model, state, targets)
    for round_ in range(rounds):
        if round_:
            core = slide_contour(model, state, targets)
        A = identity_matrix(core, model.expression(state.beta))
        state = _pose_step(A, targets, state)
        state = _identity_step(A, targets, state)
        B = expression_matrix(core, state.c)
        state = _expression_step(B, model, targets, prior, state)
    return state, core


def _weights(points: NDArray[np.float64], targets: Targets, camera: WeakPerspective) -> NDArray[np.float64]:
    sigma = noise_px(camera.scale, targets.noise_mm, targets.confidence)
    return robust_weights(camera.project(points) - targets.pixels, sigma)


def _pose_step(A: NDArray[np.float64], targets: Targets, state: FitState) -> FitState:
    """Fit s, R and t to the present face, an orthogonal problem."""
    points = A[0] + np.tensordot(state.c, A[1:], 1)
    w = _weights(points, targets, state.camera)
    return replace(state, camera=estimate_weak_perspective(points, targets.pixels, w, start=state.camera))


def _identity_step(A: NDArray[np.float64], targets: Targets, state: FitState) -> FitState:
    """Solve eq. (14) for the identity with its prior |c|^2 / 2: a linear system."""
    camera = state.camera
    w = _weights(A[0] + np.tensordot(state.c, A[1:], 1), targets, camera)
    seen = A @ camera.matrix.T  # (1 + K, L, 2)
    J = seen[1:].reshape(len(seen) - 1, -1)
    wanted = (targets.pixels - camera.translation - seen[0]).ravel()
    JW = J * np.repeat(w, 2)
    c = np.linalg.solve(JW @ J.T + np.eye(len(J)), JW @ wanted)
    return replace(state, c=c)


def _expression_step(
    B: NDArray[np.float64], model: LandmarkModel, targets: Targets, prior: ExpressionPrior, state: FitState
) -> FitState:
    """Solve eq. (14) for the expression, w_exp = u_0 + sum_i beta_i (u_i - u_0): a least squares within bounds."""
    camera = state.camera
    w = _weights(B @ model.expression(state.beta), targets, camera)
    seen = np.einsum("rc,lce->lre", camera.matrix, B).reshape(-1, B.shape[2])
    J = seen @ model.mixture.T  # (2 L, B)
    wanted = (targets.pixels - camera.translation).ravel() - seen @ model.neutral
    JW = J.T * np.repeat(w, 2)
    n = len(state.beta)
    H = JW @ J + np.eye(n) / prior.spread**2
    g = np.full(n, prior.sparsity) - JW @ wanted
    return replace(state, beta=minimise_in_box(H, g, state.beta))
