"""Suite `rigging`: 46 personal blendshapes from 20 imperfectly acted expressions, on the skin of simulated people."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from time import perf_counter
from typing import Any

import numpy as np
from numpy.typing import NDArray

from facewright.deform.deformation_transfer import DeformationTransfer
from facewright.deform.example_based_rigging import RigFitter
from facewright.errors import ValueRangeError
from facewright.faces.blendshape_names import coupled_shapes, mirrored_name
from facewright.faces.expressions import EXPRESSION_WEIGHTS, random_expression_weights
from facewright.faces.face import Face
from facewright.faces.simulate import simulate_person
from facewright.mesh.random_field import smooth_random_field

Progress = Callable[[str, int, int], None]

ACTED_SHARE = (0.7, 1.1)
"""An acted weight is the guide's times a factor drawn from this range, for each weight of each pose."""
SPURIOUS_PROBABILITY, SPURIOUS_WEIGHT = 0.05, 0.15
"""A shape that was not asked for is active with this probability, at a weight up to this."""
FITTING_NOISE_MM, FITTING_CORRELATION_MM = 0.25, (15.0, 40.0)
"""Smooth error of every pose's surface, as left by scan fitting."""
N_UNSEEN = 50


@dataclass(frozen=True, eq=False)
class ActedPoses:
    """Poses as captured from an actor, with the weights that were really used."""

    poses: NDArray[np.float64]
    weights: NDArray[np.float64]


def act(
    neutral: NDArray[np.float64],
    deltas: NDArray[np.float64],
    guide: NDArray[np.float64],
    rng: np.random.Generator,
) -> ActedPoses:
    """Simulate an actor who follows guide weights (N, B) imperfectly and a scan fit with a smooth error.

    Parameters
    ----------
    neutral : ndarray of shape (V, 3), millimetres
        The person at rest.
    deltas : ndarray of shape (B, V, 3), millimetres
        The person's blendshapes.
    guide : ndarray of shape (N, B)
        What the actor is asked for; a row of zeros stays at rest.
    rng : numpy.random.Generator
        Source of randomness.
    """
    weights = guide * rng.uniform(*ACTED_SHARE, guide.shape)
    spurious = (rng.random(guide.shape) < SPURIOUS_PROBABILITY) * rng.uniform(0.0, SPURIOUS_WEIGHT, guide.shape)
    asked = guide.any(axis=1, keepdims=True)
    weights = np.where(guide > 0, weights, spurious * asked)
    noise = smooth_random_field(
        neutral, rng.uniform(*FITTING_CORRELATION_MM), FITTING_NOISE_MM, rng, n_fields=len(guide)
    )
    return ActedPoses(neutral + np.tensordot(weights, deltas, 1) + noise, weights)


def run(face: Face, seed: int, progress: Progress | None = None, *, subjects: int = 8) -> dict[str, float]:
    """Measure example-based rigging on simulated people.

    Each person acts the 20 expressions imperfectly (`act`); the rig is recovered with the acted weights unknown and,
    as a bound, known. It is judged on 50 random expressions nobody acted: the true rig and the recovered one are posed
    with the same weights, root mean square over the part ``face`` of the skin, expressions and people.

    Parameters
    ----------
    face : Face
        Its skin is used (11,248 vertices for ICT-FaceKit).
    seed : int
        Seed of people, acting and expressions.
    progress : callable, optional
        Called as progress("rigging", done, total).
    subjects : int
        People; a single one says little, since a person may happen to be close to the generic face.

    Returns
    -------
    dict of str to float
        ``seconds``: 20 poses to 46 shapes of one person, median, factorisation included; ``unseen_rms_mm``;
        ``generic_rms_mm`` for the transferred generic shapes; ``improvement`` = 1 - unseen / generic;
        ``improvement_true_weights``, acted weights known; ``improvement_without_amplitudes``, weights unknown and the
        generic shapes unscaled as in Li et al. 2010; ``left_right_swaps``: shapes of all people that correlate better
        with the truth of the other side; ``worst_person_improvement``; ``vertices``.

    Raises
    ------
    ValueRangeError
        If `subjects` is not positive.
    """
    if subjects < 1:
        raise ValueRangeError(f"subjects must be positive, got {subjects}.")
    skin = face.skin()
    rng = np.random.default_rng(seed)
    names = skin.blendshape_names
    coupled = coupled_shapes(names)
    judged = slice(*skin.topology.parts["face"])
    guide = np.asarray(EXPRESSION_WEIGHTS, dtype=np.float64)
    source = skin.mean_shape.astype(np.float64)
    seconds: list[float] = []
    squares: dict[str, list[float]] = {"generic": [], "unknown": [], "known": [], "unscaled": []}
    swaps = 0
    for done in range(subjects):
        person = simulate_person(skin, rng)
        neutral, truth = person.neutral.astype(np.float64), person.deltas.astype(np.float64)
        transfer = DeformationTransfer(source, neutral, skin.topology.faces)
        generic = transfer.transfer(source + skin.blendshape_deltas) - neutral
        acted = act(neutral, truth, guide, rng)
        unseen = random_expression_weights(rng, N_UNSEEN)
        if not done:  # compiles the kernels, outside the times
            _recover(skin, neutral, generic, acted.poses, guide, coupled)
        start = perf_counter()
        fitter, deltas = _recover(skin, neutral, generic, acted.poses, guide, coupled)
        seconds.append(perf_counter() - start)
        results = {
            "generic": generic,
            "unknown": deltas,
            "known": fitter.fit(acted.poses, acted.weights, weights_known=True).deltas,
            "unscaled": fitter.fit(acted.poses, guide, amplitudes="generic").deltas,
        }
        for key, shapes in results.items():
            squares[key].append(_mean_square_at(unseen, shapes[:, judged] - truth[:, judged]))
        swaps += count_side_swaps(deltas, truth, names)
        if progress is not None:
            progress("rigging", done + 1, subjects)
    rms = {key: float(np.sqrt(np.mean(values))) for key, values in squares.items()}
    each = 1.0 - np.sqrt(np.array(squares["unknown"]) / np.array(squares["generic"]))
    return {
        "vertices": float(len(source)),
        "seconds": float(np.median(seconds)),
        "unseen_rms_mm": rms["unknown"],
        "generic_rms_mm": rms["generic"],
        "improvement": 1.0 - rms["unknown"] / rms["generic"],
        "improvement_true_weights": 1.0 - rms["known"] / rms["generic"],
        "improvement_without_amplitudes": 1.0 - rms["unscaled"] / rms["generic"],
        "worst_person_improvement": float(each.min()),
        "left_right_swaps": float(swaps),
    }


def _recover(
    skin: Face,
    neutral: NDArray[np.float64],
    generic: NDArray[np.float64],
    poses: NDArray[np.float64],
    guide: NDArray[np.float64],
    coupled: list[tuple[int, int]],
) -> tuple[RigFitter, NDArray[np.float64]]:
    fitter = RigFitter(neutral, generic, skin.topology.faces, coupled=coupled)
    return fitter, fitter.fit(poses, guide).deltas


def _mean_square_at(weights: NDArray[np.float64], differences: NDArray[np.float64]) -> float:
    """Return the mean squared vertex error of expressions (N, B) whose shapes differ by (B, V, 3), mm^2."""
    B, V, _ = differences.shape
    flat = differences.reshape(B, -1)
    return float(((weights.T @ weights) * (flat @ flat.T)).sum() / (len(weights) * V))


def count_side_swaps(deltas: NDArray[Any], truth: NDArray[Any], names: tuple[str, ...]) -> int:
    """Count left and right shapes that correlate better with the truth of the opposite side than with their own."""
    swaps = 0
    for i, name in enumerate(names):
        other = mirrored_name(name)
        if other == name or other not in names:
            continue
        shape, own, opposite = deltas[i].ravel(), truth[i].ravel(), truth[names.index(other)].ravel()
        size = max(float(np.linalg.norm(own)), 1e-12), max(float(np.linalg.norm(opposite)), 1e-12)
        swaps += bool(shape @ opposite / size[1] > shape @ own / size[0])
    return swaps
