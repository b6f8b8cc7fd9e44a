"""Cotangent Laplacian and lumped mass matrix."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy import sparse

from facewright.errors import DegenerateError
from facewright.mesh.areas import vertex_areas
from facewright.mesh.triangle_frames import degenerate_triangles, triangle_frames


def cotangent_laplacian(
    vertices: NDArray[np.floating[Any]], faces: NDArray[np.integer[Any]], *, clamp: bool = True
) -> sparse.csr_matrix:
    """Return the positive semidefinite cotangent Laplacian L.

    Parameters
    ----------
    vertices : ndarray of shape (V, 3), millimetres
        Positions.
    faces : ndarray of shape (F, 3), int
        Triangles.
    clamp : bool
        Replace negative edge weights, which obtuse triangles make, by zero, so that smoothing never overshoots.

    Returns
    -------
    scipy.sparse.csr_matrix of shape (V, V), float64, no unit
        Rows sum to zero; off the diagonal minus (cot a + cot b) / 2. Without `clamp` equal to G^T A G.

    Raises
    ------
    ShapeError, ValueRangeError
        If shapes are wrong or an index is outside [0, V).
    DegenerateError
        If a triangle has no area.
    """
    frames = triangle_frames(vertices, faces)
    flat = degenerate_triangles(frames)
    if flat.any():
        raise DegenerateError(f"vertices must give every triangle an area, got {int(flat.sum())} without.")
    a, b = frames[..., 0], frames[..., 1]
    edges = np.stack([b - a, -b, a], axis=1)  # opposite to corners 0, 1, 2, head to tail
    following, preceding = np.roll(edges, -1, axis=1), np.roll(edges, 1, axis=1)
    double_area = np.linalg.norm(np.cross(a, b), axis=1)[:, None]
    cotangents = -(following * preceding).sum(axis=2) / double_area  # at each corner
    corners = np.asarray(faces)
    rows, columns = np.roll(corners, -1, axis=1).ravel(), np.roll(corners, 1, axis=1).ravel()
    V = len(vertices)
    W = sparse.csr_matrix((0.5 * cotangents.ravel(), (rows, columns)), shape=(V, V))
    W = (W + W.T).tocsr()
    if clamp:
        W.data = np.maximum(W.data, 0.0)
    return (sparse.diags(np.asarray(W.sum(axis=1)).ravel()) - W).tocsr()


def mass_matrix(vertices: NDArray[np.floating[Any]], faces: NDArray[np.integer[Any]]) -> sparse.csr_matrix:
    """Return the lumped (barycentric) mass matrix, (V, V) diagonal, float64, mm^2.

    Raises
    ------
    ShapeError, ValueRangeError
        If shapes are wrong or an index is outside [0, V).
    """
    return sparse.diags(vertex_areas(vertices, faces)).tocsr()
