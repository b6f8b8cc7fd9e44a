"""Tensor unfoldings and products with matrices along one mode."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from facewright.errors import ShapeError, ValueRangeError


def _check_mode(tensor: NDArray[Any], mode: int) -> None:
    if not 0 <= mode < np.ndim(tensor):
        raise ValueRangeError(f"mode must be in [0, {np.ndim(tensor)}), got {mode}.")


def mode_product(
    tensor: NDArray[np.floating[Any]], matrix: NDArray[np.floating[Any]], mode: int
) -> NDArray[np.floating[Any]]:
    """Multiply a tensor by a matrix along one mode, T x_mode M (modes count from 0).

    Parameters
    ----------
    tensor : ndarray
        T, with n entries along `mode`.
    matrix : ndarray of shape (m, n), or (n,)
        M; a vector contracts the mode away.
    mode : int
        Axis of `tensor`.

    Returns
    -------
    ndarray
        The product, with m entries along `mode`, or without that axis.

    Raises
    ------
    ShapeError
        If the sizes differ.
    ValueRangeError
        If the tensor has no such mode.

    Examples
    --------
    >>> mode_product(np.ones((2, 3)), np.ones((4, 3)), 1).shape
    (2, 4)
    """
    _check_mode(tensor, mode)
    if np.ndim(matrix) not in (1, 2) or np.shape(matrix)[-1] != np.shape(tensor)[mode]:
        expected = f"(m, {np.shape(tensor)[mode]})"
        raise ShapeError(f"matrix must have shape {expected}, got {np.shape(matrix)}.")
    product = np.tensordot(matrix, tensor, axes=(-1, mode))
    return product if np.ndim(matrix) == 1 else np.moveaxis(product, 0, mode)


def unfold(tensor: NDArray[Any], mode: int) -> NDArray[Any]:
    """Return the unfolding (n_mode, product of the others), other modes in their order, last one fastest.

    Raises
    ------
    ValueRangeError
        If the tensor has no such mode.
    """
    _check_mode(tensor, mode)
    return np.moveaxis(tensor, mode, 0).reshape(np.shape(tensor)[mode], -1)
