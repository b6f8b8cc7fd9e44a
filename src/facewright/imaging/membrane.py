"""A membrane on a grid: displacements known here and there, extended smoothly everywhere."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from facewright.imaging._membrane_kernels import coarsen, refine, relax
from facewright.numeric.check import check_shape

_SMALLEST = 4  # cells along the shorter side of the coarsest grid
_SWEEPS, _OVER = 40, np.float32(1.8)


def stretch_membrane(
    weight: NDArray[np.floating],
    moment: NDArray[np.floating],
    stiffness: NDArray[np.floating],
    fixed: NDArray[np.bool_],
) -> NDArray[np.float32]:
    """Return the displacements D that minimise sum_cells weight |D - moment / weight|^2 + sum_edges stiffness |dD|^2.

    Solved from coarse to fine grids, each relaxed from the one before: as smooth as a frame needs, not to the last
    digit.

    Parameters
    ----------
    weight, moment : ndarray of shape (2, rows, columns)
        How strongly each component is known, and the weighted values.
    stiffness : ndarray of shape (rows, columns), positive
        Of each cell; an edge between two cells has their mean.
    fixed : ndarray of shape (rows, columns), bool
        Cells that stay at 0.

    Returns
    -------
    ndarray of shape (2, rows, columns), float32

    Raises
    ------
    ShapeError
        If the shapes do not match.
    """
    sizes = check_shape("weight", weight, 2, "R", "C")
    check_shape("moment", moment, 2, "R", "C", **sizes)
    check_shape("stiffness", stiffness, "R", "C", **sizes)
    check_shape("fixed", fixed, "R", "C", **sizes)
    levels = [(_float32(weight), _float32(moment), _float32(stiffness), np.ascontiguousarray(fixed, dtype=np.bool_))]
    while min(levels[-1][3].shape) > 2 * _SMALLEST:
        levels.append(coarsen(*levels[-1]))
    values = np.zeros_like(levels[-1][0])
    for level, (w, m, s, f) in enumerate(reversed(levels)):
        if level:
            values = refine(values, f)
        relax(values, w, m, s, f, 20 * _SWEEPS if level == 0 else _SWEEPS, _OVER)
    return values


def _float32(array: NDArray[np.floating]) -> NDArray[np.float32]:
    return np.ascontiguousarray(array, dtype=np.float32)
