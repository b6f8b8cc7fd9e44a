"""The generic face that markers are registered with: its acting surface, and how it is likely to deform."""

from __future__ import annotations

from functools import lru_cache

import numpy as np
from numpy.typing import NDArray
from scipy import sparse

from facewright.faces.coarse_face import CoarseFace, coarse_face
from facewright.faces.face import Face
from facewright.faces.performance_region import acting_surface, performance_region
from facewright.mesh.areas import vertex_areas
from facewright.mesh.laplacian import cotangent_laplacian
from facewright.numeric.sparse_solve import SymmetricSolver

Array = NDArray[np.float64]

#: Distance along the surface beyond which displacements that the face's shapes do not explain have nothing in common.
RANGE_MM = 35.0


class MarkerTemplate:
    """The part of a generic face's skin that bears markers: S vertices.

    Displacements that identity modes and blendshapes do not explain are taken for a Gaussian random field on the
    surface, of unit variance and independent in x, y and z: the solution of (kappa^2 - Laplace) u = white noise, whose
    correlation falls with the distance along the surface (Matern with nu = 1; Lindgren, Rue, Lindstroem 2011). Upper
    and lower lip are far apart in that sense, however near they lie.

    Parameters
    ----------
    face : Face
        With the masks and landmarks that `performance_region` needs.
    n_vertices : int
        Of the coarse mesh.

    Attributes
    ----------
    ids : ndarray of shape (S,), int
        Vertices of the face.
    points : ndarray of shape (S, 3), float64, millimetres
        On the mean face.
    faces : ndarray of shape (F, 3), int
        Triangles among the S.
    identity : ndarray of shape (I, S, 3), float64, millimetres
    deltas : ndarray of shape (46, S, 3), float64, millimetres
    inner : ndarray of shape (S,), bool
        The `performance_region`.
    coarse : CoarseFace
    coarse_places : ndarray of shape (N,), int
        The coarse mesh's vertices among the S.
    """

    def __init__(self, face: Face, n_vertices: int) -> None:
        skin = face.skin()
        surface = acting_surface(face)
        kept = skin.topology.faces[surface[skin.topology.faces].all(axis=1)]
        self.face = face
        self.ids = np.unique(kept)
        place = np.full(len(surface), -1)
        place[self.ids] = np.arange(len(self.ids))
        self.faces = place[kept]
        self.points: Array = skin.mean_shape[self.ids].astype(np.float64)
        self.identity: Array = skin.identity_basis[:, self.ids].astype(np.float64)
        self.deltas: Array = skin.blendshape_deltas[:, self.ids].astype(np.float64)
        self.inner = performance_region(face)[self.ids]
        self.coarse: CoarseFace = coarse_face(face, n_vertices)
        self.coarse_places = place[self.coarse.vertex_ids]
        self._solver, self._scale = self._field()

    def _field(self) -> tuple[SymmetricSolver, Array]:
        """Factor the field's precision; its variance is measured and made one everywhere."""
        areas = vertex_areas(self.points, self.faces)
        stiffness = cotangent_laplacian(self.points, self.faces)
        kappa2 = 8.0 / RANGE_MM**2
        operator = kappa2 * sparse.diags(areas) + stiffness
        precision = operator @ sparse.diags(1.0 / areas) @ operator
        solver = SymmetricSolver(precision)
        # variance is larger at borders and where the surface bends: sampled with a fixed draw
        white = np.random.default_rng(0).standard_normal((len(areas), 96)) * np.sqrt(areas)[:, None]
        variance = (solver.solve(operator @ (white / areas[:, None])) ** 2).mean(axis=1)
        return solver, 1.0 / np.sqrt(variance)

    def field_covariance(self, corners: NDArray[np.integer], weights: Array) -> Array:
        """Return the covariance (S, M) of the unit field at all vertices with that at M places on triangles."""
        M = len(corners)
        rows = np.repeat(np.arange(M), 3)
        values = (weights * self._scale[corners]).ravel()
        chosen = sparse.csc_matrix((values, (corners.ravel(), rows)), shape=(len(self.ids), M))
        return np.asarray(self._scale[:, None] * self._solver.solve(chosen.toarray()))


@lru_cache(maxsize=4)
def marker_template(face: Face, n_vertices: int = 397) -> MarkerTemplate:
    """Return the face's template; kept, because it is factored once."""
    return MarkerTemplate(face, n_vertices)


def at_places(values: NDArray[np.floating], corners: NDArray[np.integer], weights: Array) -> Array:
    """Return what vertices (..., S, 3) have at M places on triangles, (..., M, 3)."""
    return np.einsum("mk,...mkc->...mc", weights, np.asarray(values)[..., corners, :])
