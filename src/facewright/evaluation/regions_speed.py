"""How long a drag takes: prefactored and updated, beside assembling and solving the dense system each time."""

from __future__ import annotations

import time
from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import cho_factor, cho_solve

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
        microseconds; ``grab_us_N``: setting the constraints and the first of these, as when a vertex is grabbed;
        ``dense_solve_us_N``: assembling the dense system of eq. 10 and solving it, whatever the number of vertices;
        ``dense_us_N`` and ``dense_us_V``: that and multiplying out every position, each time; ``weights_ms``: after a
        change of beta or gamma. Best of rounds.
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

    def grab(target: NDArray[np.float64]) -> None:
        poser.set_constraints(constrained)
        poser.solve(target, rest, out)

    def dense_skin(target: NDArray[np.float64]) -> None:
        moved = system.solve(constrained, target, rest) - model.neutral
        dense_out[:] = driver.weights.rest + follow @ np.einsum("nij,nj->ni", driver.weights.turns, moved)

    with one_blas_thread():
        return {
            f"drag_us_{N}": _best_us(lambda target: poser.solve(target, rest, out), path, _DRAGS),
            f"grab_us_{N}": _best_us(grab, path, 20),
            f"dense_solve_us_{N}": _best_us(
                lambda target: system.coefficients(constrained, target, rest), path, _DENSE_DRAGS
            ),
            f"dense_us_{N}": _best_us(lambda target: system.solve(constrained, target, rest), path, _DENSE_DRAGS),
            f"drag_us_{V}": _best_us(lambda target: driver.positions(poser.solve(target, rest), dense_out), path, 40),
            f"dense_us_{V}": _best_us(dense_skin, path, 2),
            "weights_ms": 1e-3 * _best_us(lambda _: poser.set_weights(beta=BETA), path, 4),
        }


class DenseSystem:
    """Eq. 10 assembled and solved anew for every drag, as the paper states it: the twin of the fast way.

    Which vertices regions share is looked up once; every product of bases is BLAS's, the solution LAPACK's (Cholesky).

    Parameters
    ----------
    model : RegionModel
    """

    def __init__(self, model: RegionModel) -> None:
        self._model = model
        members, offsets = model.regions.members, model.offsets
        self._place = np.full((len(members), model.n_vertices), -1)
        for i, ids in enumerate(members):
            self._place[i, ids] = np.arange(len(ids))
        self._pairs = []
        for i in range(len(members)):
            for k in range(i + 1, len(members)):
                both = np.flatnonzero((self._place[i] >= 0) & (self._place[k] >= 0))
                if len(both):
                    of_i, of_k = self._place[i, both], self._place[k, both]
                    differ = np.concatenate([_rows(model, i, of_i), -_rows(model, k, of_k)])
                    apart = (model.means[i][of_i] - model.means[k][of_k]).ravel()
                    parts = slice(offsets[i], offsets[i + 1]), slice(offsets[k], offsets[k + 1])
                    self._pairs.append((differ, apart, *parts))

    def coefficients(
        self, constrained: NDArray[np.integer], targets: NDArray[np.floating], rest: NDArray[np.float64]
    ) -> NDArray[np.float64]:
        """Assemble the dense system of eq. 10 and return its solution (P,)."""
        model = self._model
        P, offsets = model.n_coefficients, model.offsets
        H = np.zeros((P, P))
        H[np.diag_indices(P)] = GAMMA
        right = GAMMA * rest
        goals = targets - model.neutral[constrained]
        for i, at in enumerate(self._place[:, constrained]):
            held = at >= 0
            if held.any():
                B = _rows(model, i, at[held])
                here = slice(offsets[i], offsets[i + 1])
                H[here, here] += B @ B.T
                right[here] += B @ (goals[held] - model.means[i][at[held]]).ravel()
        for differ, apart, here, there in self._pairs:
            square, pull = BETA * (differ @ differ.T), BETA * (differ @ apart)
            n = here.stop - here.start
            H[here, here] += square[:n, :n]
            H[there, there] += square[n:, n:]
            H[there, here] += square[n:, :n]  # the lower half: Cholesky reads no other
            right[here] -= pull[:n]
            right[there] -= pull[n:]
        factor = cho_factor(H.T, overwrite_a=True, check_finite=False)  # H.T is in LAPACK's order, its upper half full
        return np.asarray(cho_solve(factor, right, check_finite=False))

    def solve(
        self, constrained: NDArray[np.integer], targets: NDArray[np.floating], rest: NDArray[np.float64]
    ) -> NDArray[np.float64]:
        """Return the averaged positions (N, 3), mm, of `coefficients`."""
        model, offsets = self._model, self._model.offsets
        zeta = self.coefficients(constrained, targets, rest)
        total = np.zeros((model.n_vertices, 3))
        for i, ids in enumerate(model.regions.members):
            basis = model.bases[i].reshape(len(model.bases[i]), -1)
            total[ids] += model.means[i] + (zeta[offsets[i] : offsets[i + 1]] @ basis).reshape(-1, 3)
        return np.asarray(model.neutral + total / model.regions.count[:, None])


def _rows(model: RegionModel, region: int, local: NDArray[np.integer]) -> NDArray[np.float64]:
    """Return the basis (P_i, 3 K) at K vertices of a region."""
    basis = model.bases[region]
    return basis[:, local].reshape(len(basis), 3 * len(local))


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
