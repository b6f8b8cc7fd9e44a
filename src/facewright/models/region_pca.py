"""Linear bases of regions: PCA of each region's motion, blendshapes, or any other (Tena et al. 2011, section 3.1)."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from facewright.errors import ShapeError, ValueRangeError
from facewright.models.blendshapes import BlendshapeRig
from facewright.models.region_model import RegionModel
from facewright.models.regions import Regions
from facewright.numeric.check import check_finite, check_shape
from facewright.numeric.threads import one_blas_thread

_RANK = 1e-10  # of the largest variance: below, a direction is rounding
_STILL_MM = 0.02  # a shape that moves no vertex of a region this far does not belong to it
_BATCH_BYTES = 64e6


def fit_region_pca(
    displacements: NDArray[np.floating[Any]],
    faces: NDArray[np.integer[Any]],
    neutral: NDArray[np.floating[Any]],
    regions: Regions,
    n_components: int | float = 15,
    *,
    centred: bool = False,
    provenance: Mapping[str, Any] | None = None,
) -> RegionModel:
    """Train one PCA for each region on displacements from the neutral; a single region is the holistic model.

    Parameters
    ----------
    displacements : ndarray of shape (T, N, 3), millimetres
        Frames without head motion, each minus its own performer's neutral.
    faces : ndarray of shape (F, 3), int
    neutral : ndarray of shape (N, 3), millimetres
        The face that the model poses.
    regions : Regions
    n_components : int or float
        Components of each region (fewer where its motion has fewer), or the share of its squared motion to keep,
        in (0, 1).
    centred : bool
        Subtract the mean displacement first. By default not, as eq. 1 has it: zero coefficients are the neutral.
    provenance : mapping, optional
        JSON types only.

    Returns
    -------
    RegionModel
        Orthonormal bases, coefficients in millimetres; `deviations` are the root mean squares of the coefficients.

    Raises
    ------
    ShapeError, ValueRangeError
        If arrays do not match, a value is not finite, there are fewer than two frames, or `n_components` is not
        positive.
    """
    N = regions.n_vertices
    T = check_shape("displacements", displacements, "T", N, 3)["T"]
    if T < 2:
        raise ValueRangeError(f"PCA needs at least 2 frames, got {T}.")
    check_finite("displacements", displacements)
    fraction = isinstance(n_components, float | np.floating) and 0.0 < n_components < 1.0
    if not fraction and (n_components < 1 or n_components != int(n_components)):
        raise ValueRangeError(f"n_components must be a positive integer or a share in (0, 1), got {n_components}.")
    means, bases, deviations = [], [], []
    with one_blas_thread():
        for ids in regions.members:
            mean, second = _moments(displacements, ids)
            if not centred:
                second += np.outer(mean, mean)
                mean = np.zeros_like(mean)
            variances, directions = _principal(second)
            P = _count(variances, n_components, fraction)
            means.append(mean.reshape(-1, 3))
            bases.append(directions[:P].reshape(P, len(ids), 3))
            deviations.append(np.sqrt(variances[:P]))
    return RegionModel(
        faces=np.asarray(faces, dtype=np.int32),
        neutral=np.asarray(neutral, dtype=np.float64),
        regions=regions,
        means=tuple(means),
        bases=tuple(bases),
        deviations=tuple(deviations),
        units=tuple(np.ones(len(basis)) for basis in bases),
        lower=tuple(np.full(len(basis), -np.inf) for basis in bases),
        upper=tuple(np.full(len(basis), np.inf) for basis in bases),
        coefficient_names=tuple(
            tuple(f"{name}_{p + 1}" for p in range(len(basis)))
            for name, basis in zip(regions.names, bases, strict=True)
        ),
        provenance={"basis": "pca", "centred": centred, "frames": T, **(provenance or {})},
    )


def region_basis(
    rig: BlendshapeRig,
    regions: Regions,
    faces: NDArray[np.integer[Any]],
    *,
    provenance: Mapping[str, Any] | None = None,
) -> RegionModel:
    """Give each region the blendshapes that move it, bounded to [0, 1]; the rig has the model's N vertices.

    Parameters
    ----------
    rig : BlendshapeRig
    regions : Regions
    faces : ndarray of shape (F, 3), int
    provenance : mapping, optional

    Returns
    -------
    RegionModel
        Coefficients are blendshape weights; a shape that moves no vertex of a region by 0.02 mm is left out there.

    Raises
    ------
    ShapeError
        If the rig has other vertices than the regions.
    """
    return linear_region_model(
        rig.neutral, rig.deltas, rig.names, regions, faces, bounds=(0.0, 1.0),
        provenance={"basis": "blendshapes", **(provenance or {})},
    )  # fmt: skip


def linear_region_model(
    neutral: NDArray[np.floating[Any]],
    basis: NDArray[np.floating[Any]],
    names: Sequence[str],
    regions: Regions,
    faces: NDArray[np.integer[Any]],
    *,
    bounds: tuple[float, float] = (-np.inf, np.inf),
    deviation: float = 1.0,
    provenance: Mapping[str, Any] | None = None,
) -> RegionModel:
    """Cut any linear basis (P, N, 3), mm at a coefficient of one, into regions.

    Parameters
    ----------
    neutral : ndarray of shape (N, 3), millimetres
    basis : ndarray of shape (P, N, 3), millimetres
    names : sequence of str
        Of the P vectors.
    regions : Regions
    faces : ndarray of shape (F, 3), int
    bounds : (float, float)
        Of every coefficient.
    deviation : float
        Of every coefficient, where training data say nothing.
    provenance : mapping, optional

    Returns
    -------
    RegionModel
        `units` are the lengths of the vectors in each region, so that gamma counts millimetres.

    Raises
    ------
    ShapeError, ValueRangeError
        If arrays do not match or a value is not finite.
    """
    vectors = np.asarray(basis, dtype=np.float64)
    check_shape("basis", vectors, "P", regions.n_vertices, 3)
    if len(names) != len(vectors):
        raise ShapeError(f"names must hold one name for each of {len(vectors)} vectors, got {len(names)}.")
    check_finite("basis", vectors)
    moving = [np.abs(vectors[:, ids]).max(axis=(1, 2), initial=0.0) > _STILL_MM for ids in regions.members]
    bases = [vectors[kept][:, ids] for kept, ids in zip(moving, regions.members, strict=True)]
    return RegionModel(
        faces=np.asarray(faces, dtype=np.int32),
        neutral=np.asarray(neutral, dtype=np.float64),
        regions=regions,
        means=tuple(np.zeros((len(ids), 3)) for ids in regions.members),
        bases=tuple(bases),
        deviations=tuple(np.full(len(part), deviation) for part in bases),
        units=tuple(np.linalg.norm(part, axis=(1, 2)) for part in bases),
        lower=tuple(np.full(len(part), float(bounds[0])) for part in bases),
        upper=tuple(np.full(len(part), float(bounds[1])) for part in bases),
        coefficient_names=tuple(
            tuple(f"{region}_{name}" for name, keep in zip(names, kept, strict=True) if keep)
            for region, kept in zip(regions.names, moving, strict=True)
        ),
        provenance={"basis": "linear", **(provenance or {})},
    )


def _moments(
    displacements: NDArray[np.floating[Any]], ids: NDArray[np.int32]
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return mean (3 N_i,) and covariance (3 N_i, 3 N_i) of a region, in float64, few frames at a time."""
    T, width = len(displacements), 3 * len(ids)
    batch = max(1, int(_BATCH_BYTES / (8 * width)))
    mean = np.zeros(width)
    for start in range(0, T, batch):
        mean += displacements[start : start + batch, ids].reshape(-1, width).sum(axis=0, dtype=np.float64)
    mean /= T
    covariance = np.zeros((width, width))
    for start in range(0, T, batch):
        part = displacements[start : start + batch, ids].reshape(-1, width).astype(np.float64) - mean
        covariance += part.T @ part
    return mean, covariance / T


def _principal(second: NDArray[np.float64]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return variances, decreasing, and directions (P, 3 N_i) of more than rounding; the largest entry positive."""
    values, vectors = np.linalg.eigh(second)
    values, vectors = values[::-1], vectors[:, ::-1].T
    kept = values > _RANK * max(values[0], 1e-300)
    values, vectors = values[kept], vectors[kept]
    largest = np.abs(vectors).argmax(axis=1)
    signs = np.where(vectors[np.arange(len(vectors)), largest] < 0.0, -1.0, 1.0)
    return values, vectors * signs[:, None]


def _count(variances: NDArray[np.float64], n_components: int | float, fraction: bool) -> int:
    if not fraction:
        return min(int(n_components), len(variances))
    shares = np.cumsum(variances) / max(float(variances.sum()), 1e-300)
    return min(int(np.searchsorted(shares, n_components)) + 1, len(variances))
