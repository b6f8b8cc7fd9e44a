"""The bilinear model at the few vertices that a photo is fitted with: landmarks and contour candidates."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from facewright.errors import TopologyError
from facewright.fitting.energies.identity_prior import IdentityPrior
from facewright.fitting.small_algebra import contract_between, contract_first, contract_last, contract_points
from facewright.landmarks.contour import ContourStrips, build_contour_strips, slide_on_outline
from facewright.landmarks.scheme import LandmarkScheme
from facewright.models.bilinear import BilinearModel

#: Identity axes that move the landmarks by less, root mean square per coordinate, are left at their mean: a landmark's
#: noise is more than ten times as large.
_SMALLEST_EFFECT_MM = 0.06
#: One contour candidate in so many counts among the landmarks that say so.
_CONTOUR_SHARE = 12


@dataclass(frozen=True, eq=False)
class ContourPlaces:
    """Where the contour points sit at the moment: between two candidates each.

    Parameters
    ----------
    first, second : ndarray of shape (C,), int
        Candidates (rows of `LandmarkModel.strip_core`'s second axis).
    fraction : ndarray of shape (C,), float64
        0 at `first`, 1 at `second`.
    normal : ndarray of shape (C, 2), float64
        Unit normal of the outline in the picture.
    """

    first: NDArray[np.intp]
    second: NDArray[np.intp]
    fraction: NDArray[np.float64]
    normal: NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class PersonPoints:
    """The points of one identity: C x2 w_id, linear in the expression.

    Parameters
    ----------
    c : ndarray of shape (K,)
        The identity, in standard deviations.
    fixed : ndarray of shape (P, 3, E)
        At the fixed landmarks: positions are this times w_exp.
    strips : ndarray of shape (N, 3, E)
        At the contour candidates.
    """

    c: NDArray[np.float64]
    fixed: NDArray[np.float64]
    strips: NDArray[np.float64]

    def candidates(self, w_exp: NDArray[np.floating]) -> NDArray[np.float64]:
        """Return the contour candidates (N, 3), millimetres."""
        return contract_points(self.strips, np.ascontiguousarray(w_exp, dtype=np.float64))

    def expression_matrix(self, places: ContourPlaces) -> NDArray[np.float64]:
        """Return (L, 3, E) at the fixed landmarks and the contour's places: points are this times w_exp."""
        share = places.fraction[:, None, None]
        contour = (1.0 - share) * self.strips[places.first] + share * self.strips[places.second]
        return np.concatenate([self.fixed, contour])


@dataclass(frozen=True, eq=False)
class LandmarkModel:
    """Small cores, whitened along identity: positions are (mean + axes c) x2, w_exp x3.

    Parameters
    ----------
    prior : IdentityPrior
        Axes that the landmarks can tell from the mean, strongest first.
    fixed : ndarray of int32
        Landmarks of the scheme that have a vertex, P of them.
    sliding : ndarray of int32
        Landmarks that slide along the contour, C of them.
    core : ndarray of shape (1 + K, P, 3, E), float32
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

    prior: IdentityPrior
    fixed: NDArray[np.int32]
    sliding: NDArray[np.int32]
    core: NDArray[np.float32]
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
        u = model.expression_weights
        effect = np.concatenate([core[: len(fixed)], core[len(fixed) :: _CONTOUR_SHARE]]) @ u[0] @ prior.axes
        prior = prior.ordered_by(effect.reshape(-1, effect.shape[-1]), _SMALLEST_EFFECT_MM)
        mean = np.einsum("pcie,i->pce", core, prior.mean)[None]
        axes = np.einsum("pcie,ik->kpce", core, prior.axes, optimize=True)
        white = np.concatenate([mean, axes])
        return cls(
            prior=prior,
            fixed=fixed,
            sliding=scheme.sliding,
            core=np.ascontiguousarray(white[:, : len(fixed)], dtype=np.float32),
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

    def person(self, c: NDArray[np.floating]) -> PersonPoints:
        """Return the model's points for one identity."""
        weights = np.ones(len(c) + 1, dtype=np.float32)
        weights[1:] = c
        E = self.core.shape[-1]
        fixed = contract_first(self.core.reshape(len(weights), -1), weights).reshape(-1, 3, E)
        strips = contract_first(self.strip_core.reshape(len(weights), -1), weights).reshape(-1, 3, E)
        return PersonPoints(np.asarray(c, dtype=np.float64), fixed, strips)

    def place_contour(
        self, candidate_pixels: NDArray[np.float64], rotation: NDArray[np.float64], found: NDArray[np.float64]
    ) -> ContourPlaces:
        """Find the outline among the projected candidates and each contour point's nearest place on it.

        Parameters
        ----------
        candidate_pixels : ndarray of shape (N, 2)
            Projected candidates.
        rotation : ndarray of shape (3, 3)
            Of the head, camera_from_model.
        found : ndarray of shape (C, 2), pixels
            The picture's contour points.
        """
        strips = self.strips.vertices
        chosen = self.strips.outline(candidate_pixels[strips], rotation)
        corners = strips[np.arange(len(chosen)), chosen]
        outline = candidate_pixels[corners]
        sliding = slide_on_outline(found, outline)
        along = outline[sliding.first + 1] - outline[sliding.first]
        length = np.maximum(np.hypot(along[:, 0], along[:, 1]), 1e-9)
        normal = np.stack([-along[:, 1], along[:, 0]], axis=1) / length[:, None]
        return ContourPlaces(corners[sliding.first], corners[sliding.first + 1], sliding.fraction, normal)

    def identity_matrix(self, w_exp: NDArray[np.floating], places: ContourPlaces) -> NDArray[np.float64]:
        """Return (1 + K, L, 3) at the fixed landmarks and the contour's places: points are row 0 + c rows 1..K."""
        w = w_exp.astype(np.float32)
        K1, E = len(self.core), len(w)
        fixed = contract_last(self.core.reshape(K1, -1, E), w).reshape(K1, -1, 3)
        contour = contract_between(self.strip_core, places.first, places.second, places.fraction, w)
        return np.concatenate([fixed, contour], axis=1)
