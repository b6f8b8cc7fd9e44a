"""Full-perspective refinement: camera, identity and expression together, by Gauss-Newton within bounds."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from facewright.camera.pinhole import Intrinsics, RigidMotion, pixel_by_point, rigid_from_weak
from facewright.camera.rotation import rotation_from_vector
from facewright.camera.weak_perspective import WeakPerspective
from facewright.fitting.box_quadratic import minimise_in_box
from facewright.fitting.coordinate_descent import FitState, Targets
from facewright.fitting.energies.expression_prior import ExpressionPrior
from facewright.fitting.energies.landmark_term import landmark_energy, noise_px, robust_weights
from facewright.fitting.landmark_model import LandmarkModel, PersonPoints
from facewright.fitting.small_algebra import normal_equations, solve_spd

N_CAMERA = 7  # rotation, pixel of the face's middle, logarithms of scale and focal length
#: Contour points tell where the outline runs, not which point of it they are: weight of their residual along it.
_ALONG_CONTOUR = 0.2


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
    person, beta : PersonPoints and ndarray of shape (B,)
        As in `FitState`.
    motion : RigidMotion
        camera_from_model.
    intrinsics : Intrinsics
        Of equal focal lengths.
    """

    person: PersonPoints
    beta: NDArray[np.float64]
    motion: RigidMotion
    intrinsics: Intrinsics

    @property
    def c(self) -> NDArray[np.float64]:
        """Identity, in standard deviations along the prior's axes, (K,)."""
        return self.person.c

    def scale(self, point: NDArray[np.float64]) -> float:
        """Pixels per millimetre at a model point (3,)."""
        return self.intrinsics.focal_x / float(self.motion.apply(point)[2])

    def project(self, points: NDArray[np.floating]) -> NDArray[np.float64]:
        """Project model points (..., 3) to pixels (..., 2)."""
        return self.intrinsics.project(self.motion.apply(points))

    def weak_perspective(self, point: NDArray[np.float64]) -> WeakPerspective:
        """Return the weak-perspective camera that agrees with this one at a model point (3,)."""
        scale, rotation = self.scale(point), self.motion.rotation
        return WeakPerspective(scale, rotation, self.project(point) - scale * rotation[:2] @ point)


def refine(
    model: LandmarkModel,
    targets: Targets,
    expression_prior: ExpressionPrior,
    camera_prior: CameraPrior,
    start: FitState,
    image_size: tuple[int, int],
    iterations: int,
    tolerance: float = 0.5,
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
        At most so many Levenberg-Marquardt steps; the contour's correspondences are refreshed before each.
    tolerance : float
        Stop when a step lowers the energy (a negative log likelihood) by less.

    Returns
    -------
    PinholeState
        The fit.
    """
    w_exp = model.expression(start.beta)
    centre = start.person.candidates(w_exp).mean(axis=0)
    intrinsics = Intrinsics.for_image(image_size, camera_prior.focal_length)
    state = PinholeState(start.person, start.beta, rigid_from_weak(start.camera, intrinsics, centre), intrinsics)
    damping = 0.0
    for _ in range(iterations):
        problem = PinholeProblem(model, targets, expression_prior, camera_prior, centre, state)
        energy = problem.energy(state)
        H, g = problem.quadratic(state)
        for _ in range(6):
            trial = problem.step(state, H, g, damping)
            if trial is not None and (lower := problem.energy(trial)) < energy:
                break
            damping = max(10.0 * damping, 1e-3)
        else:
            break
        state, damping = trial, 0.1 * damping if damping > 1e-5 else 0.0
        if energy - lower < tolerance:
            break
    return state


class PinholeProblem:
    """The energy with the contour's correspondences and the points' noise held still.

    The camera moves in terms that the picture determines one by one: rotation about the face's middle m, the
    pixel of m, the logarithm of the scale f / z there, and the logarithm of f at that scale, which is the weak one.
    """

    def __init__(
        self,
        model: LandmarkModel,
        targets: Targets,
        expression_prior: ExpressionPrior,
        camera_prior: CameraPrior,
        centre: NDArray[np.float64],
        state: PinholeState,
    ) -> None:
        self.model, self.targets, self.centre = model, targets, centre
        self.expression_prior, self.camera_prior = expression_prior, camera_prior
        pixels = state.project(state.person.candidates(model.expression(state.beta)))
        self.places = model.place_contour(pixels, state.motion.rotation, targets.contour)
        self.sigma = noise_px(state.scale(centre), targets.noise_mm, targets.confidence)
        normal = self.places.normal
        frames = np.tile(np.eye(2), (len(self.sigma), 1, 1))
        frames[targets.n_fixed :, 0] = normal
        frames[targets.n_fixed :, 1] = _ALONG_CONTOUR * np.stack([-normal[:, 1], normal[:, 0]], axis=1)
        self.frames = frames

    def residuals(self, state: PinholeState, points: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return (L, 2): for contour points across and, little weighted, along the outline."""
        return np.einsum("lrc,lc->lr", self.frames, state.project(points) - self.targets.pixels)

    def energy(self, state: PinholeState) -> float:
        """Return the whole energy of a state."""
        points = state.person.expression_matrix(self.places) @ self.model.expression(state.beta)
        lens = np.log(state.intrinsics.focal_x / self.camera_prior.focal_length) / self.camera_prior.spread
        return (
            landmark_energy(self.residuals(state, points), self.sigma)
            + 0.5 * float(state.c @ state.c)
            + self.expression_prior.energy(state.beta)
            + 0.5 * float(lens**2)
        )

    def quadratic(self, state: PinholeState) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Return Gauss-Newton Hessian and gradient in (rotation, pixel, log scale, log focal, c, beta)."""
        K, n_beta = len(state.c), len(state.beta)
        w_exp = self.model.expression(state.beta)
        A = self.model.identity_matrix(w_exp, self.places)
        B = state.person.expression_matrix(self.places)
        points = B @ w_exp
        middle = state.motion.apply(self.centre)
        seen = state.motion.apply(points)
        by_camera = self.frames @ pixel_by_point(seen, state.intrinsics)  # (L, 2, 3)
        by_model = by_camera @ state.motion.rotation
        J = np.empty((len(points), 2, N_CAMERA + K + n_beta))
        arms = seen - middle
        J[:, :, 0] = by_camera[:, :, 2] * arms[:, 1, None] - by_camera[:, :, 1] * arms[:, 2, None]
        J[:, :, 1] = by_camera[:, :, 0] * arms[:, 2, None] - by_camera[:, :, 2] * arms[:, 0, None]
        J[:, :, 2] = by_camera[:, :, 1] * arms[:, 0, None] - by_camera[:, :, 0] * arms[:, 1, None]
        J[:, :, 3:5] = by_camera[:, :, :2] / state.scale(self.centre)
        J[:, :, 5] = -by_camera @ middle
        from_centre = state.intrinsics.project(seen) - [state.intrinsics.centre_x, state.intrinsics.centre_y]
        J[:, :, 6] = np.einsum("lrc,lc->lr", self.frames, from_centre) + by_camera[:, :, 2] * middle[2]
        J[:, :, 7 : 7 + K] = by_model @ A[1:].transpose(1, 2, 0)
        J[:, :, 7 + K :] = (by_model @ B) @ self.model.mixture.T
        residual = self.residuals(state, points)
        w = np.repeat(robust_weights(residual, self.sigma), 2)
        flat = J.reshape(-1, J.shape[2])
        H, g = normal_equations(flat, w, residual.ravel())
        self._add_priors(H, g, state)
        return H, g

    def _add_priors(self, H: NDArray[np.float64], g: NDArray[np.float64], state: PinholeState) -> None:
        spread2 = self.camera_prior.spread**2
        H[6, 6] += 1.0 / spread2
        g[6] += np.log(state.intrinsics.focal_x / self.camera_prior.focal_length) / spread2
        rows = np.arange(N_CAMERA, N_CAMERA + len(state.c))
        H[rows, rows] += 1.0
        g[rows] += state.c
        rows = np.arange(N_CAMERA + len(state.c), len(g))
        H[rows, rows] += 1.0 / self.expression_prior.spread**2
        g[rows] += self.expression_prior.gradient(state.beta)

    def step(
        self, state: PinholeState, H: NDArray[np.float64], g: NDArray[np.float64], damping: float
    ) -> PinholeState | None:
        """Return the state after a damped step with beta kept within [0, 1]; None if it is absurd."""
        free, beta = bounded_step(H, g, N_CAMERA + len(state.c), state.beta, damping)
        return self.moved(state, free[:N_CAMERA], free[N_CAMERA:], beta)

    def moved(
        self,
        state: PinholeState,
        camera: NDArray[np.float64],
        identity: NDArray[np.float64] | None,
        beta: NDArray[np.float64],
    ) -> PinholeState | None:
        """Return the state with its camera and identity moved by a step (None leaves it) and beta set.

        None if the camera's step is absurd.
        """
        if not np.isfinite(camera).all() or np.abs(camera[:3]).max() > 1.0 or np.abs(camera[5:7]).max() > 1.0:
            return None
        if identity is not None and not np.isfinite(identity).all():
            return None
        middle = state.motion.apply(self.centre)
        focal = state.intrinsics.focal_x * float(np.exp(camera[6]))
        moved = middle + np.array([*(camera[3:5] / state.scale(self.centre)), 0.0])
        moved *= np.exp(-camera[5])
        moved[2] *= np.exp(camera[6])
        rotation = rotation_from_vector(camera[:3]) @ state.motion.rotation
        return PinholeState(
            state.person if identity is None else self.model.person(state.c + identity),
            beta,
            RigidMotion(rotation, moved - rotation @ self.centre),
            replace(state.intrinsics, focal_x=focal, focal_y=focal),
        )


def bounded_step(
    H: NDArray[np.float64], g: NDArray[np.float64], n_free: int, beta: NDArray[np.float64], damping: float
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Minimise a quadratic in a step of n free unknowns and of beta, whose end stays in [0, 1].

    Parameters
    ----------
    H, g : ndarray of shape (n + B, n + B) and (n + B,)
        Hessian and gradient, free unknowns first.
    n_free : int
        n.
    beta : ndarray of shape (B,)
        Where beta is.
    damping : float
        Of Levenberg and Marquardt.

    Returns
    -------
    step : ndarray of shape (n,)
        Of the free unknowns; NaN where the Hessian is not definite.
    beta : ndarray of shape (B,)
        Where beta ends.
    """
    n = n_free
    damped = H + damping * np.diag(np.diag(H))
    # eliminate what has no bounds, minimise over beta in its box, substitute back
    elimination = solve_spd(
        np.ascontiguousarray(damped[:n, :n]), np.ascontiguousarray(np.column_stack([damped[:n, n:], g[:n]]))
    )
    S = damped[n:, n:] - damped[n:, :n] @ elimination[:, :-1]
    slope = g[n:] - damped[n:, :n] @ elimination[:, -1]
    end = minimise_in_box(S, slope - S @ beta, beta)
    return -elimination[:, -1] - elimination[:, :-1] @ (end - beta), end
