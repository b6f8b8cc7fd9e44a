"""Bilinear face model: identity x expression (FaceWarehouse 3.3, eq. 8-10 and 17)."""

from __future__ import annotations

import hashlib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from facewright.errors import ShapeError, ValueRangeError
from facewright.mesh.topology import Topology
from facewright.models.blendshapes import BlendshapeRig
from facewright.models.nmode_svd import Progress, nmode_svd
from facewright.numeric.check import check_finite, check_indices, check_shape

if TYPE_CHECKING:
    from facewright.models.bilinear_points import BilinearPoints
    from facewright.models.bilinear_projection import BilinearProjector


@dataclass(frozen=True, eq=False)
class BilinearModel:
    r"""Any expression of any person as a core tensor contracted with two weight vectors.

    Eq. (10): :math:`V = C_r \times_2 w_{id} \times_3 w_{exp}`. The mean stays in: weights multiply everything.

    **Scaling**, the only one in the project: training weights have unit mean square. `identity_weights` is
    sqrt(N) U_id and `expression_weights` sqrt(S) U_exp (U orthonormal), the core is divided accordingly, and
    T[n, s] = C x2 identity_weights[n] x3 expression_weights[s]. So a weight of 1 is a typical one; the first of each
    is near 1 for everybody (it carries the mean face).

    **Gauge**: (a w_id, w_exp / a) is the same face for every a. Whatever *estimates* weights returns the pair with
    ``expression_gauge @ w_exp == 1``, as all blendshape mixtures nearly have; size then belongs to identity.

    Parameters
    ----------
    core_rows : ndarray of shape (I, E, V, 3), float32, millimetres, C-contiguous
        The core, identity-major as it is multiplied; `core` shows it as (V, 3, I, E).
    identity_weights : ndarray of shape (N, I), float64
        Weights of the N training people (may be empty, where they were removed for privacy).
    expression_weights : ndarray of shape (S, E), float64
        Row s is the weight vector of shape s: U_exp d_s of eq. 17. Row 0 is the neutral.
    identity_singular_values, expression_singular_values : ndarray of shape (N,) and (S,)
        Of the training tensor, all of them.
    identity_mean, identity_covariance : ndarray of shape (I,) and (I, I)
        Prior of w_id: mean and covariance of the training weights.
    expression_mean, expression_covariance : ndarray of shape (E,) and (E, E)
        Prior of w_exp.
    expression_names : tuple of str
        "neutral", then the blendshapes' names; S of them.
    topology : Topology
    provenance : mapping
        Where the model comes from (JSON values): face, seed, licence, ...
    labels : mapping of str to tuple of N values
        What the N training people are labelled with (age, sex, ...), None where unknown; without names of people.
    """

    core_rows: NDArray[np.float32]
    identity_weights: NDArray[np.float64]
    expression_weights: NDArray[np.float64]
    identity_singular_values: NDArray[np.float64]
    expression_singular_values: NDArray[np.float64]
    identity_mean: NDArray[np.float64]
    identity_covariance: NDArray[np.float64]
    expression_mean: NDArray[np.float64]
    expression_covariance: NDArray[np.float64]
    expression_names: tuple[str, ...]
    topology: Topology
    provenance: Mapping[str, Any] = field(default_factory=dict)
    labels: Mapping[str, tuple[str | int | float | bool | None, ...]] = field(default_factory=dict)

    def __post_init__(self) -> None:
        sizes = check_shape("core_rows", self.core_rows, "I", "E", self.topology.n_vertices, 3)
        S = len(self.expression_names)
        check_shape("identity_weights", self.identity_weights, "N", "I", **sizes)
        check_shape("expression_weights", self.expression_weights, S, "E", **sizes)
        check_shape("identity_mean", self.identity_mean, "I", **sizes)
        check_shape("identity_covariance", self.identity_covariance, "I", "I", **sizes)
        check_shape("expression_mean", self.expression_mean, "E", **sizes)
        check_shape("expression_covariance", self.expression_covariance, "E", "E", **sizes)
        if self.core_rows.dtype != np.float32 or not self.core_rows.flags.c_contiguous:
            raise ShapeError("core_rows must be C-contiguous float32.")
        for name, values in self.labels.items():
            if len(values) != len(self.identity_weights):
                raise ShapeError(
                    f"label {name!r} must have one value for each of the {len(self.identity_weights)} training people, "
                    f"got {len(values)}."
                )

    # --- sizes and views -----------------------------------------------------------------------------------------

    @property
    def n_identity(self) -> int:
        """Number of identity components I."""
        return self.core_rows.shape[0]

    @property
    def n_expression(self) -> int:
        """Number of expression components E."""
        return self.core_rows.shape[1]

    @property
    def n_vertices(self) -> int:
        """Number of vertices V."""
        return self.core_rows.shape[2]

    @property
    def core(self) -> NDArray[np.float32]:
        """The core tensor C_r as the paper writes it, (V, 3, I, E); a view."""
        return self.core_rows.transpose(2, 3, 0, 1)

    @cached_property
    def model_id(self) -> str:
        """Identity of the model, 16 hex digits: weights are only meaningful with the model that has the same one.

        What the model's file states, and so the same however often it is loaded; else a hash of core, shapes and mesh.
        """
        stated = self.provenance.get("model_id")
        if isinstance(stated, str) and stated:
            return stated
        digest = hashlib.sha256(self.core_rows.data)
        digest.update(np.ascontiguousarray(self.expression_weights).data)
        digest.update(self.topology.fingerprint.encode())
        return digest.hexdigest()[:16]

    @property
    def expression_gauge(self) -> NDArray[np.float64]:
        """Functional (E,) that is 1 at the mean expression; estimated weights satisfy ``gauge @ w_exp == 1``."""
        return self.expression_mean / (self.expression_mean @ self.expression_mean)

    def in_gauge(
        self, w_id: NDArray[np.floating], w_exp: NDArray[np.floating]
    ) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Return the pair of the same face that satisfies ``expression_gauge @ w_exp == 1``."""
        w_id, w_exp = self._check_weights(w_id, w_exp)
        a = float(self.expression_gauge @ w_exp)
        if a == 0:
            raise ValueRangeError("w_exp must have a non-zero part along the mean expression, got none.")
        return w_id * a, w_exp / a

    # --- synthesis -----------------------------------------------------------------------------------------------

    def synthesise(self, w_id: NDArray[np.floating], w_exp: NDArray[np.floating]) -> NDArray[np.float32]:
        """Return the face (V, 3), mm, of identity weights (I,) and expression weights (E,): eq. (10).

        Reads the whole core once. Where one of the two stays fixed, `person` or `expression` contracts it once.
        """
        w_id, w_exp = self._check_weights(w_id, w_exp)
        both = np.outer(w_id, w_exp).astype(np.float32).reshape(-1)
        return (both @ self.core_rows.reshape(len(both), -1)).reshape(-1, 3)

    def person(self, w_id: NDArray[np.floating]) -> NDArray[np.float32]:
        """Return C_r x2 w_id, (E, V, 3): one person's expression components.

        ``np.tensordot(w_exp, person, 1)`` is then eq. (10), without touching the core.
        """
        w_id, _ = self._check_weights(w_id, self.expression_mean)
        flat = w_id.astype(np.float32) @ self.core_rows.reshape(self.n_identity, -1)
        return flat.reshape(self.core_rows.shape[1:])

    def expression(self, w_exp: NDArray[np.floating]) -> NDArray[np.float32]:
        """Return C_r x3 w_exp, (I, V, 3): one expression as a linear identity model."""
        _, w_exp = self._check_weights(self.identity_mean, w_exp)
        rows = self.core_rows.reshape(self.n_identity, self.n_expression, -1)
        return np.matmul(w_exp.astype(np.float32), rows).reshape(self.n_identity, -1, 3)

    def blendshapes(self, w_id: NDArray[np.floating]) -> BlendshapeRig:
        """Return the FACS blendshapes of a person: B_i = C_r x2 w_id x3 (U_exp d_i), eq. (17)."""
        person = self.person(w_id).reshape(self.n_expression, -1)
        weights = self.expression_weights.astype(np.float32)
        neutral = (weights[0] @ person).reshape(-1, 3)  # Eq. (17), i = 0
        deltas = ((weights[1:] - weights[0]) @ person).reshape(-1, *neutral.shape)
        return BlendshapeRig(neutral, self.expression_names[1:], deltas)

    def expression_from_blendshapes(self, beta: NDArray[np.floating]) -> NDArray[np.float64]:
        """Return w_exp (E,) of blendshape coefficients (S - 1,).

        V = B_0 + sum_i beta_i (B_i - B_0) with eq. (17) is the face of u_0 + sum_i beta_i (u_i - u_0).
        """
        check_shape("beta", beta, len(self.expression_weights) - 1)
        check_finite("beta", beta)
        u = self.expression_weights
        return u[0] + np.asarray(beta, dtype=np.float64) @ (u[1:] - u[0])

    @cached_property
    def mean_face(self) -> NDArray[np.float32]:
        """The neutral face (V, 3), mm, of the mean identity."""
        return self.synthesise(self.identity_mean, self.expression_weights[0])

    # --- priors --------------------------------------------------------------------------------------------------

    @cached_property
    def identity_precision(self) -> NDArray[np.float64]:
        """Inverse covariance (I, I) of identity weights: (w - mean)^T P (w - mean) is a prior's energy.

        Training weights hardly vary along their mean, since everybody shares the mean face; a standard deviation of
        at least 1 % is allowed there, so that an unseen person's overall size is not fixed by it.
        """
        return _inverse(self.identity_covariance)

    @cached_property
    def expression_precision(self) -> NDArray[np.float64]:
        """Inverse covariance (E, E) of expression weights; stiff along their mean, which softly keeps the gauge."""
        return _inverse(self.expression_covariance)

    def sample_identity(self, rng: np.random.Generator) -> NDArray[np.float64]:
        """Draw identity weights (I,) from the prior N(identity_mean, identity_covariance)."""
        return rng.multivariate_normal(
            self.identity_mean, self.identity_covariance, method="eigh", check_valid="ignore"
        )

    def sample_expression(self, rng: np.random.Generator) -> NDArray[np.float64]:
        """Draw expression weights (E,) from the prior N(expression_mean, expression_covariance)."""
        return rng.multivariate_normal(
            self.expression_mean, self.expression_covariance, method="eigh", check_valid="ignore"
        )

    # --- estimation and parts ------------------------------------------------------------------------------------

    @cached_property
    def _projector(self) -> BilinearProjector:
        from facewright.models.bilinear_projection import BilinearProjector

        return BilinearProjector(self)

    def project(
        self,
        vertices: NDArray[np.floating],
        *,
        vertex_ids: NDArray[np.integer] | None = None,
        vertex_weights: NDArray[np.floating] | None = None,
        noise_mm: float = 0.0,
    ) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Return (w_id, w_exp), in gauge, whose face is nearest to a mesh: the fit of FaceWarehouse's Fig. 4.

        One line over `BilinearProjector`, which see for arguments, details and many meshes. The projector of the
        whole mesh is kept with the model (8 (I E)^2 bytes: 12 MB for 50 x 25).
        """
        if vertex_ids is None and vertex_weights is None:
            fit = self._projector.fit(vertices, noise_mm=noise_mm)
        else:
            from facewright.models.bilinear_projection import BilinearProjector

            projector = BilinearProjector(self, vertex_ids=vertex_ids, vertex_weights=vertex_weights)
            fit = projector.fit(vertices, noise_mm=noise_mm)
        return fit.identity_weights, fit.expression_weights

    def at_vertices(self, vertex_ids: NDArray[np.integer] | Sequence[int]) -> BilinearPoints:
        """Return the small dense model of some vertices, in the given order, for landmark fitting."""
        from facewright.models.bilinear_points import BilinearPoints

        ids = np.asarray(vertex_ids)
        check_shape("vertex_ids", ids, "L")
        check_indices("vertex_ids", ids, self.n_vertices)
        return BilinearPoints(np.ascontiguousarray(self.core[ids], dtype=np.float64), self)

    def truncated(self, n_identity: int, n_expression: int) -> BilinearModel:
        """Return the model of the leading components: the top-left corner of the core, eq. (9)."""
        for name, kept, size in (
            ("n_identity", n_identity, self.n_identity),
            ("n_expression", n_expression, self.n_expression),
        ):
            if not 1 <= kept <= size:
                raise ValueRangeError(f"{name} must be in [1, {size}], got {kept}.")
        I, E = slice(n_identity), slice(n_expression)
        return replace(
            self,
            core_rows=np.ascontiguousarray(self.core_rows[I, E]),
            identity_weights=self.identity_weights[:, I],
            expression_weights=self.expression_weights[:, E],
            identity_mean=self.identity_mean[I],
            identity_covariance=self.identity_covariance[I, I],
            expression_mean=self.expression_mean[E],
            expression_covariance=self.expression_covariance[E, E],
            provenance={key: value for key, value in self.provenance.items() if key != "model_id"},
        )

    def _check_weights(self, w_id: Any, w_exp: Any) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        check_shape("w_id", w_id, self.n_identity)
        check_shape("w_exp", w_exp, self.n_expression)
        check_finite("w_id", w_id)
        check_finite("w_exp", w_exp)
        return np.asarray(w_id, dtype=np.float64), np.asarray(w_exp, dtype=np.float64)


def _inverse(covariance: NDArray[np.float64]) -> NDArray[np.float64]:
    """Invert a covariance (of weights near 1 in size) after raising its variances to at least 1e-4."""
    values, vectors = np.linalg.eigh(covariance)
    values = np.maximum(values, 1e-4)
    return (vectors / values) @ vectors.T


def fit_bilinear(
    tensor: Any,
    n_identity: int,
    n_expression: int,
    *,
    topology: Topology,
    expression_names: Sequence[str],
    provenance: Mapping[str, Any] | None = None,
    order: str = "identity",
    block_mb: float = 64.0,
    progress: Progress | None = None,
) -> BilinearModel:
    """Build the bilinear model of a tensor of N people x S shapes.

    Parameters
    ----------
    tensor : array_like of shape (N, S, V, 3), or iterable of vertex blocks, millimetres
        ``tensor[n, 0]`` is person n's neutral, ``tensor[n, s]`` the blendshape s. May lie on disk; see `nmode_svd`.
    n_identity, n_expression : int
        Components kept; FaceWarehouse uses 50 and 25.
    topology : Topology
        Of the V vertices.
    expression_names : sequence of str
        S names, the neutral's first.
    provenance : mapping, optional
        Kept in the model as it is.
    order, block_mb, progress
        See `nmode_svd`.

    Returns
    -------
    BilinearModel

    Raises
    ------
    ShapeError, ValueRangeError
        If sizes do not fit together or values are not finite.

    Notes
    -----
    FaceWarehouse eq. (8), (9); scaling as stated in `BilinearModel`.
    """
    if hasattr(tensor, "shape"):  # refuse before the work what can be known before
        check_shape("tensor", tensor, "N", len(expression_names), topology.n_vertices, 3)
    svd = nmode_svd(tensor, n_identity, n_expression, order=order, block_mb=block_mb, progress=progress)
    N, S = len(svd.identity_factors), len(svd.expression_factors)
    if len(expression_names) != S:
        raise ShapeError(f"expression_names must have one name per shape ({S}), got {len(expression_names)}.")
    core = svd.core
    core *= np.float32(1.0 / np.sqrt(N * S))
    identity = np.sqrt(N) * svd.identity_factors
    expression = np.sqrt(S) * svd.expression_factors
    return BilinearModel(
        core_rows=core,
        identity_weights=identity,
        expression_weights=expression,
        identity_singular_values=svd.identity_singular_values,
        expression_singular_values=svd.expression_singular_values,
        identity_mean=identity.mean(axis=0),
        identity_covariance=np.atleast_2d(np.cov(identity, rowvar=False, bias=True)),
        expression_mean=expression.mean(axis=0),
        expression_covariance=np.atleast_2d(np.cov(expression, rowvar=False, bias=True)),
        expression_names=tuple(expression_names),
        topology=topology,
        provenance=dict(provenance or {}),
    )
