"""The bilinear model at the few vertices that a photo is fitted with: landmarks and contour candidates."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from facewright.errors import TopologyError
from facewright.fitting.energies.identity_prior import IdentityPrior
from facewright.landmarks.contour import ContourStrips, Sliding, build_contour_strips
from facewright.landmarks.scheme import LandmarkScheme
from facewright.models.bilinear import BilinearModel


@dataclass(frozen=True, eq=False)
class LandmarkModel:
    """Small cores, whitened along identity: positions are (mean + axes c) x2, w_exp x3.

    Parameters
    ----------
    fixed : ndarray of int32
        Landmarks of the scheme that have a vertex, P of them.
    sliding : ndarray of int32
        Landmarks that slide along the contour, C of them.
    core : ndarray of shape (1 + K, P, 3, E), float64
        Core at the fixed landmarks; slice 0 is the mean identity, slice 1 + k identity axis k.
    strip_core : ndarray of shape (1 + K, N, 3, E), float32
        The same at the N different contour candidates.
    strips : ContourStrips
        Candidates; `vertices` index the N candidates here.
    mixture : ndarray of shape (B, E)
        u_i - u_0: how FACS coefficients move w_exp (eq. 17).
    neutral : ndarray of shape (E,)
        u_0.
    """

    fixed: NDArray[np.int32]
    sliding: NDArray[np.int32]
    core: NDArray[np.float64]
    strip_core: NDArray[np.float32]
    strips: ContourStrips
    mixture: NDArray[np.float64]
    neutral: NDArray[np.float64]

    @classmethod
    def of(cls, model: BilinearModel, scheme: LandmarkScheme, prior: IdentityPrior) -> LandmarkModel:
        """Cut the cores out of a model.

        Raises
        ------
        TopologyError
            If the model's topology does not mark the scheme's landmarks or the jaw line.
        """
        ids = model.topology.landmarks.get(scheme.name)
        if ids is None or len(ids) != scheme.n_points:
            raise TopologyError(f"topology {model.topology.name!r} must mark the {scheme.name!r} landmarks.")
        fixed = scheme.fixed[ids[scheme.fixed] >= 0]
        if len(fixed) < 4:
            raise TopologyError(
                f"topology {model.topology.name!r} must mark at least 4 landmarks of {scheme.name!r}, got {len(fixed)}."
            )
        strips = build_contour_strips(model.topology, model.mean_face)
        candidates, place = np.unique(strips.vertices, return_inverse=True)
        compact = ContourStrips(place.reshape(strips.vertices.shape).astype(np.int32), strips.outward)
        core = model.at_vertices(np.concatenate([ids[fixed], candidates])).core  # (P + N, 3, I, E)
        mean = np.einsum("pcie,i->pce", core, prior.mean)[None]
        axes = np.einsum("pcie,ik->kpce", core, prior.axes, optimize=True)
        white = np.concatenate([mean, axes])
        u = model.expression_weights
        return cls(
            fixed=fixed,
            sliding=scheme.sliding,
            core=np.ascontiguousarray(white[:, : len(fixed)]),
            strip_core=np.ascontiguousarray(white[:, len(fixed) :], dtype=np.float32),
            strips=compact,
            mixture=u[1:] - u[0],
            neutral=u[0],
        )

    @property
    def n_identity(self) -> int:
        """Number K of identity axes."""
        return len(self.core) - 1

    def expression(self, beta: NDArray[np.floating]) -> NDArray[np.float64]:
        """Return w_exp (E,) of FACS coefficients (B,)."""
        return self.neutral + beta @ self.mixture

    def outline(self, c: NDArray[np.floating], beta: NDArray[np.floating]) -> NDArray[np.float64]:
        """Return the contour candidates in their strips, (K strips, M, 3), millimetres."""
        w_exp = self.expression(beta).astype(np.float32)
        K1, N = self.strip_core.shape[:2]
        rows = (self.strip_core.reshape(-1, len(w_exp)) @ w_exp).reshape(K1, N * 3)
        points = rows[0] + c.astype(np.float32) @ rows[1:]
        return points.reshape(N, 3)[self.strips.vertices].astype(np.float64)

    def with_contour(self, chosen: NDArray[np.intp], sliding: Sliding) -> NDArray[np.float64]:
        """Return the core (1 + K, P + C, 3, E) of the fixed landmarks and the contour points at their present places.

        Parameters
        ----------
        chosen : ndarray of shape (strips,), int
            The outline's vertex in each strip.
        sliding : Sliding
            Place of each contour point on the outline.
        """
        corners = self.strips.vertices[np.arange(len(chosen)), chosen]
        a, b = self.strip_core[:, corners[sliding.first]], self.strip_core[:, corners[sliding.first + 1]]
        contour = a + sliding.fraction.astype(np.float32)[:, None, None] * (b - a)
        return np.concatenate([self.core, contour], axis=1)


def identity_matrix(core: NDArray[np.float64], w_exp: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return (1 + K, L, 3) of a core (1 + K, L, 3, E): the points are row 0 + c rows 1..K."""
    return (core.reshape(-1, core.shape[-1]) @ w_exp).reshape(core.shape[:3])


def expression_matrix(core: NDArray[np.float64], c: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return (L, 3, E) of a core (1 + K, L, 3, E): the points are this times w_exp."""
    flat = core.reshape(len(core), -1)
    return (flat[0] + c @ flat[1:]).reshape(core.shape[1:])
