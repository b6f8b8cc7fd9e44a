"""How long a drag takes: prefactored and updated, beside assembling and solving the dense system each time."""

from __future__ import annotations

import time
from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from facewright.evaluation.regions_behaviour import BETA, GAMMA
from facewright.faces.character_places import character_places
from facewright.faces.drive_character import bind_character
from facewright.faces.face import Face
from facewright.models.dense_drive import DenseDriver
from facewright.models.region_model import RegionModel
from facewright.models.region_poser import RegionPoser
from facewright.numeric.threads import one_blas_thread

#: Constraints of the measured pose: one that moves, and pins.
_PINS = 3
_ROUNDS, _DRAGS, _DENSE_DRAGS = 15, 200, 4


def measure_speed(model: RegionModel, face: Face, constrained: NDArray[np.integer]) -> dict[str, float]:
    """Time drags on one core.

    Parameters
    ----------
    model : RegionModel
        Of N vertices, for this face.
    face : Face
        Its skin of V vertices is the dense character.
    constrained : ndarray of shape (K,), int
        Vertices: the first is dragged, the others are pinned.

    Returns
    -------
    dict of str to float
        ``drag_us_N`` and ``drag_us_V``: from a new place of the dragged vertex to all positions in the caller's buffer,
        microseconds; ``dense_us_N`` and ``dense_us_V``: the same by assembling the dense system, solving it and
        multiplying out every position each time; ``weights_ms``: after a change of beta or gamma. Best of rounds.
    """
    poser = RegionPoser(model, BETA, GAMMA)
    poser.set_constraints(constrained)
    skin = face.skin()
    driver = DenseDriver(model, bind_character(model, skin, character_places(model, skin)))
    N, V = model.n_vertices, driver.n_vertices
    path = _path(model.neutral[constrained].astype(np.float64))
    rest = np.zeros(model.n_coefficients)
    out, dense_out = np.empty((N, 3), np.float32), np.empty((V, 3), np.float32)
    system = DenseSystem(model)
    follow = driver.weights.follow.toarray()

    def dense_skin(target: NDArray[np.float64]) -> None:
        moved = system.solve(constrained, target, rest) - model.neutral
        dense_out[:] = driver.weights.rest + follow @ np.einsum("nij,nj->ni", driver.weights.turns, moved)

    with one_blas_thread():
        return {
            f"drag_us_{N}": _best_us(lambda target: poser.solve(target, rest, out), path, _DRAGS),
            f"dense_us_{N}": _best_us(lambda target: system.solve(constrained, target, rest), path, _DENSE_DRAGS),
            f"drag_us_{V}": _best_us(lambda target: driver.positions(poser.solve(target, rest), dense_out), path, 40),
            f"dense_us_{V}": _best_us(dense_skin, path, 2),
            "weights_ms": 1e-3 * _best_us(lambda _: poser.set_weights(beta=BETA), path, 4),
        }


class DenseSystem:
    """Eq. 10 without any precomputation, as the paper states it: the twin that the fast way is held against.

    Parameters
    ----------
    model : RegionModel
    """

    def __init__(self, model: RegionModel) -> None:
        self._model = model

    def solve(
        self, constrained: NDArray[np.integer], targets: NDArray[np.floating], rest: NDArray[np.float64]
    ) -> NDArray[np.float64]:
        """Assemble the dense system of eq. 10, solve it, and return the averaged positions (N, 3), mm."""
        model = self._model
        P, offsets, members = model.n_coefficients, model.offsets, model.regions.members
        H = GAMMA * np.eye(P)
        right = GAMMA * rest
        for i, ids in enumerate(members):
            _, at, which = np.intersect1d(ids, constrained, return_indices=True)
            B = model.bases[i][:, at].reshape(len(model.bases[i]), -1)
            here = slice(offsets[i], offsets[i + 1])
            H[here, here] += B @ B.T
            right[here] += B @ (targets[which] - model.neutral[constrained[which]] - model.means[i][at]).ravel()
            for k in range(i + 1, len(members)):
                _, of_i, of_k = np.intersect1d(ids, members[k], return_indices=True)
                if len(of_i):
                    Bi = model.bases[i][:, of_i].reshape(len(model.bases[i]), -1)
                    Bk = model.bases[k][:, of_k].reshape(len(model.bases[k]), -1)
                    there = slice(offsets[k], offsets[k + 1])
                    apart = (model.means[i][of_i] - model.means[k][of_k]).ravel()
                    H[here, here] += BETA * Bi @ Bi.T
                    H[there, there] += BETA * Bk @ Bk.T
                    H[here, there] -= BETA * Bi @ Bk.T
                    H[there, here] -= BETA * Bk @ Bi.T
                    right[here] -= BETA * Bi @ apart
                    right[there] += BETA * Bk @ apart
        zeta = np.linalg.solve(H, right)
        total = np.zeros((model.n_vertices, 3))
        for i, ids in enumerate(members):
            total[ids] += model.means[i] + np.tensordot(zeta[offsets[i] : offsets[i + 1]], model.bases[i], 1)
        return np.asarray(model.neutral + total / model.regions.count[:, None])


def _path(start: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return targets (S, K, 3): the first constraint goes around a circle of 4 mm, the others stay."""
    turn = np.linspace(0.0, 2.0 * np.pi, 64, endpoint=False)
    path = np.repeat(start[None], len(turn), axis=0)
    path[:, 0] += 4.0 * np.stack([np.cos(turn), np.sin(turn), 0.0 * turn], axis=1)
    return path


def _best_us(drag: Callable[[NDArray[np.float64]], object], path: NDArray[np.float64], count: int) -> float:
    """Return the least mean time of `count` drags, microseconds of processor time."""
    best = np.inf
    for _ in range(_ROUNDS):
        start = time.thread_time()
        for k in range(count):
            drag(path[k % len(path)])
        best = min(best, (time.thread_time() - start) / count)
    return 1e6 * best
