"""A region-based linear model: a linear basis for each of several regions that share vertices."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from facewright.errors import ShapeError, ValueRangeError
from facewright.models.regions import Regions
from facewright.numeric.check import check_finite, check_indices, check_shape


@dataclass(frozen=True, eq=False)
class RegionModel:
    """v^i = neutral^i + mean^i + B^i c^i for each region i (eq. 1 and 5 of Tena et al. 2011).

    Coefficients zeta = [c^1; ...; c^M] are stacked region by region.

    Parameters
    ----------
    faces : ndarray of shape (F, 3), int32
        Triangles of the mesh of N vertices.
    neutral : ndarray of shape (N, 3), float64, millimetres
        The face that displacements are added to; another person's may take its place.
    regions : Regions
    means : tuple of ndarray of shape (N_i, 3), float64, millimetres
        Displacement of each region at zero coefficients.
    bases : tuple of ndarray of shape (P_i, N_i, 3), float64
        B^i, one row a basis vector. Of PCA orthonormal, so that a coefficient is in millimetres, as beta and gamma of
        the paper mean it; of blendshapes displacements in millimetres at weight one.
    deviations : tuple of ndarray of shape (P_i,), float64
        Standard deviation of each coefficient in the training data.
    units : tuple of ndarray of shape (P_i,), float64, millimetres
        What gamma counts a coefficient of one as: 1 for an orthonormal basis, the displacement's norm for blendshapes.
    lower, upper : tuple of ndarray of shape (P_i,), float64
        Bounds of the coefficients; infinite for PCA, 0 and 1 for blendshapes.
    coefficient_names : tuple of tuple of str
        Names of each region's coefficients.
    provenance : mapping, optional
        Where it comes from (JSON types only).

    Raises
    ------
    ShapeError, ValueRangeError
        If arrays do not match or a value is not finite.
    """

    faces: NDArray[np.int32]
    neutral: NDArray[np.float64]
    regions: Regions
    means: tuple[NDArray[np.float64], ...]
    bases: tuple[NDArray[np.float64], ...]
    deviations: tuple[NDArray[np.float64], ...]
    units: tuple[NDArray[np.float64], ...]
    lower: tuple[NDArray[np.float64], ...]
    upper: tuple[NDArray[np.float64], ...]
    coefficient_names: tuple[tuple[str, ...], ...]
    provenance: Mapping[str, Any] = field(default_factory=dict)

    def __post_init__(self) -> None:
        N = self.regions.n_vertices
        check_shape("neutral", self.neutral, N, 3)
        check_finite("neutral", self.neutral)
        check_shape("faces", self.faces, "F", 3)
        check_indices("faces", self.faces, N)
        per_region = ("means", "bases", "deviations", "units", "lower", "upper", "coefficient_names")
        M = len(self.regions.members)
        if any(len(getattr(self, name)) != M for name in per_region):
            raise ShapeError(f"a model of {M} regions needs {M} means, bases, deviations, units, bounds and names.")
        for i, ids in enumerate(self.regions.members):
            sizes = check_shape(f"bases[{i}]", self.bases[i], "P", len(ids), 3)
            check_shape(f"means[{i}]", self.means[i], len(ids), 3)
            for name in ("deviations", "units", "lower", "upper"):
                check_shape(f"{name}[{i}]", getattr(self, name)[i], "P", **sizes)
            for name in ("bases", "means", "deviations", "units"):
                check_finite(f"{name}[{i}]", getattr(self, name)[i])
            if (self.lower[i] > self.upper[i]).any() or len(self.coefficient_names[i]) != sizes["P"]:
                raise ValueRangeError(f"region {i} must have ordered bounds and a name for each coefficient.")

    @property
    def n_vertices(self) -> int:
        """Number of vertices N."""
        return self.regions.n_vertices

    @property
    def offsets(self) -> NDArray[np.intp]:
        """Where each region's coefficients begin in zeta, (M + 1,)."""
        return np.concatenate([[0], np.cumsum([len(basis) for basis in self.bases])])

    @property
    def n_coefficients(self) -> int:
        """Length of zeta."""
        return int(self.offsets[-1])
