"""Gradients of functions that are linear on each triangle."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy import sparse

from facewright.errors import DegenerateError
from facewright.mesh.triangle_frames import degenerate_triangles, inverse_frames, triangle_frames


def hat_gradients(vertices: NDArray[np.floating[Any]], faces: NDArray[np.integer[Any]]) -> NDArray[np.float64]:
    """Return the gradient of each corner's hat function on each triangle.

    Parameters
    ----------
    vertices : ndarray of shape (V, 3), millimetres
        Positions.
    faces : ndarray of shape (F, 3), int
        Triangles.

    Returns
    -------
    ndarray of shape (F, 3 corners, 3), float64, 1 / millimetre
        Gradients, in the triangle's plane; they sum to zero over the corners.

    Raises
    ------
    ShapeError, ValueRangeError
        If shapes are wrong or indices outside [0, V).
    DegenerateError
        If a triangle has no area.
    """
    frames = triangle_frames(vertices, faces)
    flat = degenerate_triangles(frames)
    if flat.any():
        raise DegenerateError(f"vertices must give every triangle an area, got {int(flat.sum())} without.")
    others = inverse_frames(frames)[:, :2]  # rows of V^-1 are dual to the edges
    return np.concatenate([-others.sum(axis=1, keepdims=True), others], axis=1)


def gradient_operator(
    vertices: NDArray[np.floating[Any]], faces: NDArray[np.integer[Any]], *, tangential: bool = False
) -> sparse.csr_matrix:
    """Return the sparse matrix G that maps vertex values to gradients, triangle by triangle.

    Parameters
    ----------
    vertices : ndarray of shape (V, 3), millimetres
        Positions.
    faces : ndarray of shape (F, 3), int
        Triangles.
    tangential : bool
        Give the two components in an orthonormal basis of each triangle's plane (first edge, normal x first edge)
        instead of x, y, z.

    Returns
    -------
    scipy.sparse.csr_matrix of shape (3F, V) or (2F, V), float64
        Rows in triangle order, components fastest. With A the areas, G^T A G is the cotangent Laplacian.

    Raises
    ------
    ShapeError, ValueRangeError
        If shapes are wrong or indices outside [0, V).
    DegenerateError
        If a triangle has no area.
    """
    gradients = hat_gradients(vertices, faces)  # (F, corner, xyz)
    if tangential:
        frames = triangle_frames(vertices, faces)
        first = frames[..., 0] / np.linalg.norm(frames[..., 0], axis=1, keepdims=True)
        normal = frames[..., 2] / np.linalg.norm(frames[..., 2], axis=1, keepdims=True)
        gradients = gradients @ np.stack([first, np.cross(normal, first)], axis=2)
    F, _, K = gradients.shape
    columns = np.repeat(np.asarray(faces)[:, None, :], K, axis=1)  # (F, K, corner)
    values = gradients.transpose(0, 2, 1)
    indptr = np.arange(0, 3 * K * F + 1, 3)
    return sparse.csr_matrix((values.ravel(), columns.ravel(), indptr), shape=(K * F, len(vertices)))
