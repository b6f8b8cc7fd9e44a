"""Example-based facial rigging: a person's blendshapes from a few acted poses."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy import sparse

from facewright.deform.acted_weights import (
    ActingPrior,
    estimate_amplitudes,
    estimate_reach,
    split_amplitudes,
)
from facewright.errors import ValueRangeError
from facewright.mesh.connectivity import vertex_components
from facewright.mesh.gradient import gradient_operator
from facewright.mesh.triangle_frames import degenerate_triangles, triangle_frames
from facewright.numeric.check import check_finite, check_indices, check_shape
from facewright.numeric.sparse_solve import SymmetricSolver
from facewright.numeric.threads import for_blocks

Progress = Callable[[str, int, int], None]

BETAS = (0.03, 0.01)
"""Strength of the generic shapes in each round, falling as the paper's (its 0.5 to 0.1 suit centimetre scans)."""

_TRIANGLE_BLOCK = 2048
_STILL_MM = 0.1


@dataclass(frozen=True, eq=False)
class FittedRig:
    """A person's blendshapes recovered from poses.

    Parameters
    ----------
    deltas : ndarray of shape (B, V, 3), float64, millimetres
        Blendshapes as displacements from the neutral.
    weights : ndarray of shape (N, B), float64
        Acted weights of the poses, estimated or as given.
    amplitudes : ndarray of shape (B,), float64
        How far the person goes with each shape relative to the generic one.
    """

    deltas: NDArray[np.float64]
    weights: NDArray[np.float64]
    amplitudes: NDArray[np.float64]


class RigFitter:
    r"""Recover the blendshapes of one person from example poses, with everything fixed computed once.

    Alternates, as Li, Weise and Pauly [1]_ (FW 3.2.3), two steps. *Shapes*: per triangle,

    .. math:: \min_M \sum_j \|M_j^S - \sum_i \alpha_{ij} M_i\|^2 + \beta \sum_i w_i \|M_i - M_i^*\|^2,

    with :math:`w_i = ((1 + |M_i^A|) / (\kappa + |M_i^A|))^\theta`, then one Poisson reconstruction per blendshape
    with a shared factor. *Weights*: per pose, bounded least squares near the guide's weights.

    Differs from the paper: M holds the two tangential columns of the gradient (the third does not reach the vertices);
    :math:`M_i^*` is the generic gradient times the amplitude estimated for the shape, which also fixes the scale that
    could otherwise move freely between shapes and weights; `amplitudes="generic"` switches that off.

    Parameters
    ----------
    neutral : ndarray of shape (V, 3), millimetres
        The person at rest.
    generic_deltas : ndarray of shape (B, V, 3), millimetres
        Generic blendshapes carried to this neutral (`DeformationTransfer`).
    faces : ndarray of shape (F, 3), int
        Triangles.
    coupled : sequence of (int, int)
        Shapes that people exaggerate alike: left and right of one shape, jaw opening and its counter-shape.
    kappa, theta : float
        Of the local weights. `kappa` is half the paper's: shapes stay put where the generic ones do.
    prior : ActingPrior, optional
        Expected deviations of actors and faces.

    Raises
    ------
    ShapeError, ValueRangeError
        If shapes do not fit, values are not finite or indices are out of range.

    References
    ----------
    .. [1] Li, Weise, Pauly, Example-based facial rigging, SIGGRAPH 2010.
    """

    def __init__(
        self,
        neutral: NDArray[np.floating[Any]],
        generic_deltas: NDArray[np.floating[Any]],
        faces: NDArray[np.integer[Any]],
        *,
        coupled: Sequence[tuple[int, int]] = (),
        kappa: float = 0.05,
        theta: float = 2.0,
        prior: ActingPrior | None = None,
    ) -> None:
        V = check_shape("neutral", neutral, "V", 3)["V"]
        B = check_shape("generic_deltas", generic_deltas, "B", V, 3)["B"]
        check_finite("neutral", neutral)
        check_finite("generic_deltas", generic_deltas)
        if len(coupled):
            check_shape("coupled", np.asarray(coupled), "N", 2)
            check_indices("coupled", np.asarray(coupled), B)
        if not (kappa > 0 and theta >= 0):
            raise ValueRangeError(f"kappa must be positive and theta not negative, got {kappa} and {theta}.")
        self.neutral = np.array(neutral, dtype=np.float64)
        self.generic = np.array(generic_deltas, dtype=np.float64)
        self.coupled = tuple((int(i), int(k)) for i, k in coupled)
        self.prior = prior or ActingPrior()
        kept = faces[~degenerate_triangles(triangle_frames(self.neutral, faces))]
        # Tangential gradients, two rows a triangle.
        self._gradient = gradient_operator(self.neutral, kept, tangential=True)
        self._divergence = self._gradient.T.tocsr()
        self._labels = vertex_components(kept, V)
        pins = np.zeros(V)
        matrix = (self._divergence @ self._gradient).tocsc()
        pins[np.unique(self._labels, return_index=True)[1]] = max(matrix.diagonal().mean(), 1e-12)
        self._solver = SymmetricSolver(matrix + sparse.diags(pins))
        self._members = sparse.csr_matrix(
            (np.ones(V), (self._labels, np.arange(V))), shape=(int(self._labels.max(initial=-1)) + 1, V)
        )
        self._generic_gradients = self._gradients(self.generic)
        size = np.sqrt((self._generic_gradients**2).sum(axis=2))
        self._variances = ((kappa + size) / (1.0 + size)) ** theta  # 1 / w_i, (F, B)

    def fit(
        self,
        poses: NDArray[np.floating[Any]],
        weights: NDArray[np.floating[Any]],
        *,
        weights_known: bool = False,
        betas: Sequence[float] = BETAS,
        amplitudes: str = "estimated",
        progress: Progress | None = None,
    ) -> FittedRig:
        """Fit the blendshapes to poses.

        Parameters
        ----------
        poses : ndarray of shape (N, V, 3), millimetres
            Acted poses, in place with the neutral (no head motion). Poses at rest add nothing and do no harm.
        weights : ndarray of shape (N, B)
            Weights of the guide poses, in [0, 1], or the acted weights themselves if `weights_known`.
        weights_known : bool
            Take `weights` as they are (FW does so for its 20 poses).
        betas : sequence of float
            Strength of the generic shapes in each round; one round is enough where the weights are known.
        amplitudes : {"estimated", "generic"}
            Scale the generic shapes to the person, or keep them as they are (the paper).
        progress : callable, optional
            Called as progress("fitting blendshapes", done, total).

        Returns
        -------
        FittedRig
            Blendshapes, weights, amplitudes.

        Raises
        ------
        ShapeError, ValueRangeError
            If shapes do not fit, values are not finite, or weights or betas are out of range.
        """
        V, B = len(self.neutral), len(self.generic)
        N = check_shape("poses", poses, "N", V, 3)["N"]
        check_shape("weights", weights, N, B)
        check_finite("poses", poses)
        guide = np.asarray(weights, dtype=np.float64)
        if not ((guide >= 0) & (guide <= 2)).all():
            raise ValueRangeError("weights must be in [0, 1], got values outside or NaN.")
        if amplitudes not in ("estimated", "generic"):
            raise ValueRangeError(f'amplitudes must be "estimated" or "generic", got {amplitudes!r}.')
        if not betas or not all(beta > 0 for beta in betas):
            raise ValueRangeError(f"betas must be positive, at least one, got {tuple(betas)}.")
        moved = np.asarray(poses, dtype=np.float64) - self.neutral
        pose_gradients = self._gradients(moved)
        acted, amplitude = guide, np.ones(B)
        estimate = amplitudes == "estimated"
        if weights_known:
            betas = betas[-1:]
            if estimate:
                amplitude = estimate_amplitudes(self.generic, moved, guide, self.coupled, self.prior)
        deltas = self.generic
        for done, beta in enumerate(betas):
            if not weights_known:
                acted, amplitude = self._weight_step(deltas, moved, guide, estimate)
            deltas = self._shape_step(pose_gradients, acted, amplitude, beta)
            if progress is not None:
                progress("fitting blendshapes", done + 1, len(betas))
        return FittedRig(deltas, acted.copy(), amplitude)

    def _weight_step(
        self,
        deltas: NDArray[np.float64],
        moved: NDArray[np.float64],
        guide: NDArray[np.float64],
        estimate: bool,
    ) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Return acted weights (N, B) and amplitudes (B,)."""
        sizes = (self.generic**2).sum(axis=(1, 2))
        current = (deltas * self.generic).sum(axis=(1, 2)) / np.where(sizes > 0, sizes, 1.0)
        current = np.where(current > 0.1, current, 1.0)
        # In shapes brought to the generic amplitude, weights are reaches: acted weight times amplitude.
        reach = estimate_reach(deltas / current[:, None, None], moved, guide, self.prior)
        if not estimate:
            return reach, np.ones(len(current))
        amplitude = split_amplitudes(reach, guide, self.coupled, self.prior)
        return reach / amplitude, amplitude

    def _shape_step(
        self,
        pose_gradients: NDArray[np.float64],
        acted: NDArray[np.float64],
        amplitude: NDArray[np.float64],
        beta: float,
    ) -> NDArray[np.float64]:
        """Return the blendshapes (B, V, 3) that best explain the poses at weights (N, B)."""
        from facewright.deform._rigging_kernels import correct_gradients

        N, B = acted.shape
        gradients = self._generic_gradients * amplitude[None, :, None]  # M*
        outer = np.ascontiguousarray((acted[:, None] * acted[None, :]).transpose(2, 0, 1)).reshape(B, N * N)

        def solve_block(start: int, stop: int) -> None:
            part = slice(start, stop)
            residuals = pose_gradients[part] - acted @ gradients[part]
            gram = (self._variances[part] @ outer).reshape(-1, N, N)  # A w^-1 A' of every triangle
            correct_gradients(gram, beta, residuals, self._variances[part], acted, gradients[part])

        for_blocks(len(gradients), _TRIANGLE_BLOCK, solve_block)
        return self._integrate(gradients, self.generic * amplitude[:, None, None])

    def _gradients(self, displacements: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return the tangential gradients (F, T, 6) of displacements (T, V, 3)."""
        T, V, _ = displacements.shape
        rows = self._gradient @ np.ascontiguousarray(displacements.transpose(1, 0, 2)).reshape(V, T * 3)
        return np.ascontiguousarray(rows.reshape(-1, 2, T, 3).transpose(0, 2, 1, 3)).reshape(-1, T, 6)

    def _integrate(self, gradients: NDArray[np.float64], reference: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return displacements (B, V, 3) with gradients nearest to (F, B, 6), still where `reference` is."""
        B, V, _ = reference.shape
        rows = gradients.reshape(-1, B, 2, 3).transpose(0, 2, 1, 3).reshape(-1, B * 3)
        X = self._solver.solve(self._divergence @ rows).reshape(V, B, 3).transpose(1, 0, 2)
        weights = 1.0 / (np.einsum("bvx,bvx->bv", reference, reference) + _STILL_MM**2)  # (B, V)
        error = ((reference - X) * weights[:, :, None]).transpose(1, 0, 2).reshape(V, B * 3)
        shift = (self._members @ error).reshape(-1, B, 3) / (self._members @ weights.T)[:, :, None]
        return np.ascontiguousarray(X) + shift[self._labels].transpose(1, 0, 2)


def fit_rig(
    neutral: NDArray[np.floating[Any]],
    generic_deltas: NDArray[np.floating[Any]],
    faces: NDArray[np.integer[Any]],
    poses: NDArray[np.floating[Any]],
    weights: NDArray[np.floating[Any]],
    *,
    weights_known: bool = False,
    coupled: Sequence[tuple[int, int]] = (),
    progress: Progress | None = None,
) -> FittedRig:
    """Recover a person's blendshapes from acted poses; one line over `RigFitter`.

    Parameters
    ----------
    neutral : ndarray of shape (V, 3), millimetres
        The person at rest.
    generic_deltas : ndarray of shape (B, V, 3), millimetres
        The generic blendshapes carried to this person, displacements from `neutral`.
    faces : ndarray of shape (F, 3)
        Triangles.
    poses : ndarray of shape (N, V, 3), millimetres
        Acted poses, without head motion.
    weights : ndarray of shape (N, B)
        Weights of the guide poses, in [0, 1]; the acted weights themselves if `weights_known`.
    weights_known : bool
        Take `weights` as they are.
    coupled : sequence of (int, int)
        Pairs of shapes that a person does about as strongly as each other, such as left and right.
    progress : callable, optional
        Called as progress("fitting blendshapes", done, total).

    Returns
    -------
    FittedRig
        Blendshapes, acted weights, amplitudes.

    Raises
    ------
    ShapeError, ValueRangeError
        If shapes do not fit, values are not finite, or weights are out of range.

    Notes
    -----
    Li, Weise and Pauly 2010; FaceWarehouse 3.2.3.
    """
    fitter = RigFitter(neutral, generic_deltas, faces, coupled=coupled)
    return fitter.fit(poses, weights, weights_known=weights_known, progress=progress)
