"""Rigid motion out of moving meshes: ordinary and generalised Procrustes analysis without scaling."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from facewright.errors import DegenerateError, ValueRangeError
from facewright.numeric.check import check_finite, check_shape

Array = NDArray[np.float64]


class RigidMotions(NamedTuple):
    """T rigid motions x -> rotation x + translation: rotations (T, 3, 3), translations (T, 3), mm."""

    rotations: Array
    translations: Array

    def apply(self, points: NDArray[np.floating]) -> Array:
        """Return points (T, N, 3) moved, each frame by its motion."""
        return np.asarray(points) @ self.rotations.transpose(0, 2, 1) + self.translations[:, None]

    def inverse(self) -> RigidMotions:
        """Return the motions back."""
        back = self.rotations.transpose(0, 2, 1)
        return RigidMotions(back, -np.einsum("tij,tj->ti", back, self.translations))

    def compose(self, first: RigidMotions) -> RigidMotions:
        """Return the motions that apply `first`, then these."""
        shifted = np.einsum("tij,tj->ti", self.rotations, first.translations) + self.translations
        return RigidMotions(self.rotations @ first.rotations, shifted)


def rigid_motions(
    shapes: NDArray[np.floating], reference: NDArray[np.floating], weights: NDArray[np.floating] | None = None
) -> RigidMotions:
    r"""Find the rigid motion of every shape that best takes it onto a reference (ordinary Procrustes analysis).

    Minimises :math:`\sum_n w_{tn} |R_t x_{tn} + s_t - y_n|^2` for all frames t at once; never reflects, never scales.

    Parameters
    ----------
    shapes : ndarray of shape (T, N, 3), millimetres
    reference : ndarray of shape (N, 3), millimetres
    weights : ndarray of shape (N,) or (T, N), optional
        Not negative; vertices that do not deform deserve more. Values under weight 0 may be NaN.

    Raises
    ------
    ShapeError, ValueRangeError
        If shapes do not match, a weight is negative or a value with weight is not finite.
    DegenerateError
        If the points of a frame with weight lie on one line.
    """
    T, N = check_shape("shapes", shapes, "T", "N", 3).values()
    check_shape("reference", reference, N, 3)
    check_finite("reference", reference)
    w = np.ones((T, N)) if weights is None else np.broadcast_to(np.asarray(weights, dtype=np.float64), (T, N))
    if not (np.isfinite(w) & (w >= 0)).all():
        raise ValueRangeError("weights must be finite and not negative.")
    x = np.where((w > 0)[..., None], np.asarray(shapes, dtype=np.float64), 0.0)
    check_finite("shapes", x)
    total = w.sum(axis=1, keepdims=True)
    if T and total.min() <= 0:
        raise DegenerateError("every frame must have points with weight, got one without.")
    w = w / total
    y = np.asarray(reference, dtype=np.float64)
    mean_x, mean_y = np.einsum("tn,tnc->tc", w, x), w @ y
    covariance = np.einsum("tn,tni,tnj->tij", w, y - mean_y[:, None], x - mean_x[:, None], optimize=True)
    U, d, Vt = np.linalg.svd(covariance)
    sign = np.linalg.det(U @ Vt)
    if T and (d[:, 1] <= 1e-12 * np.maximum(d[:, 0], 1e-300)).any():
        raise DegenerateError("the points of every frame must not lie on one line.")
    U[:, :, 2] *= sign[:, None]
    rotations = U @ Vt
    return RigidMotions(rotations, mean_y - np.einsum("tij,tj->ti", rotations, mean_x))


def generalised_procrustes(
    shapes: NDArray[np.floating], *, rounds: int = 50, tolerance_mm: float = 1e-4
) -> tuple[Array, RigidMotions]:
    """Align shapes to one another: the mean (N, 3) that all are aligned to, and each one's motion onto it.

    Raises
    ------
    ShapeError, ValueRangeError, DegenerateError
        As `rigid_motions`; or if there is no shape.
    """
    if not len(shapes):
        raise ValueRangeError("shapes must hold at least one shape, got none.")
    mean = np.asarray(shapes[0], dtype=np.float64)
    for _ in range(rounds):
        motions = rigid_motions(shapes, mean)
        following = motions.apply(shapes).mean(axis=0)
        # the mean keeps the first shape's place
        following = rigid_motions(following[None], np.asarray(shapes[0])).apply(following[None])[0]
        change = float(np.sqrt(((following - mean) ** 2).sum(axis=1).mean()))
        mean = following
        if change < tolerance_mm:
            break
    return mean, rigid_motions(shapes, mean)


def stable_weights(shapes: NDArray[np.floating], reference: NDArray[np.floating], *, rounds: int = 5) -> Array:
    """Return weights (N,) of vertices by how little they move against the others: large where the skull is near.

    Alternates between aligning by the weights and measuring how much each vertex still moves.
    """
    w = np.ones(len(reference))
    for _ in range(rounds):
        moved = rigid_motions(shapes, reference, w).apply(shapes)
        size = np.sqrt(((moved - reference) ** 2).sum(axis=2).mean(axis=0))
        w = 1.0 / (size**2 + (0.3 * np.median(size)) ** 2 + 0.05**2)
        w = w / w.max()
    return np.asarray(w)
