"""Which blendshape weights an actor really used in poses that were asked for, and how far each shape goes."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from facewright.numeric.bounded_least_squares import solve_bounded_quadratic

_LEAST_GUIDE = 0.03  # smaller guide weights say nothing about a shape's amplitude
_LEAST_REACH = 0.02


@dataclass(frozen=True)
class ActingPrior:
    """What is expected of actors and of faces before the poses are seen; all without unit unless stated.

    Parameters
    ----------
    weight_spread : float
        Standard deviation of an acted weight, as a share of the guide's weight.
    spurious_weight : float
        Standard deviation of an acted weight where the guide's is zero.
    amplitude_spread : float
        Standard deviation of the log of how far a person goes with a shape, relative to the generic shape.
    coupling : float
        Correlation of that log within coupled shapes (left and right).
    performance_spread : float
        Standard deviation of the log of one acted weight over its guide.
    pose_spread : float
        Standard deviation of the log of a factor that all weights of one pose share.
    reach_error : float
        Standard deviation of an estimated product of weight and amplitude.
    shape_spread : float
        Deviation of a personal shape from the scaled generic one, as a share of its displacement.
    surface_noise_mm : float
        Standard deviation of the surface noise in poses, mm.
    independent_points : float
        How many independent measurements a surface is worth: both deviations are smooth, vertices are not independent.
    highest_weight : float
        Upper bound on product of weight and amplitude.
    """

    weight_spread: float = 0.25
    spurious_weight: float = 0.02
    amplitude_spread: float = 0.15
    coupling: float = 0.9
    performance_spread: float = 0.13
    pose_spread: float = 0.1
    reach_error: float = 0.03
    shape_spread: float = 0.15
    surface_noise_mm: float = 0.3
    independent_points: float = 100.0
    highest_weight: float = 1.25


def weight_energies(
    deltas: NDArray[np.float64],
    displacements: NDArray[np.float64],
    guide: NDArray[np.float64],
    prior: ActingPrior,
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return Hessians (N, B, B) and linear terms (N, B) of the data term of every pose.

    Vertices count less where the pose moves them more, since personal shapes deviate from the model there.

    Parameters
    ----------
    deltas : ndarray of shape (B, V, 3), mm
        Blendshapes.
    displacements : ndarray of shape (N, V, 3), mm
        Poses minus neutral.
    guide : ndarray of shape (N, B)
        Expected weights.
    prior : ActingPrior
        Noise and deviations.
    """
    B, V = deltas.shape[:2]
    flat = np.ascontiguousarray(deltas).reshape(B, -1)
    weighted = np.zeros_like(flat)
    variance = (
        prior.shape_spread**2 / 3.0 * (guide**2 @ np.einsum("bvx,bvx->bv", deltas, deltas)) + prior.surface_noise_mm**2
    )
    precision = prior.independent_points / V / variance
    H, c = np.zeros((len(guide), B, B)), np.zeros((len(guide), B))
    for j in range(len(guide)):
        np.multiply(flat, np.repeat(precision[j], 3), out=weighted)
        H[j] = weighted @ flat.T
        c[j] = weighted @ displacements[j].ravel()
    return H, c


def estimate_reach(
    deltas: NDArray[np.float64],
    displacements: NDArray[np.float64],
    guide: NDArray[np.float64],
    prior: ActingPrior,
) -> NDArray[np.float64]:
    """Estimate the weights (N, B) with which blendshapes explain poses, near the guide's and within bounds.

    Per pose: bounded least squares with prior ||alpha - alpha*||^2 (Li et al. 2010, weight step). In a basis of generic
    shapes the result is the *reach*, acted weight times the person's amplitude; only that product can be seen.
    """
    H, c = weight_energies(deltas, displacements, guide, prior)
    gamma = 1.0 / (prior.spurious_weight**2 + (prior.weight_spread * guide) ** 2)
    H += gamma[:, :, None] * np.eye(guide.shape[1])
    return solve_bounded_quadratic(H, c + gamma * guide, 0.0, prior.highest_weight, start=guide)


def split_amplitudes(
    reach: NDArray[np.float64],
    guide: NDArray[np.float64],
    coupled: Sequence[tuple[int, int]],
    prior: ActingPrior,
) -> NDArray[np.float64]:
    """Split reach into acted weight times amplitude; return the amplitudes (B,).

    The mixed model log(reach_ji / guide_ji) = log a_i + e_j + noise has its amplitudes a_i coupled (left and right), a
    factor e_j of each pose, and known variances: the posterior mean is one small linear system. This fixes the gauge
    between shapes and weights, which the poses themselves leave open.
    """
    n_poses, B = guide.shape
    covariance = np.eye(B)
    for i, k in coupled:
        covariance[i, k] = covariance[k, i] = prior.coupling
    used = (guide > _LEAST_GUIDE) & (reach > _LEAST_REACH)
    pose, shape = np.nonzero(used)
    log_ratio = np.log(reach[used] / guide[used])
    precision = 1.0 / (prior.performance_spread**2 + (prior.reach_error / guide[used]) ** 2)
    X = np.zeros((len(log_ratio), B + n_poses))
    X[np.arange(len(X)), shape] = 1.0
    X[np.arange(len(X)), B + pose] = 1.0
    expected = np.zeros((B + n_poses, B + n_poses))
    expected[:B, :B] = np.linalg.inv(covariance * prior.amplitude_spread**2)
    expected[B:, B:] = np.eye(n_poses) / prior.pose_spread**2
    weighted = X * precision[:, None]
    return np.exp(np.linalg.solve(weighted.T @ X + expected, weighted.T @ log_ratio)[:B])


def estimate_amplitudes(
    deltas: NDArray[np.float64],
    displacements: NDArray[np.float64],
    weights: NDArray[np.float64],
    coupled: Sequence[tuple[int, int]],
    prior: ActingPrior,
) -> NDArray[np.float64]:
    """Estimate the amplitudes (B,) of generic shapes when the acted weights (N, B) are known: linear least squares."""
    H, c = weight_energies(deltas, displacements, weights, prior)
    covariance: NDArray[Any] = np.eye(deltas.shape[0])
    for i, k in coupled:
        covariance[i, k] = covariance[k, i] = prior.coupling
    expected = np.linalg.inv(covariance * prior.amplitude_spread**2)
    normal = np.einsum("jab,ja,jb->ab", H, weights, weights) + expected
    return np.linalg.solve(normal, (c * weights).sum(axis=0) + expected.sum(axis=1))
