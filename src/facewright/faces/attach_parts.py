"""Give a fitted skin the rest of the face: eyeballs, teeth, gums, lashes, tear fluid, sockets and mouth."""

from __future__ import annotations

from functools import lru_cache

import numpy as np
from numpy.typing import NDArray
from scipy import sparse
from scipy.spatial.transform import Rotation

from facewright.faces.contact import face_contacts
from facewright.faces.face import Face
from facewright.faces.lids import Lids
from facewright.faces.pieces import Followers, face_pieces
from facewright.mesh.laplacian import cotangent_laplacian
from facewright.numeric.check import check_finite, check_shape
from facewright.numeric.sparse_solve import SymmetricSolver

_SKIN_ERROR_MM = 0.5  # of a fitted skin, and of people the identity modes do not hold
_INDEPENDENT_POINTS = 300.0  # how many independent measurements a skin is worth: its errors are smooth
_FIELD_MM, _FIELD_RMS_MM = 25.0, 0.5  # of what the modes leave: correlation length and size
_FIELD_SAMPLES = 400


class PartsAttacher:
    """Complete skins of one face; what depends on the generic face only is computed once.

    Parts that no scan sees are placed by the personal neutral: the identity modes, which move skin and parts together,
    are fitted to the skin (maximum a posteriori), and what they leave is carried inwards as a smooth random field.
    Blendshapes move eyeballs and upper teeth with the skull and lower teeth with the jaw, rigidly; sockets and the
    mouth continue the skin; lashes and tear fluid follow the lids; closed lids stay outside the eyeballs.

    Parameters
    ----------
    face : Face
        All parts of it; skins are those of ``face.skin()``.
    """

    def __init__(self, face: Face) -> None:
        self.face = face
        self._pieces = face_pieces(face)
        self._n_skin = face.n_skin
        self._mean = face.mean_shape.astype(np.float64)
        self._generic = face.blendshape_deltas.astype(np.float64)
        self._followers = Followers(self._mean[self._pieces.surface], self._mean[self._pieces.loose])
        self._lids = Lids(face, face_contacts(self._mean, face.topology, self._pieces.surface_faces))
        self._prepare_modes()
        self._prepare_cavities()
        self._prepare_field()

    def _prepare_modes(self) -> None:
        """Factor the normal equations of the identity modes on the skin of the face."""
        topology = self.face.topology
        front = topology.masks.get("face_region", np.arange(*topology.parts["face"]))
        self._weights = np.full(self._n_skin, 0.05)  # ears, neck and the back of the head are seldom seen
        self._weights[front] = 1.0
        self._weights *= _INDEPENDENT_POINTS / (self._weights.sum() * _SKIN_ERROR_MM**2)
        basis = self.face.identity_basis[:, : self._n_skin]
        self._skin_basis = basis.reshape(len(basis), -1).astype(np.float64)
        normal = (self._skin_basis * np.repeat(self._weights, 3)) @ self._skin_basis.T
        self._inverse = np.linalg.inv(normal + np.eye(len(normal)))

    def _prepare_cavities(self) -> None:
        """Prepare the harmonic extension from the skin's inner rims into mouth and sockets."""
        surface = np.arange(len(self._mean))[self._pieces.surface]
        self._cavity = surface[surface >= self._n_skin]
        faces = self._pieces.surface_faces
        touching = faces[(faces >= self._n_skin).any(axis=1)]
        self._rim = np.unique(touching[touching < self._n_skin])
        ids = np.concatenate([self._cavity, self._rim])
        number = np.full(len(self._mean), -1)
        number[ids] = np.arange(len(ids))
        n = len(self._cavity)
        if n:
            L = _laplacian(self._mean[ids], number[touching])
            right = -L[:n, n:].toarray()
            self._extension = SymmetricSolver(L[:n, :n].tocsc()).solve(right)
        else:
            self._extension = np.zeros((0, len(self._rim)))

    def _prepare_field(self) -> None:
        """Prepare the prediction of a smooth field at hidden parts from its values on the skin (kriging)."""
        front = np.flatnonzero(self._weights == self._weights.max())
        self._samples = front[np.linspace(0, len(front) - 1, min(_FIELD_SAMPLES, len(front))).astype(int)]
        known = self._mean[self._samples]

        def covariance(a: NDArray[np.float64], b: NDArray[np.float64]) -> NDArray[np.float64]:
            squared = ((a[:, None] - b[None]) ** 2).sum(axis=2)
            return _FIELD_RMS_MM**2 * np.exp(-0.5 * squared / _FIELD_MM**2)

        noise = _SKIN_ERROR_MM**2 * len(known) / _INDEPENDENT_POINTS
        matrix = covariance(known, known) + noise * np.eye(len(known))
        centres = [self._mean[motion.vertices].mean(axis=0) for motion in self._pieces.rigid]
        hidden = np.concatenate([np.reshape(centres, (-1, 3)), self._mean[self._pieces.loose]])
        self._field = np.linalg.solve(matrix, covariance(known, hidden)).T

    def neutral(self, skin: NDArray[np.floating]) -> NDArray[np.float64]:
        """Return all parts (V, 3) of a person whose skin at rest is given (V_skin, 3), millimetres.

        Raises
        ------
        ShapeError, ValueRangeError
            If `skin` is not (V_skin, 3) or not finite.
        """
        check_shape("skin", skin, self._n_skin, 3)
        check_finite("skin", skin)
        n_modes = len(self._skin_basis)
        offset = (skin - self._mean[: self._n_skin]).ravel()
        c = self._inverse @ (self._skin_basis @ (offset * np.repeat(self._weights, 3)))
        modes = c @ self.face.identity_basis.reshape(n_modes, -1).astype(np.float64)
        result = self._mean + modes.reshape(-1, 3)
        left = skin - result[: self._n_skin]
        result[: self._n_skin] = skin
        moved = self._surface_motion(left)
        result[self._cavity] += moved[self._cavity]
        field = self._field @ left[self._samples]
        n_rigid = len(self._pieces.rigid)
        for motion, shift in zip(self._pieces.rigid, field[:n_rigid]):
            result[motion.vertices] += shift
        deep = 1.0 - self._followers.nearness[:, None]
        result[self._pieces.loose] += self._followers.follow(moved[self._pieces.surface]) + deep * field[n_rigid:]
        return result

    def _surface_motion(self, skin_motion: NDArray[np.float64]) -> NDArray[np.float64]:
        """Continue motions (..., V_skin, 3) of the skin into the cavities; return (..., V, 3), zero elsewhere."""
        moved = np.zeros((*skin_motion.shape[:-2], len(self._mean), 3))
        moved[..., : self._n_skin, :] = skin_motion
        moved[..., self._cavity, :] = self._extension @ skin_motion[..., self._rim, :]
        return moved

    def blendshapes(
        self,
        neutral: NDArray[np.floating],
        skin_deltas: NDArray[np.floating],
        amplitudes: NDArray[np.floating],
    ) -> NDArray[np.float64]:
        """Return personal blendshapes of all parts.

        Parameters
        ----------
        neutral : ndarray of shape (V, 3), millimetres
            The person at rest, from `neutral`.
        skin_deltas : ndarray of shape (46, V_skin, 3), millimetres
            The person's blendshapes on the skin, displacements at weight one.
        amplitudes : ndarray of shape (46,)
            How far the person goes with each shape, relative to the generic face (`FittedRig.amplitudes`).

        Returns
        -------
        ndarray of shape (46, V, 3), float64, millimetres
            Displacements; the skin as given but for lids lifted off the eyeballs.

        Raises
        ------
        ShapeError, ValueRangeError
            If shapes do not fit or values are not finite.
        """
        B, V = self._generic.shape[:2]
        check_shape("neutral", neutral, V, 3)
        check_shape("skin_deltas", skin_deltas, B, self._n_skin, 3)
        check_shape("amplitudes", amplitudes, B)
        for name, array in (("neutral", neutral), ("skin_deltas", skin_deltas), ("amplitudes", amplitudes)):
            check_finite(name, array)
        rest = np.asarray(neutral, dtype=np.float64)
        deltas = self._generic * np.asarray(amplitudes)[:, None, None]
        left = skin_deltas - deltas[:, : self._n_skin]
        for motion in self._pieces.rigid:
            deltas[:, motion.vertices] = motion.deltas(rest[motion.vertices], amplitudes)
        deltas[:, : self._n_skin] = skin_deltas
        self._lids.clear(rest, deltas)
        left += deltas[:, : self._n_skin] - skin_deltas
        self._follow_skin(deltas, left)
        return deltas

    def _follow_skin(self, meshes: NDArray[np.float64], left: NDArray[np.float64]) -> None:
        """Move cavities and loose parts of `meshes` (..., V, 3) with what the skin differs by, in place."""
        moved = self._surface_motion(left)
        meshes[..., self._cavity, :] += moved[..., self._cavity, :]
        meshes[..., self._pieces.loose, :] += self._followers.follow(moved[..., self._pieces.surface, :])

    def expression(
        self,
        neutral: NDArray[np.floating],
        deltas: NDArray[np.floating],
        skin: NDArray[np.floating],
        weights: NDArray[np.floating],
        amplitudes: NDArray[np.floating],
    ) -> NDArray[np.float64]:
        """Return all parts of one expression whose skin is known.

        Parameters
        ----------
        neutral : ndarray of shape (V, 3), millimetres
            The person at rest, from `neutral`.
        deltas : ndarray of shape (46, V, 3), millimetres
            The person's blendshapes, from `blendshapes`.
        skin : ndarray of shape (V_skin, 3), millimetres
            The skin in this expression, in the head frame of `neutral`.
        weights : ndarray of shape (46,)
            Blendshape weights of the expression.
        amplitudes : ndarray of shape (46,)
            As for `blendshapes`.

        Returns
        -------
        ndarray of shape (V, 3), float64, millimetres
            The mesh; the skin as given but for lids lifted off the eyeballs. Rigid pieces keep their shape exactly,
            also where several blendshapes turn them.

        Raises
        ------
        ShapeError, ValueRangeError
            If shapes do not fit or values are not finite.
        """
        B, V = self._generic.shape[:2]
        check_shape("neutral", neutral, V, 3)
        check_shape("deltas", deltas, B, V, 3)
        check_shape("skin", skin, self._n_skin, 3)
        check_shape("weights", weights, B)
        check_finite("skin", skin)
        check_finite("weights", weights)
        w = np.asarray(weights, dtype=np.float64)
        posed = neutral + np.tensordot(w, deltas, 1)
        for motion in self._pieces.rigid:
            rest = neutral[motion.vertices]
            arms = rest - rest.mean(axis=0)
            reach = w * amplitudes
            turn = Rotation.from_rotvec(reach @ motion.rotations).as_matrix()
            posed[motion.vertices] = arms @ turn.T + rest.mean(axis=0) + reach @ motion.translations
        rigged = posed[: self._n_skin].copy()
        posed[: self._n_skin] = skin
        posed = self._lids.lifted(posed, self._mean + np.tensordot(w, self._generic, 1))
        self._follow_skin(posed, posed[: self._n_skin] - rigged)
        return posed


def _laplacian(vertices: NDArray[np.float64], faces: NDArray[np.integer]) -> sparse.csr_matrix:
    """Return the cotangent Laplacian, kept invertible where all cotangents at a vertex vanish."""
    L = cotangent_laplacian(vertices, faces).tocsr()
    return (L + 1e-9 * sparse.identity(len(vertices))).tocsr()


@lru_cache(maxsize=2)
def parts_attacher(face: Face) -> PartsAttacher:
    """Return the attacher of a face, made once."""
    return PartsAttacher(face)
