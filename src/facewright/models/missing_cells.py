"""Fill missing (person, expression) cells of a face tensor by expectation-maximisation (Vlasic et al. 2005)."""

from __future__ import annotations

import warnings
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from facewright.errors import ConvergenceWarning, DegenerateError, ShapeError, ValueRangeError
from facewright.models.bilinear_projection import gram_of_rows
from facewright.models.nmode_svd import NModeSVD, Progress, nmode_svd


class FilledTensor(NamedTuple):
    """Result of `fill_missing_cells`.

    Attributes
    ----------
    tensor : ndarray of shape (N, S, V, 3), float32
        Present cells as given, missing ones estimated.
    noise_mm : float
        Estimated noise of a coordinate: what the model leaves of the present cells.
    iterations : int
    last_change_mm : float
        RMS movement of the filled cells in the last iteration.
    """

    tensor: NDArray[np.float32]
    noise_mm: float
    iterations: int
    last_change_mm: float


def fill_missing_cells(
    tensor: NDArray[np.floating],
    present: NDArray[np.bool_],
    n_identity: int,
    n_expression: int,
    *,
    max_iterations: int = 30,
    tolerance_mm: float = 0.01,
    progress: Progress | None = None,
) -> FilledTensor:
    """Estimate the cells that were never captured from the person's others and from other people's.

    Every person needs one present cell, every expression one person who has it.

    Parameters
    ----------
    tensor : ndarray of shape (N, S, V, 3), millimetres
        Content of missing cells is ignored (may be NaN). Not modified.
    present : ndarray of shape (N, S), bool
    n_identity, n_expression : int
        Components of the model that explains the data; fewer than for the final model, where few cells are present.
    max_iterations : int
    tolerance_mm : float
        Stop when an iteration moves the filled cells by less, RMS.
    progress : callable(stage, done, total), optional

    Returns
    -------
    FilledTensor

    Raises
    ------
    ShapeError
        If `present` is not (N, S).
    DegenerateError
        If a person or an expression has no cell at all.
    ValueRangeError
        If a present cell is not finite.

    Warns
    -----
    ConvergenceWarning
        If the limit is reached first.

    Notes
    -----
    Vlasic et al. (2005), section 4: the tensor is a multilinear model plus isotropic Gaussian noise. E-step: the
    posterior mean of each incomplete person's identity weights given the present cells, with the training weights' mean
    and covariance as prior, and by it the missing cells. M-step: N-mode SVD of the completed tensor, and the noise.
    Differs from the paper: its E-step joins the models of all modes in one linear system; here identity alone is
    marginalised, and the expression mode is refitted in the M-step.
    """
    mask = np.asarray(present)
    _check_cells(tensor, mask)
    filled = np.array(tensor, dtype=np.float32)
    missing = ~mask
    if not missing.any():
        return FilledTensor(filled, 0.0, 0, 0.0)
    _fill_by_addition(filled, mask)
    noise_mm, change = 0.0, np.inf
    for iteration in range(1, max_iterations + 1):
        svd = nmode_svd(filled, n_identity, n_expression)
        change, noise_mm = _expect(filled, mask, svd, noise_mm)
        if progress is not None:
            progress("missing cells", iteration, max_iterations)
        if change < tolerance_mm:
            break
    else:
        warnings.warn(
            f"missing cells still move by {change:.2g} mm after {max_iterations} iterations.",
            ConvergenceWarning,
            stacklevel=2,
        )
    return FilledTensor(filled, noise_mm, iteration, change)


def _check_cells(tensor: Any, present: NDArray[np.bool_]) -> None:
    if np.ndim(tensor) != 4 or tensor.shape[3] != 3:
        raise ShapeError(f"tensor must have shape (N, S, V, 3), got {np.shape(tensor)}.")
    if present.shape != tensor.shape[:2] or present.dtype != np.bool_:
        raise ShapeError(f"present must be bool {tensor.shape[:2]}, got {present.dtype} {present.shape}.")
    for axis, name in ((1, "person"), (0, "expression")):
        empty = np.flatnonzero(~present.any(axis=axis))
        if len(empty):
            raise DegenerateError(f"every {name} must have a present cell, got none for {name} {empty[0]}.")
    for person, row in enumerate(present):
        if not np.isfinite(tensor[person, row]).all():
            raise ValueRangeError(f"present cells must be finite, got NaN or infinity for person {person}.")


def _fill_by_addition(filled: NDArray[np.float32], present: NDArray[np.bool_]) -> None:
    """Start: missing cell = the expression's mean + the person's mean offset from the means of the present cells."""
    means = np.stack([filled[present[:, s], s].mean(axis=0, dtype=np.float64) for s in range(present.shape[1])])
    for person in np.flatnonzero(~present.all(axis=1)):
        here = present[person]
        offset = (filled[person, here] - means[here]).mean(axis=0)
        filled[person, ~here] = means[~here] + offset


def _expect(
    filled: NDArray[np.float32], present: NDArray[np.bool_], svd: NModeSVD, noise_mm: float
) -> tuple[float, float]:
    """Replace the missing cells by their expectation; return their RMS movement and the new noise, mm."""
    N, S = present.shape
    I, E = svd.core.shape[:2]
    identity = np.sqrt(N) * svd.identity_factors
    expression = np.sqrt(S) * svd.expression_factors
    rows = svd.core.reshape(I * E, -1) * np.float32(1 / np.sqrt(N * S))
    gram = gram_of_rows(rows).reshape(I, E, I, E)
    mean = identity.mean(axis=0)
    covariance = np.cov(identity, rowvar=False, bias=True).reshape(I, I)
    values, vectors = np.linalg.eigh(covariance)
    precision = (vectors / np.maximum(values, 1e-6 * values[-1])) @ vectors.T

    moved = squares = 0.0
    n_missing = n_present = 0
    for person in np.flatnonzero(~present.all(axis=1)):
        here = present[person]
        u = expression[here]
        # Normal equations of w: sum over the present expressions of (C x3 u)^T (C x3 u).
        second_moment = u.T @ u
        matrix = np.einsum("iejf,ef->ij", gram, second_moment, optimize=True)
        observed = filled[person, here].reshape(len(u), -1)
        mixture = u.T.astype(np.float32) @ observed  # (E, 3V)
        rhs = np.matmul(rows.reshape(I, E, -1).reshape(I, -1), mixture.reshape(-1)).astype(np.float64)
        w = np.linalg.solve(matrix + noise_mm**2 * precision, rhs + noise_mm**2 * precision @ mean)
        shapes = (w.astype(np.float32) @ rows.reshape(I, -1)).reshape(E, -1)
        residual = observed - u.astype(np.float32) @ shapes
        squares += float(np.vdot(residual, residual))
        n_present += residual.size
        estimate = (expression[~here].astype(np.float32) @ shapes).reshape(-1, *filled.shape[2:])
        moved += float(((estimate - filled[person, ~here]) ** 2).sum())
        n_missing += len(estimate) * filled.shape[2]
        filled[person, ~here] = estimate
    # Residuals of n coordinates with I fitted weights per person; n >> I.
    return float(np.sqrt(moved / n_missing)), float(np.sqrt(squares / n_present))
