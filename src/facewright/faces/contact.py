"""Keep surfaces that touch together: lips that seal, lids that close."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy import sparse
from scipy.sparse.csgraph import dijkstra

from facewright.mesh.connectivity import unique_edges
from facewright.mesh.topology import Topology

_SMOOTHNESS = 1e-2  # ridge of the kernel interpolation, as a share of its diagonal


class Contact:
    """Pairs of vertices across an opening, and how a change of their offsets spreads over both sides.

    A wanted change of the offsets (upper minus lower) is spread over each side by Gaussian kernel interpolation of
    width `sigma_mm` along the mean surface, so that it is smooth and dies out a few widths away.

    Parameters
    ----------
    vertices : ndarray of shape (V, 3), millimetres
        The mean at rest.
    faces : ndarray of shape (F, 3), int
        Triangles of the surface; the opening must separate the two sides.
    upper, lower : ndarray of shape (K,), int
        Vertices of each pair.
    sigma_mm : float
        Width of the kernel.
    upper_share : float
        Share of the change that the upper side makes; the lower side makes the rest.
    """

    def __init__(
        self,
        vertices: NDArray[np.floating[Any]],
        faces: NDArray[np.integer[Any]],
        upper: NDArray[np.integer[Any]],
        lower: NDArray[np.integer[Any]],
        *,
        sigma_mm: float,
        upper_share: float = 0.5,
    ) -> None:
        self.upper = np.asarray(upper)
        self.lower = np.asarray(lower)
        points = np.asarray(vertices, dtype=np.float64)
        to_upper, to_lower = (_distances(points, faces, ids, 4.0 * sigma_mm) for ids in (self.upper, self.lower))
        sides = [
            (np.flatnonzero(np.isfinite(to_upper) & (to_upper < to_lower)), self.upper, upper_share),
            (np.flatnonzero(np.isfinite(to_lower) & (to_lower < to_upper)), self.lower, upper_share - 1.0),
        ]
        moving = [side for side in sides if side[2] != 0.0]
        self._moved = np.concatenate([ids for ids, _, _ in moving])
        self._spread = np.concatenate(
            [share * _interpolation(points[ids], points[pairs], sigma_mm) for ids, pairs, share in moving]
        )

    def offsets(self, vertices: NDArray[np.floating[Any]]) -> NDArray[np.float64]:
        """Return upper minus lower vertex of each pair, shape (..., K, 3)."""
        points = np.asarray(vertices)
        return points[..., self.upper, :].astype(np.float64) - points[..., self.lower, :]

    def change(self, vertices: NDArray[np.floating[Any]], change: NDArray[np.floating[Any]]) -> None:
        """Change the offsets of `vertices` (..., V, 3) by about `change` (..., K, 3), smoothly and in place."""
        vertices[..., self._moved, :] += (self._spread @ change).astype(vertices.dtype)


def _distances(points: NDArray, faces: NDArray, sources: NDArray, limit: float) -> NDArray[np.float64]:
    """Return the distance along edges from the nearest source, infinite beyond `limit`."""
    edges = unique_edges(faces)
    lengths = np.linalg.norm(points[edges[:, 0]] - points[edges[:, 1]], axis=1)
    graph = sparse.coo_matrix((lengths, (edges[:, 0], edges[:, 1])), shape=(len(points), len(points))).tocsr()
    return dijkstra(graph, directed=False, indices=np.unique(sources), min_only=True, limit=limit)


def _interpolation(points: NDArray, centres: NDArray, sigma: float) -> NDArray[np.float64]:
    """Return the (N, K) matrix of kernel ridge interpolation from values at `centres` to `points`."""

    def kernel(a: NDArray, b: NDArray) -> NDArray[np.float64]:
        squared = ((a[:, None] - b[None]) ** 2).sum(axis=2)
        return np.exp(-squared / (2.0 * sigma**2))

    matrix = kernel(centres, centres)
    matrix[np.diag_indices(len(centres))] += _SMOOTHNESS
    return np.linalg.solve(matrix, kernel(points, centres).T).T


def face_contacts(
    vertices: NDArray[np.floating[Any]], topology: Topology, faces: NDArray[np.integer[Any]]
) -> dict[str, Contact]:
    """Return the contacts whose masks the face has: ``"lips"``, and ``"upper_lid_left"`` and so on.

    Lips share a change between them; of a lid's two contacts, one moves the upper and one the lower lid.
    """
    wanted = {
        "lips": ("lip_contact_upper", "lip_contact_lower", 4.0, 0.5),
    }
    for side in ("left", "right"):
        pair = (f"lid_contact_upper_{side}", f"lid_contact_lower_{side}")
        wanted[f"upper_lid_{side}"] = (*pair, 4.0, 1.0)
        wanted[f"lower_lid_{side}"] = (*pair, 4.0, 0.0)
    return {
        name: Contact(
            vertices,
            faces,
            topology.masks[upper],
            topology.masks[lower],
            sigma_mm=sigma,
            upper_share=share,
        )
        for name, (upper, lower, sigma, share) in wanted.items()
        if topology.masks.get(upper, np.empty(0)).size and topology.masks.get(lower, np.empty(0)).size
    }
