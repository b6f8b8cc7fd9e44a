"""Full-perspective refinement: camera, identity and expression together, by Gauss-Newton within bounds."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from facewright.camera.pinhole import Intrinsics, RigidMotion, pinhole_jacobian, pixel_by_point, rigid_from_weak
from facewright.camera.rotation import rotation_from_vector
from facewright.fitting.box_quadratic import minimise_in_box
from facewright.fitting.coordinate_descent import FitState, Targets
from facewright.fitting.energies.expression_prior import ExpressionPrior
from facewright.fitting.energies.landmark_term import landmark_energy, noise_px, robust_weights
from facewright.fitting.landmark_model import LandmarkModel, expression_matrix, identity_matrix
from facewright.landmarks.contour import slide_on_outline

_N_CAMERA = 7  # rotation, translation, logarithm of the focal length


@dataclass(frozen=True)
class CameraPrior:
    """What is known of the lens: log focal length ~ N(log of the guess, spread).

    Parameters
    ----------
    focal_length : float
        Guess, pixels.
    spread : float
        Standard deviation of its natural logarithm.
    """

    focal_length: float
    spread: float


@dataclass(frozen=True, eq=False)
class PinholeState:
    """Where a perspective fit is.

    Parameters
    ----------
    c, beta : ndarray of shape (K,) and (B,)
        As in `FitState`.
    motion : RigidMotion
        camera_from_model.
    intrinsics : Intrinsics
        Of equal focal lengths.
    """

    c: NDArray[np.float64]
    beta: NDArray[np.float64]
    motion: RigidMotion
    intrinsics: Intrinsics

    @property
    def scale(self) -> float:
        """Pixels per millimetre at the model's origin."""
        return self.intrinsics.focal_x / float(self.motion.translation[2])

    def project(self, points: NDArray[np.floating]) -> NDArray[np.float64]:
        """Project model points (..., 3) to pixels (..., 2)."""
        return self.intrinsics.project(self.motion.apply(points))


def refine(
    model: LandmarkModel,
    targets: Targets,
    expression_prior: ExpressionPrior,
    camera_prior: CameraPrior,
    start: FitState,
    image_size: tuple[int, int],
    iterations: int,
) -> PinholeState:
    """Minimise landmark term + identity, expression and lens priors over everything at once.

    Parameters
    ----------
    model, targets, expression_prior
        As in `facewright.fitting.coordinate_descent.descend`.
    camera_prior : CameraPrior
        Of the focal length.
    start : FitState
        The weak-perspective fit.
    image_size : (height, width)
        The principal point is the picture's centre.
    iterations : int
        Levenberg-Marquardt steps; the contour's correspondences are refreshed before each.

    Returns
    -------
    PinholeState
        The fit.
    """
    intrinsics = Intrinsics.for_image(image_size, camera_prior.focal_length)
    centre = expression_matrix(model.core, start.c) @ model.expression(start.beta)
    motion = rigid_from_weak(start.camera, intrinsics, centre.mean(axis=0))
    state = PinholeState(start.c, start.beta, motion, intrinsics)
    damping = 1e-3
    for _ in range(iterations):
        problem = _Problem(model, targets, expression_prior, camera_prior, state)
        energy = problem.energy(state)
        H, g = problem.quadratic(state)
        for _ in range(4):
            trial = problem.step(state, H, g, damping)
            if trial is not None and problem.energy(trial) < energy:
                state, damping = trial, damping * 0.2
                break
            damping *= 10.0
        else:
            break
    return state


class _Problem:
    """The energy with the contour's correspondences and the points' noise held still."""

    def __init__(
        self,
        model: LandmarkModel,
        targets: Targets,
        expression_prior: ExpressionPrior,
        camera_prior: CameraPrior,
        state: PinholeState,
    ) -> None:
        self.model, self.targets = model, targets
        self.expression_prior, self.camera_prior = expression_prior, camera_prior
        pixels = state.project(model.outline(state.c, state.beta))
        chosen = model.strips.outline(pixels, state.motion.rotation)
        corners = pixels[np.arange(len(chosen)), chosen]
        self.core = model.with_contour(chosen, slide_on_outline(targets.contour, corners))
        self.sigma = noise_px(state.scale, targets.noise_mm, targets.confidence)

    def energy(self, state: PinholeState) -> float:
        """Return the whole energy of a state."""
        points = expression_matrix(self.core, state.c) @ self.model.expression(state.beta)
        lens = np.log(state.intrinsics.focal_x / self.camera_prior.focal_length) / self.camera_prior.spread
        return (
            landmark_energy(state.project(points) - self.targets.pixels, self.sigma)
            + 0.5 * float(state.c @ state.c)
            + self.expression_prior.energy(state.beta)
            + 0.5 * float(lens**2)
        )

    def quadratic(self, state: PinholeState) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Return Gauss-Newton Hessian and gradient in (rotation, translation, log focal, c, beta)."""
        K, n_beta = len(state.c), len(state.beta)
        w_exp = self.model.expression(state.beta)
        A = identity_matrix(self.core, w_exp)
        B = expression_matrix(self.core, state.c)
        points = B @ w_exp
        seen = state.motion.apply(points)
        residual = state.intrinsics.project(seen) - self.targets.pixels
        by_model = pixel_by_point(seen, state.intrinsics) @ state.motion.rotation  # (L, 2, 3)
        J = np.empty((len(points), 2, _N_CAMERA + K + n_beta))
        J[:, :, :6] = pinhole_jacobian(seen, seen - state.motion.translation, state.intrinsics)
        J[:, :, 6] = state.intrinsics.project(seen) - [state.intrinsics.centre_x, state.intrinsics.centre_y]
        J[:, :, 7 : 7 + K] = by_model @ A[1:].transpose(1, 2, 0)
        J[:, :, 7 + K :] = (by_model @ B) @ self.model.mixture.T
        w = np.repeat(robust_weights(residual, self.sigma), 2)
        flat = J.reshape(-1, J.shape[2])
        JW = flat.T * w
        H, g = JW @ flat, JW @ residual.ravel()
        spread2 = self.camera_prior.spread**2
        H[6, 6] += 1.0 / spread2
        g[6] += np.log(state.intrinsics.focal_x / self.camera_prior.focal_length) / spread2
        rows = np.arange(7, 7 + K)
        H[rows, rows] += 1.0
        g[rows] += state.c
        rows = np.arange(7 + K, len(g))
        H[rows, rows] += 1.0 / self.expression_prior.spread**2
        g[rows] += self.expression_prior.gradient(state.beta)
        return H, g

    def step(
        self, state: PinholeState, H: NDArray[np.float64], g: NDArray[np.float64], damping: float
    ) -> PinholeState | None:
        """Return the state after a damped step with beta kept within [0, 1]; None if it left the camera's front."""
        n = _N_CAMERA + len(state.c)
        damped = H + damping * np.diag(np.diag(H))
        # eliminate what has no bounds, minimise over beta in its box, substitute back
        elimination = np.linalg.solve(damped[:n, :n], np.column_stack([damped[:n, n:], g[:n]]))
        S = damped[n:, n:] - damped[n:, :n] @ elimination[:, :-1]
        slope = g[n:] - damped[n:, :n] @ elimination[:, -1]
        beta = minimise_in_box(S, slope - S @ state.beta, state.beta)
        free = -elimination[:, -1] - elimination[:, :-1] @ (beta - state.beta)
        translation = state.motion.translation + free[3:6]
        focal = state.intrinsics.focal_x * float(np.exp(np.clip(free[6], -0.5, 0.5)))
        if translation[2] <= 10.0 or not np.isfinite(free).all():
            return None
        rotation = rotation_from_vector(free[:3]) @ state.motion.rotation
        return PinholeState(
            state.c + free[7:],
            beta,
            RigidMotion(rotation, translation),
            replace(state.intrinsics, focal_x=focal, focal_y=focal),
        )
