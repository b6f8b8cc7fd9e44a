"""One identity for several pictures of a person (FaceWarehouse 4.2, eq. 15-16)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from facewright.errors import ShapeError, ValueRangeError
from facewright.fitting.image import PhotoFit, PhotoFitOptions, PhotoFitter, PhotoStart
from facewright.fitting.landmark_model import LandmarkModel
from facewright.fitting.perspective_refinement import (
    N_CAMERA,
    PinholeProblem,
    PinholeState,
    bounded_step,
    refine,
)
from facewright.fitting.small_algebra import solve_spd
from facewright.landmarks.points import Landmarks
from facewright.models.bilinear import BilinearModel

#: Rounds of identity and expression; the paper says that three are enough.
_ROUNDS = 6
#: Steps of camera and expression in each round.
_FRAME_STEPS = 3
#: A round that lowers the energy (a negative log likelihood) by less is the last.
_TOLERANCE = 0.1
#: A coefficient this far inside its bounds follows the identity.
_INSIDE = 1e-6


class JointFitter:
    """Fits several pictures of one person with one identity; keeps what does not depend on the pictures.

    Parameters
    ----------
    model : BilinearModel
        The model; its topology must mark the scheme's landmarks and the jaw line.
    scheme : str
        Landmark scheme that is fitted to.

    Raises
    ------
    TopologyError
        If the topology does not mark the landmarks.
    ValueRangeError
        If the scheme is unknown.
    """

    def __init__(self, model: BilinearModel, scheme: str = "fw74") -> None:
        self.model = model
        self._single = PhotoFitter(model, scheme)

    def fit(
        self,
        landmarks: Sequence[Landmarks],
        image_sizes: Sequence[tuple[int, int]],
        options: PhotoFitOptions | Sequence[PhotoFitOptions] | None = None,
    ) -> list[PhotoFit]:
        """Fit one person to several pictures.

        Parameters
        ----------
        landmarks : sequence of Landmarks
            Of the J pictures.
        image_sizes : sequence of (height, width)
            Sizes of the pictures, pixels.
        options : PhotoFitOptions or sequence of them, optional
            For all pictures, or one each (where focal lengths differ); defaults where absent.

        Returns
        -------
        list of PhotoFit
            One each, with equal `identity_weights`: V_j of eq. (16). Expression, pose and camera are each picture's
            own.

        Raises
        ------
        ShapeError
            If the sequences are not equally long.
        ValueRangeError
            If there is no picture, or landmarks are of a scheme that cannot be converted.
        DegenerateError
            If too few landmarks of a picture are present, or they lie in one spot.
        """
        n = len(landmarks)
        if n == 0:
            raise ValueRangeError("landmarks must be of at least one picture, got none.")
        own = [options or PhotoFitOptions()] * n if not isinstance(options, Sequence) else list(options)
        if len(image_sizes) != n or len(own) != n:
            raise ShapeError(
                f"landmarks, image_sizes and options must be of as many pictures, got {n}, {len(image_sizes)} "
                f"and {len(own)}."
            )
        starts = [self._single.start(*picture) for picture in zip(landmarks, image_sizes, own, strict=True)]
        small = self._single.landmark_model
        pictures = [_Picture(small, start, option.refinements) for start, option in zip(starts, own, strict=True)]
        if n > 1:
            _unify(pictures)
        return [
            self._single.finish(start, picture.state, option.perspective)
            for start, picture, option in zip(starts, pictures, own, strict=True)
        ]


def fit_jointly(
    model: BilinearModel,
    landmarks: Sequence[Landmarks],
    image_sizes: Sequence[tuple[int, int]],
    options: PhotoFitOptions | Sequence[PhotoFitOptions] | None = None,
) -> list[PhotoFit]:
    """Fit one person to several pictures; one line over `JointFitter`."""
    return JointFitter(model).fit(landmarks, image_sizes, options)


class _Picture:
    """One picture's part of eq. (15); it starts from the picture's own fit."""

    def __init__(self, small: LandmarkModel, start: PhotoStart, refinements: int) -> None:
        self.small, self.start = small, start
        self.state = refine(
            small, start.targets, start.expression_prior, start.lens, start.state, start.image_size, refinements
        )

    def problem(self, state: PinholeState) -> PinholeProblem:
        """Return the energy near a state, the contour's correspondences refreshed."""
        start = self.start
        centre = state.person.candidates(self.small.expression(state.beta)).mean(axis=0)
        return PinholeProblem(self.small, start.targets, start.expression_prior, start.lens, centre, state)

    def energy(self, state: PinholeState) -> float:
        """Return the picture's energy without the identity's prior, which all pictures share."""
        return self.problem(state).energy(state) - 0.5 * float(state.c @ state.c)

    def with_person(self, c: NDArray[np.float64]) -> PinholeState:
        """Return the state with another identity, camera and expression adapted to it."""
        state = replace(self.state, person=self.small.person(c))
        camera = np.arange(N_CAMERA)
        damping = 0.0
        for _ in range(_FRAME_STEPS):
            problem = self.problem(state)
            before = problem.energy(state)
            H, g = problem.quadratic(state)
            kept = np.concatenate([camera, np.arange(N_CAMERA + len(c), len(g))])
            step, beta = bounded_step(H[np.ix_(kept, kept)], g[kept], N_CAMERA, state.beta, damping)
            trial = problem.moved(state, step, None, beta)
            if trial is None or problem.energy(trial) > before:
                damping = max(10.0 * damping, 1e-2)
                continue
            state = trial
        return state

    def identity_part(self) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Return Hessian (K, K) and gradient (K,) of the picture's energy by the identity, without its prior.

        The paper holds pose and expression still meanwhile; here the camera, and coefficients that are not at a
        bound, follow the identity to first order, so that few rounds are enough.
        """
        problem = self.problem(self.state)
        H, g = problem.quadratic(self.state)
        K = len(self.state.c)
        rows = np.arange(N_CAMERA, N_CAMERA + K)
        H[rows, rows] -= 1.0
        g[rows] -= self.state.c
        inside = (self.state.beta > _INSIDE) & (self.state.beta < 1.0 - _INSIDE)
        follow = np.concatenate([np.arange(N_CAMERA), N_CAMERA + K + np.flatnonzero(inside)])
        own = np.ascontiguousarray(H[np.ix_(follow, follow)])
        coupling = H[np.ix_(follow, rows)]
        solved = solve_spd(own, np.ascontiguousarray(np.column_stack([coupling, g[follow]])))
        return H[np.ix_(rows, rows)] - coupling.T @ solved[:, :-1], g[rows] - coupling.T @ solved[:, -1]


def _unify(pictures: list[_Picture]) -> None:
    """Minimise eq. (15), with the priors, over one identity and each picture's camera and expression."""
    c = np.mean([picture.state.c for picture in pictures], axis=0)
    for picture in pictures:
        picture.state = picture.with_person(c)
    energy = _energy(pictures, [picture.state for picture in pictures], c)
    for _ in range(_ROUNDS):
        H, g = np.eye(len(c)), c.copy()  # the prior |c|^2 / 2, once
        for picture in pictures:
            part = picture.identity_part()
            H += part[0]
            g += part[1]
        step = -solve_spd(np.ascontiguousarray(H), np.ascontiguousarray(g[:, None]))[:, 0]
        if not np.isfinite(step).all():
            return
        for share in (1.0, 0.5, 0.25, 0.1):
            states = [picture.with_person(c + share * step) for picture in pictures]  # w_exp-j again, w_id fixed
            lower = _energy(pictures, states, c + share * step)
            if lower < energy:
                break
        else:
            return
        c = c + share * step
        for picture, state in zip(pictures, states, strict=True):
            picture.state = state
        gained, energy = energy - lower, lower
        if gained < _TOLERANCE:
            return


def _energy(pictures: list[_Picture], states: list[PinholeState], c: NDArray[np.float64]) -> float:
    total = sum(picture.energy(state) for picture, state in zip(pictures, states, strict=True))
    return 0.5 * float(c @ c) + total
