"""Similarities and rigid motions from corresponding points."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from facewright.errors import DegenerateError, ValueRangeError
from facewright.numeric.check import check_finite, check_shape


class Similarity(NamedTuple):
    """The map x -> scale * rotation x + translation on column vectors; millimetres."""

    scale: float
    rotation: NDArray[np.float64]
    translation: NDArray[np.float64]

    def apply(self, points: NDArray[np.floating[Any]]) -> NDArray[np.float64]:
        """Return points (..., 3) moved."""
        return self.scale * (np.asarray(points) @ self.rotation.T) + self.translation

    def inverse(self) -> Similarity:
        """Return the map back."""
        rotation = self.rotation.T
        return Similarity(1.0 / self.scale, rotation, -(rotation @ self.translation) / self.scale)

    def compose(self, first: Similarity) -> Similarity:
        """Return the map that applies `first`, then this one."""
        rotation = self.rotation @ first.rotation
        return Similarity(self.scale * first.scale, rotation, self.apply(first.translation))


def estimate_similarity(
    source: NDArray[np.floating[Any]],
    target: NDArray[np.floating[Any]],
    *,
    weights: NDArray[np.floating[Any]] | None = None,
    with_scale: bool = True,
) -> Similarity:
    r"""Find the similarity that best moves source points onto target points.

    Minimises :math:`\sum_l w_l \|y_l - (c R x_l + t)\|^2` in closed form; never reflects.

    Parameters
    ----------
    source : ndarray of shape (L, 3), millimetres
        Points x, in the frame to move from. Not modified.
    target : ndarray of shape (L, 3), millimetres
        Points y, same order as `source`.
    weights : ndarray of shape (L,), optional
        w, not negative. Default: all one.
    with_scale : bool
        False gives the best rigid motion, with scale 1.

    Returns
    -------
    Similarity
        `scale` c (no unit), `rotation` R (3, 3) for column vectors, `translation` t (3,), mm.

    Raises
    ------
    ShapeError
        If the arrays are not (L, 3) with the same L.
    ValueRangeError
        If values are not finite or a weight is negative.
    DegenerateError
        If the points lie on one line, or are mirrored and flat, so that no rotation is unique.

    Notes
    -----
    Code and paper [1]_: `covariance` is (38), `sign` (39, 43), R (40), t (41), c (42). Differs from the paper: weights;
    raises where (40) is not unique.

    References
    ----------
    .. [1] Umeyama, PAMI 1991, doi:10.1109/34.88573.

    Examples
    --------
    >>> x = np.eye(3)
    >>> float(round(estimate_similarity(x, 2 * x).scale, 6))
    2.0
    """
    sizes = check_shape("source", source, "L", 3)
    check_shape("target", target, "L", 3, **sizes)
    check_finite("source", source)
    check_finite("target", target)
    w = np.ones(sizes["L"]) if weights is None else np.asarray(weights, dtype=np.float64)
    check_shape("weights", w, "L", **sizes)
    if not (np.isfinite(w) & (w >= 0)).all():
        raise ValueRangeError("weights must be finite and not negative.")
    total = w.sum()
    if total <= 0:
        raise DegenerateError("source must hold at least three points with weight, got none.")
    w = w / total
    x, y = np.asarray(source, dtype=np.float64), np.asarray(target, dtype=np.float64)
    mean_x, mean_y = w @ x, w @ y
    x, y = x - mean_x, y - mean_y
    covariance = (w[:, None] * y).T @ x  # Eq. (38)
    U, d, Vt = np.linalg.svd(covariance)
    sign = np.array([1.0, 1.0, np.sign(np.linalg.det(U @ Vt))])  # Eq. (39), (43)
    spread = np.sqrt((w @ x**2).sum() * (w @ y**2).sum())
    if d[1] + sign[2] * d[2] <= 1e-12 * max(d[0], 1e-3 * spread) or spread == 0:
        raise DegenerateError("source and target must not lie on one line.")
    rotation = (U * sign) @ Vt  # Eq. (40)
    scale = float(d @ sign / (w @ x**2).sum()) if with_scale else 1.0  # Eq. (42)
    return Similarity(scale, rotation, mean_y - scale * rotation @ mean_x)  # Eq. (41)
