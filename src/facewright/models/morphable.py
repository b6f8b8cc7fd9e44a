"""Morphable model: a mean face and identity modes in standard deviations (principal component analysis)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from facewright.errors import ValueRangeError
from facewright.numeric.check import check_finite, check_shape


@dataclass(frozen=True, eq=False)
class MorphableModel:
    """Faces as mean + sum_i c_i mode_i, with c in standard deviations, so that the prior is |c|^2.

    Parameters
    ----------
    mean_shape : ndarray of shape (V, 3), float32, millimetres
    identity_basis : ndarray of shape (I, V, 3), float32, millimetres
        Displacement of each mode at one standard deviation, largest first.

    Examples
    --------
    >>> samples = np.random.default_rng(0).normal(size=(10, 5, 3))
    >>> model = MorphableModel.from_samples(samples, 4)
    >>> c = np.array([1.0, -0.5, 0.0, 2.0])
    >>> bool(np.allclose(model.project(model.synthesise(c)), c, atol=1e-4))
    True
    """

    mean_shape: NDArray[np.float32]
    identity_basis: NDArray[np.float32]

    def __post_init__(self) -> None:
        sizes = check_shape("mean_shape", self.mean_shape, "V", 3)
        check_shape("identity_basis", self.identity_basis, "I", "V", 3, **sizes)

    @property
    def n_modes(self) -> int:
        """Number of modes I."""
        return len(self.identity_basis)

    @classmethod
    def from_samples(cls, samples: NDArray[np.floating], n_modes: int) -> MorphableModel:
        """Build the model of `samples` (N, V, 3), aligned neutral faces in mm, by principal component analysis.

        Raises
        ------
        ShapeError
            If `samples` is not (N, V, 3).
        ValueRangeError
            If `n_modes` is not in [1, N - 1], a value is not finite, or the samples span fewer than `n_modes` modes.
        """
        N = check_shape("samples", samples, "N", "V", 3)["N"]
        if not 1 <= n_modes <= N - 1:
            raise ValueRangeError(f"n_modes must be in [1, {N - 1}] for {N} samples, got {n_modes}.")
        check_finite("samples", samples)
        mean = samples.mean(axis=0, dtype=np.float64)
        offsets = (samples - mean).reshape(N, -1)  # float64: small against the mean
        values, vectors = np.linalg.eigh(offsets @ offsets.T)
        values, vectors = values[::-1][:n_modes], vectors[:, ::-1][:, :n_modes]
        if values[-1] <= 1e-10 * max(values[0], 1e-300):
            found = int((values > 1e-10 * max(values[0], 1e-300)).sum())
            raise ValueRangeError(f"n_modes must be at most {found}, the number that the samples span, got {n_modes}.")
        # offsets = U s W^T; a mode at one standard deviation is s W / sqrt(N - 1) = U^T offsets / sqrt(N - 1).
        basis = vectors.T @ offsets / np.sqrt(N - 1)
        basis *= np.where(basis[np.arange(n_modes), np.abs(basis).argmax(axis=1)] < 0, -1.0, 1.0)[:, None]
        shape = (n_modes, *mean.shape)
        return cls(mean.astype(np.float32), basis.reshape(shape).astype(np.float32))

    def truncated(self, n_modes: int) -> MorphableModel:
        """Return the model of the first `n_modes` modes."""
        if not 0 <= n_modes <= self.n_modes:
            raise ValueRangeError(f"n_modes must be in [0, {self.n_modes}], got {n_modes}.")
        return MorphableModel(self.mean_shape, self.identity_basis[:n_modes])

    def synthesise(self, coefficients: NDArray[np.floating]) -> NDArray[np.float32]:
        """Return the face (V, 3), mm, of `coefficients` (up to I of them, in standard deviations)."""
        c = np.asarray(coefficients, dtype=np.float32)
        if c.ndim != 1 or len(c) > self.n_modes:
            raise ValueRangeError(f"coefficients must be (n,) with n <= {self.n_modes}, got shape {c.shape}.")
        check_finite("coefficients", c)
        basis = self.identity_basis[: len(c)].reshape(len(c), -1)
        return self.mean_shape + (c @ basis).reshape(-1, 3)

    def project(
        self,
        vertices: NDArray[np.floating],
        *,
        vertex_weights: NDArray[np.floating] | None = None,
        noise_mm: float = 0.0,
    ) -> NDArray[np.float64]:
        r"""Return the coefficients (I,) whose face is nearest to `vertices`.

        Minimises :math:`\sum_v w_v \|x_v - m_v - \sum_i c_i b_{iv}\|^2 + \sigma^2 \|c\|^2` in closed form.

        Parameters
        ----------
        vertices : ndarray of shape (V, 3), millimetres
        vertex_weights : ndarray of shape (V,), optional
            Non-negative trust in each vertex (0 for a missing one); 1 by default.
        noise_mm : float
            Standard deviation of the measurement noise; 0 for plain least squares, so that
            ``project(synthesise(c)) == c``.
        """
        V = len(self.mean_shape)
        check_shape("vertices", vertices, V, 3)
        weights = np.ones(V) if vertex_weights is None else np.asarray(vertex_weights, dtype=np.float64)
        check_shape("vertex_weights", weights, V)
        if not noise_mm >= 0 or (weights < 0).any():
            raise ValueRangeError("noise_mm and vertex_weights must not be negative.")
        used = np.flatnonzero(weights)
        check_finite("vertices", np.asarray(vertices)[used])
        basis = self.identity_basis[:, used].reshape(self.n_modes, -1).astype(np.float64)
        offset = (np.asarray(vertices, dtype=np.float64)[used] - self.mean_shape[used]).reshape(-1)
        weighted = basis * np.repeat(weights[used], 3)
        normal = weighted @ basis.T + noise_mm**2 * np.eye(self.n_modes)
        return np.linalg.lstsq(normal, weighted @ offset, rcond=None)[0]

    def sample(self, rng: np.random.Generator) -> NDArray[np.float32]:
        """Draw a random face (V, 3), mm, with coefficients from N(0, 1)."""
        return self.synthesise(rng.standard_normal(self.n_modes))
