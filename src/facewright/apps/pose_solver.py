"""The models of a session, solved together: the same constraints for each of them (Tena et al. 2011, Fig. 7)."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from facewright.errors import TopologyError, ValueRangeError
from facewright.models.region_fit import RegionFitter
from facewright.models.region_model import RegionModel
from facewright.models.region_poser import RegionPoser
from facewright.numeric.check import check_shape


@dataclass(frozen=True, eq=False)
class Gesture:
    """Constraints and where they were solved from: with other weights they can be solved again.

    Parameters
    ----------
    vertices : ndarray of shape (K,), int
    targets : ndarray of shape (K, 3), millimetres
    rest : mapping of str to ndarray of shape (P,)
        c_0 of each model.
    """

    vertices: NDArray[np.int64]
    targets: NDArray[np.float64]
    rest: Mapping[str, NDArray[np.float64]]


class PoseSolver:
    """A region-based model and perhaps a holistic one, with a buffer of posed vertices for each.

    Parameters
    ----------
    model : RegionModel
    holistic : RegionModel, optional
        Of one region, on the same mesh.
    beta, gamma : float
        Weights of eq. 9.
    out : ndarray of shape (N, 3), float32, C order, optional
        The caller's buffer for the region-based model's vertices.

    Raises
    ------
    TopologyError
        If the holistic model is of another mesh.
    ValueRangeError
        If beta or gamma is negative, or the holistic model has several regions.
    """

    def __init__(
        self,
        model: RegionModel,
        holistic: RegionModel | None,
        beta: float,
        gamma: float,
        out: NDArray[np.float32] | None = None,
    ) -> None:
        self.models = {"region": model}
        if holistic is not None:
            if not np.array_equal(holistic.faces, model.faces) or holistic.n_vertices != model.n_vertices:
                raise TopologyError("holistic model must be of the region-based model's mesh, got another mesh.")
            if len(holistic.bases) != 1:
                raise ValueRangeError(f"holistic model must have one region, got {len(holistic.bases)}.")
            self.models["holistic"] = holistic
        # what one drag left shall stay while another point is dragged
        self.posers = {kind: RegionPoser(one, beta, gamma, boundaries="keep") for kind, one in self.models.items()}
        self.positions = {kind: np.zeros((model.n_vertices, 3), np.float32) for kind in self.models}
        if out is not None:
            check_shape("out", out, model.n_vertices, 3)
            if out.dtype != np.float32 or not out.flags.c_contiguous or not out.flags.writeable:
                raise ValueRangeError(f"out must be float32, C-contiguous and writable, got {out.dtype}.")
            self.positions["region"] = out

    def at_rest(self) -> dict[str, NDArray[np.float64]]:
        """Return the coefficients of each model at which its face is nearest to the neutral."""
        return {kind: _at_rest(model) for kind, model in self.models.items()}

    def set_weights(self, beta: float, gamma: float) -> None:
        """Change the weights; factors again where they differ."""
        for poser in self.posers.values():
            if (poser.beta, poser.gamma) != (beta, gamma):
                poser.set_weights(beta, gamma)

    def constrain(self, vertices: NDArray[np.int64]) -> None:
        """Say which vertices the next gestures constrain."""
        for poser in self.posers.values():
            poser.set_constraints(vertices)

    def solve(self, gesture: Gesture) -> dict[str, NDArray[np.float64]]:
        """Return each model's coefficients for a gesture, and leave its vertices in `positions`."""
        return {
            kind: poser.solve(gesture.targets, gesture.rest[kind], self.positions[kind])
            for kind, poser in self.posers.items()
        }

    def place(self, coefficients: Mapping[str, NDArray[np.float64]]) -> None:
        """Bring `positions` to coefficients."""
        for kind, poser in self.posers.items():
            poser.positions(coefficients[kind], self.positions[kind])

    def as_holistic(self, zeta: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return the holistic model's coefficients that come nearest to a pose (P,) of the region-based one."""
        moved = self.posers["region"].positions(zeta) - self.models["region"].neutral
        return np.asarray(RegionFitter(self.models["holistic"], 0.0).fit(moved[None])[0])


def _at_rest(model: RegionModel) -> NDArray[np.float64]:
    lower = np.concatenate([np.zeros(0), *model.lower])
    upper = np.concatenate([np.zeros(0), *model.upper])
    zeta = np.zeros(model.n_coefficients)
    if any(np.abs(mean).max(initial=0.0) > 0 for mean in model.means):
        zeta = RegionFitter(model).fit(np.zeros((1, model.n_vertices, 3)))[0]
    return np.clip(zeta, lower, upper)
