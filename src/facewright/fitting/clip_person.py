"""One identity, one lens and one set of the detector's habits for a whole clip (FaceWarehouse 4.4)."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from facewright.camera.pinhole import Intrinsics, rigid_from_weak
from facewright.camera.weak_perspective import estimate_weak_perspective
from facewright.fitting.dense_model import CENTRE, N_POSE, ClipPerson, DenseModel, FramePose
from facewright.fitting.energies.coefficient_terms import CoefficientTerms
from facewright.fitting.perspective_refinement import CameraPrior, bounded_step
from facewright.fitting.small_algebra import solve_spd
from facewright.landmarks.dense import head_plane

#: Rounds of the shared unknowns, and steps of each frame in between.
_ROUNDS, _FRAME_STEPS = 8, 2
#: A round that lowers the energy by less is the last.
_TOLERANCE = 0.5
_INSIDE = 1e-6


@dataclass(frozen=True, eq=False)
class FrameState:
    """Where a frame's fit is.

    Parameters
    ----------
    pose : FramePose
        Head and lens.
    beta : ndarray of shape (B,)
        FACS coefficients.
    """

    pose: FramePose
    beta: NDArray[np.float64]


#: Something else known of a frame: Gauss-Newton Hessian and gradient in (pose step, beta) at a state.
Extra = Callable[[FrameState], tuple[NDArray[np.float64], NDArray[np.float64]]]


@dataclass(frozen=True, eq=False)
class KeyFrame:
    """What is seen in a frame.

    Parameters
    ----------
    found : ndarray of shape (N, 2), pixels
        The model's points.
    terms : CoefficientTerms
        What else is known of its coefficients.
    """

    found: NDArray[np.float64]
    terms: CoefficientTerms


def start_state(
    model: DenseModel, found: NDArray[np.float64], person: ClipPerson, intrinsics: Intrinsics
) -> FrameState:
    """Return a frame's points under the pose that they give, the face at rest."""
    pixels, points = found, person.neutral
    for _ in range(2):  # once more with the detector's departure taken away
        weak = estimate_weak_perspective(points, pixels, iterations=4)
        pixels = found - person.departure @ np.linalg.inv(head_plane(weak.rotation, weak.scale)).T
    return FrameState(FramePose(rigid_from_weak(weak, intrinsics, CENTRE), intrinsics), np.zeros(model.n_shapes))


def frame_energy(
    model: DenseModel, found: NDArray[np.float64], person: ClipPerson, terms: CoefficientTerms, state: FrameState
) -> float:
    """Return a frame's energy: whitened residual and expression prior."""
    residual = model.residual(found, person, state.pose, state.beta)
    return 0.5 * float(residual @ residual) + terms.energy(state.beta)


def frame_quadratic(
    model: DenseModel,
    found: NDArray[np.float64],
    person: ClipPerson,
    terms: CoefficientTerms,
    state: FrameState,
    extra: Extra | None = None,
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return Gauss-Newton Hessian and gradient of a frame's energy in (pose step, beta)."""
    system = model.system(found, person, state.pose, state.beta)
    H, g = system.by_own.T @ system.by_own, system.by_own.T @ system.residual
    H[N_POSE:, N_POSE:] += terms.hessian
    g[N_POSE:] += terms.gradient(state.beta)
    if extra is not None:
        more = extra(state)
        H += more[0]
        g += more[1]
    H[np.diag_indices(N_POSE)] += 1e-9 * np.diag(H)[:N_POSE]
    return H, g


def fit_frame(
    model: DenseModel,
    found: NDArray[np.float64],
    person: ClipPerson,
    terms: CoefficientTerms,
    start: FrameState,
    iterations: int,
    extra: Extra | None = None,
) -> FrameState:
    """Return a frame's pose and coefficients for a known person, by Gauss-Newton within bounds."""
    state = start
    for _ in range(iterations):
        H, g = frame_quadratic(model, found, person, terms, state, extra)
        step, beta = bounded_step(H, g, N_POSE, state.beta, 0.0)
        if not np.isfinite(step).all():
            return state
        # a step that would turn the head by more than a radian starts from far away: go part of the way
        share = min(1.0, 0.7 / max(float(np.abs(step[:3]).max()), float(abs(step[5])), 1e-12))
        state = FrameState(state.pose.moved(share * step), state.beta + share * (beta - state.beta))
    return state


class ClipPersonFitter:
    """Finds what the frames of a clip share from a few of them that are unlike one another.

    Parameters
    ----------
    model : DenseModel
        The model at the detector's points.
    lens : CameraPrior
        Of the focal length.
    """

    def __init__(self, model: DenseModel, lens: CameraPrior) -> None:
        self.model, self.lens = model, lens

    def fit(
        self, frames: Sequence[KeyFrame], image_size: tuple[int, int]
    ) -> tuple[ClipPerson, Intrinsics, list[FrameState]]:
        """Minimise the energies of all frames, with the priors, over one person, one lens and each frame's own.

        Eq. (15) for any number of pictures, of which only identity and lens are the same.

        Parameters
        ----------
        frames : sequence of KeyFrame
            The frames.
        image_size : (height, width)
            The principal point is the picture's centre.
        """
        model = self.model
        intrinsics = Intrinsics.for_image(image_size, self.lens.focal_length)
        person = model.person(np.zeros(model.n_identity), np.zeros(model.n_modes))
        states = [start_state(model, frame.found, person, intrinsics) for frame in frames]
        states = self._frames(frames, person, states, 4)
        energy = self._energy(frames, person, states)
        for _ in range(_ROUNDS):
            step = self._shared_step(frames, person, states)
            for share in (1.0, 0.5, 0.25, 0.1):
                trial, moved = self._moved(person, states, share * step)
                moved = self._frames(frames, trial, moved, _FRAME_STEPS)
                lower = self._energy(frames, trial, moved)
                if lower < energy:
                    break
            else:
                break
            person, states = trial, moved
            gained, energy = energy - lower, lower
            if gained < _TOLERANCE:
                break
        return person, states[0].pose.intrinsics, states

    def _frames(
        self, frames: Sequence[KeyFrame], person: ClipPerson, states: list[FrameState], steps: int
    ) -> list[FrameState]:
        return [
            fit_frame(self.model, frame.found, person, frame.terms, state, steps)
            for frame, state in zip(frames, states, strict=True)
        ]

    def _energy(self, frames: Sequence[KeyFrame], person: ClipPerson, states: list[FrameState]) -> float:
        total = sum(
            frame_energy(self.model, frame.found, person, frame.terms, state)
            for frame, state in zip(frames, states, strict=True)
        )
        lens = np.log(states[0].pose.intrinsics.focal_x / self.lens.focal_length) / self.lens.spread
        return total + 0.5 * float(person.c @ person.c + person.q @ person.q + lens**2)

    def _shared_step(
        self, frames: Sequence[KeyFrame], person: ClipPerson, states: list[FrameState]
    ) -> NDArray[np.float64]:
        """Return the step of (c, q, log focal); poses and coefficients off their bounds follow to first order."""
        n = self.model.n_identity + self.model.n_modes + 1
        H, g = np.eye(n), np.concatenate([person.c, person.q, [0.0]])
        H[-1, -1] = 1.0 / self.lens.spread**2
        g[-1] = np.log(states[0].pose.intrinsics.focal_x / self.lens.focal_length) / self.lens.spread**2
        for frame, state in zip(frames, states, strict=True):
            system = self.model.system(frame.found, person, state.pose, state.beta, shared=True)
            assert system.by_shared is not None
            inside = (state.beta > _INSIDE) & (state.beta < 1.0 - _INSIDE)
            follow = np.concatenate([np.arange(N_POSE), N_POSE + np.flatnonzero(inside)])
            own, shared = system.by_own[:, follow], system.by_shared
            block, slope = own.T @ own, own.T @ system.residual
            block[N_POSE:, N_POSE:] += frame.terms.hessian[np.ix_(inside, inside)]
            slope[N_POSE:] += frame.terms.gradient(state.beta)[inside]
            coupling = own.T @ shared
            solved = solve_spd(block, np.ascontiguousarray(np.column_stack([coupling, slope])))
            H += shared.T @ shared - coupling.T @ solved[:, :-1]
            g += shared.T @ system.residual - coupling.T @ solved[:, -1]
        return -np.linalg.solve(H, g)

    def _moved(
        self, person: ClipPerson, states: list[FrameState], step: NDArray[np.float64]
    ) -> tuple[ClipPerson, list[FrameState]]:
        I = self.model.n_identity
        log_focal = float(np.clip(step[-1], -0.5, 0.5))
        trial = self.model.person(person.c + step[:I], person.q + step[I:-1])
        return trial, [FrameState(state.pose.zoomed(log_focal), state.beta) for state in states]


def spread_frames(model: DenseModel, founds: NDArray[np.float64], n: int, intrinsics: Intrinsics) -> NDArray[np.intp]:
    """Choose up to n frames that are unlike one another: the most usual one, then always the farthest.

    Parameters
    ----------
    model : DenseModel
        The model.
    founds : ndarray of shape (T, N, 2), pixels
        The model's points of the frames to choose from.
    n : int
        How many.
    intrinsics : Intrinsics
        The camera.

    Returns
    -------
    ndarray of int
        Rows of `founds`, sorted.
    """
    person = model.person(np.zeros(model.n_identity), np.zeros(model.n_modes))
    marks = []
    for found in founds:
        state = start_state(model, found, person, intrinsics)
        # half a radian of turn counts as much as the face's own changes do
        turn = 2.0 * np.sqrt(len(model.points.whitening)) * state.pose.motion.rotation[:, 2]
        marks.append(np.concatenate([model.residual(found, person, state.pose, state.beta), turn]))
    features = np.array(marks)
    distance = np.linalg.norm(features - np.median(features, axis=0), axis=1)
    # a tenth of the frames may be misread: they are no examples
    usable = distance <= np.quantile(distance, 0.9)
    chosen = [int(np.argmin(distance))]
    nearest = np.full(len(features), np.inf)
    while len(chosen) < min(n, int(usable.sum())):
        nearest = np.minimum(nearest, np.linalg.norm(features - features[chosen[-1]], axis=1))
        nearest[~usable] = -1.0
        chosen.append(int(np.argmax(nearest)))
    return np.unique(chosen)
