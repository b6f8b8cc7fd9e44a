"""How much two vertices belong together: they move alike and lie near each other (Tena et al. 2011, 4.2)."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from facewright.errors import ShapeError, ValueRangeError
from facewright.mesh.connectivity import vertex_components
from facewright.mesh.geodesics import path_distances
from facewright.numeric.check import check_finite, check_shape

#: The paper's parameters: correlations below the threshold count nothing; r of eq. (11) in mm; lambda of eq. (12).
CORRELATION_THRESHOLD = 0.7
RADIUS_MM = 10.0
CORRELATION_SHARE = 0.7
#: A coordinate that moves less than this (standard deviation) stands still; its correlation is undefined.
_STILL_MM = 1e-4
_MIN_FRAMES = 2


def still_coordinates(positions: NDArray[np.floating[Any]]) -> NDArray[np.bool_]:
    """Return which coordinates (N, 3) of moving vertices (T, N, 3), mm, never move by more than a ten-thousandth mm."""
    check_shape("positions", positions, "T", "N", 3)
    return np.asarray(positions, dtype=np.float64).std(axis=0) < _STILL_MM


def vertex_correlation(positions: NDArray[np.floating[Any]]) -> NDArray[np.float64]:
    """Return C, the mean of the normalised correlation matrices of x, y and z.

    Parameters
    ----------
    positions : ndarray of shape (T, N, 3), millimetres
        Frames of one mesh without rigid motion.

    Returns
    -------
    ndarray of shape (N, N), float64, in [-1, 1]
        Of two vertices the mean over those coordinates in which both move; zero if there is none. A vertex with itself
        one, also if it never moves.

    Raises
    ------
    ShapeError, ValueRangeError
        If there are fewer than two frames, a value is not finite, or no vertex moves at all.
    """
    sizes = check_shape("positions", positions, "T", "N", 3)
    check_finite("positions", positions)
    if sizes["T"] < _MIN_FRAMES:
        raise ValueRangeError(
            f"correlation needs at least {_MIN_FRAMES} frames, got {sizes['T']}: give a clip in which the face moves."
        )
    still = still_coordinates(positions)
    if still.all():
        raise ValueRangeError(
            "correlation needs vertices that move, got frames that are all alike: give a clip in which the face moves."
        )
    total = np.zeros((sizes["N"], sizes["N"]))
    count = np.zeros_like(total)
    for axis in range(3):
        column = np.asarray(positions[:, :, axis], dtype=np.float64)
        moves = ~still[:, axis]
        column = np.where(moves, column - column.mean(axis=0), 0.0)
        column /= np.where(moves, np.linalg.norm(column, axis=0), 1.0)
        total += column.T @ column
        count += np.outer(moves, moves)
    correlation = np.clip(total / np.maximum(count, 1.0), -1.0, 1.0)
    np.fill_diagonal(correlation, 1.0)
    return correlation


def nearness(
    vertices: NDArray[np.floating[Any]], faces: NDArray[np.integer[Any]], radius_mm: float = RADIUS_MM
) -> NDArray[np.float64]:
    """Return e^(-G / r), G the lengths of shortest paths along the edges (eq. 11).

    Parameters
    ----------
    vertices : ndarray of shape (N, 3), millimetres
        The template at rest.
    faces : ndarray of shape (F, 3), int
    radius_mm : float
        r: the paper's 10 mm bring it near zero beyond 50 mm.

    Returns
    -------
    ndarray of shape (N, N), float64, in (0, 1]

    Raises
    ------
    ShapeError, ValueRangeError
        If shapes are wrong, the radius is not positive, or the mesh is not of one piece.
    """
    N = check_shape("vertices", vertices, "N", 3)["N"]
    if not (np.isfinite(radius_mm) and radius_mm > 0):
        raise ValueRangeError(f"radius_mm must be positive, got {radius_mm}.")
    pieces = vertex_components(faces, N)
    if pieces.max(initial=0) > 0:
        raise ValueRangeError(
            f"the mesh must be of one piece for distances along it, got {int(pieces.max()) + 1} pieces of "
            f"{_sizes(pieces)} vertices: segment one piece, or join them."
        )
    # along edges, as Isomap does
    G = path_distances(vertices, faces, np.arange(N), diagonals=False)
    return np.asarray(np.exp(-G / radius_mm))  # Eq. (11)


def region_affinity(
    correlation: NDArray[np.floating[Any]],
    near: NDArray[np.floating[Any]],
    *,
    share: float = CORRELATION_SHARE,
    threshold: float = CORRELATION_THRESHOLD,
) -> NDArray[np.float64]:
    """Return A = lambda C + (1 - lambda) e^(-G / r) (eq. 12), C without values below the threshold.

    Parameters
    ----------
    correlation, near : ndarray of shape (N, N)
        See `vertex_correlation` and `nearness`.
    share : float in [0, 1]
        lambda: 1 is correlation alone, 0 distance alone.
    threshold : float in [0, 1]

    Returns
    -------
    ndarray of shape (N, N), float64, in [0, 1]

    Raises
    ------
    ShapeError, ValueRangeError
        If shapes do not match or a parameter is out of range.
    """
    sizes = check_shape("correlation", correlation, "N", "N")
    if near.shape != correlation.shape:
        raise ShapeError(f"near must have the shape of correlation, {(sizes['N'],) * 2}, got {near.shape}.")
    for name, value in (("share (lambda)", share), ("threshold", threshold)):
        if not 0.0 <= value <= 1.0:
            raise ValueRangeError(f"{name} must lie in [0, 1], got {value}.")
    C = np.where(correlation >= threshold, correlation, 0.0)
    return np.asarray(share * C + (1.0 - share) * near, dtype=np.float64)  # Eq. (12)


def _sizes(pieces: NDArray[np.int32]) -> str:
    sizes = np.sort(np.bincount(pieces))[::-1]
    return ", ".join(map(str, sizes[:4].tolist())) + (", ..." if len(sizes) > 4 else "")
