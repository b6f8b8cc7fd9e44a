"""What landmarks say beyond the model: a small smooth displacement of the mesh that meets them in the picture."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray
from scipy import sparse

from facewright.camera.pinhole import Intrinsics, RigidMotion
from facewright.errors import DegenerateError
from facewright.faces.contact import face_contacts
from facewright.faces.face import Face
from facewright.faces.pieces import FacePieces, Followers, face_pieces
from facewright.fitting.outline import Outline
from facewright.mesh.laplacian import cotangent_laplacian, mass_matrix
from facewright.mesh.normals import vertex_normals
from facewright.numeric.check import check_finite, check_shape
from facewright.numeric.sparse_solve import SymmetricSolver

#: Bending and stretching of the field: a lone point moves its surroundings within about 15 mm.
_REACH_MM = 15.0
#: How far the field may be expected to move a point, root mean square.
_EXPECTED_MM = 4.0
#: Fewest points that a field is made from.
_MIN_POINTS = 8
#: Lips and lids nearer than this in the photo's fit are closed: the photo does not tell how they part.
_CLOSED_MM = 0.3
#: Points whose surface faces away are as uncertain as at this cosine.
_LEAST_FACING = 0.2
#: A point is left out if the others predict it worse than so many standard deviations.
_BAD_SIGMAS = 4.5
#: At most this share of the points is left out.
_BAD_SHARE = 0.15


@dataclass(frozen=True, eq=False)
class Anchors:
    """Points of a mesh's surface that landmarks show.

    Parameters
    ----------
    corners : ndarray of shape (K, 3), int
        Vertices of the triangle that each point lies in.
    shares : ndarray of shape (K, 3), float64
        Barycentric coordinates.
    noise_mm : ndarray of shape (K,), float64
        Standard deviation, per coordinate, of what is known about each.
    """

    corners: NDArray[np.int32]
    shares: NDArray[np.float64]
    noise_mm: NDArray[np.float64]

    def __post_init__(self) -> None:
        sizes = check_shape("corners", self.corners, "K", 3)
        check_shape("shares", self.shares, "K", 3, **sizes)
        check_shape("noise_mm", self.noise_mm, "K", **sizes)

    @classmethod
    def at_vertices(cls, vertices: NDArray[np.integer], noise_mm: NDArray[np.floating]) -> Anchors:
        """Return anchors at vertices (K,)."""
        corners = np.repeat(np.asarray(vertices, dtype=np.int32)[:, None], 3, axis=1)
        shares = np.zeros((len(corners), 3))
        shares[:, 0] = 1.0
        return cls(corners, shares, np.asarray(noise_mm, dtype=np.float64))

    def with_outline(self, outline: Outline, use: NDArray[np.bool_], noise_mm: float) -> Anchors:
        """Return these anchors and then the `use`d ones of an outline, whose clearest points have the given noise."""
        corners = np.stack([outline.first, outline.second, outline.second], axis=1)[use]
        shares = np.stack([1.0 - outline.fraction, outline.fraction, 0.0 * outline.fraction], axis=1)[use]
        # the outline's own points are seen edge on: that does not make them less certain
        noise = _LEAST_FACING * noise_mm / np.sqrt(outline.confidence[use])
        return Anchors(
            np.concatenate([self.corners, corners]),
            np.concatenate([self.shares, shares]),
            np.concatenate([self.noise_mm, noise]),
        )

    def __len__(self) -> int:
        return len(self.corners)

    def at(self, values: NDArray[np.floating]) -> NDArray[np.float64]:
        """Return vertex values (V, D) at the points, (K, D)."""
        return np.einsum("kc,kcd->kd", self.shares, np.asarray(values, dtype=np.float64)[self.corners])

    def matrix(self, n_vertices: int) -> sparse.csr_matrix:
        """Return the (K, V) matrix that takes vertex values to the points."""
        rows = np.repeat(np.arange(len(self)), 3)
        return sparse.csr_matrix((self.shares.ravel(), (rows, self.corners.ravel())), shape=(len(self), n_vertices))


class SmoothField:
    """Smooth displacements of all parts of a face from displacements of a few points of its skin.

    A Gaussian field whose energy is the bending and stretching of the skin's displacement, with a small cost of
    displacement itself, so that it fades beyond the points; mouth cavity and sockets continue it. What it predicts at
    all vertices from noisy points is linear in them.

    Parameters
    ----------
    face : Face
        All parts of it.
    """

    def __init__(self, face: Face) -> None:
        self.face = face
        rest = face.mean_shape.astype(np.float64)
        self._pieces = face_pieces(face)
        self.surface = np.arange(len(rest))[self._pieces.surface]
        self._number = np.full(len(rest), -1)
        self._number[self.surface] = np.arange(len(self.surface))
        self._solver = SymmetricSolver(_field_energy(face, self._pieces, self.surface, self._number))
        self._followers = Followers(rest[self.surface], rest[self._pieces.loose])
        self._jaw_share = _jaw_share(face)
        contacts = face_contacts(rest, face.topology, self._pieces.surface_faces)
        self.lip_contacts = [contact for name, contact in contacts.items() if name == "lips"]
        # the upper lid alone goes to the lower one
        self.lid_contacts = [contact for name, contact in contacts.items() if name.startswith("upper_lid")]

    def columns(self, anchors: Anchors) -> NDArray[np.float64]:
        """Return the field's covariance of all surface vertices with the anchors, (S, K), up to a factor."""
        A = anchors.matrix(len(self._number)).tocsc()[:, self.surface]
        return self._solver.solve(A.T.toarray())

    def spread(self, surface: NDArray[np.float64]) -> NDArray[np.float64]:
        """Continue displacements of the surface (S, 3) to all parts: (V, 3).

        Eyeballs move with the lids around them, upper teeth with the upper lip and the base of the nose, lower teeth
        with lower lip and chin; all of them whole. Loose geometry follows the skin it lies on, and gums and tongue
        the teeth, by how much the jaw moves them.
        """
        topology = self.face.topology
        moved = np.zeros((topology.n_vertices, surface.shape[1]))
        moved[self.surface] = surface
        jaw = {}
        for name, masks in (("skull", ("lips_upper", "nose")), ("jaw", ("lips_lower", "chin"))):
            jaw[name] = np.mean(
                [moved[topology.masks[mask]].mean(axis=0) for mask in masks if mask in topology.masks], 0
            )
        for motion, (part, kind) in zip(self._pieces.rigid, self.face.rigid_parts.items(), strict=True):
            if kind == "eye":
                side = part.rpartition("_")[2]
                lids = [topology.masks[f"eyelid_{lid}_{side}"] for lid in ("upper", "lower")]
                moved[motion.vertices] = moved[np.concatenate(lids)].mean(axis=0)
            else:
                moved[motion.vertices] = jaw[kind]
        loose = self._pieces.loose
        if len(loose):
            near = self._followers.nearness[:, None]
            share = self._jaw_share[loose, None]
            inner = (1.0 - share) * jaw["skull"] + share * jaw["jaw"]
            moved[loose] = self._followers.follow(surface) + (1.0 - near) * inner
        return moved


@lru_cache(maxsize=2)
def smooth_field(face: Face) -> SmoothField:
    """Return the field of a face, made once."""
    return SmoothField(face)


class LandmarkResidual:
    """Displace a fitted mesh so that it meets landmarks in the picture it was fitted to.

    Parameters
    ----------
    face : Face
        All parts of it.
    anchors : Anchors
        Where the landmarks lie on it.
    """

    def __init__(self, face: Face, anchors: Anchors) -> None:
        self.face = face
        self.anchors = anchors
        self._field = smooth_field(face)
        self._columns = self._field.columns(anchors)
        A = anchors.matrix(face.topology.n_vertices).tocsc()[:, self._field.surface]
        prior = A @ self._columns
        self._scale = _EXPECTED_MM**2 / np.median(np.diag(prior))
        self._prior = self._scale * 0.5 * (prior + prior.T)

    def displacement(
        self,
        vertices: NDArray[np.floating],
        pixels: NDArray[np.floating],
        intrinsics: Intrinsics,
        camera_from_model: RigidMotion,
        present: NDArray[np.bool_] | None = None,
    ) -> NDArray[np.float64]:
        """Return the displacement of all vertices in model space, (V, 3), millimetres, parallel to the image plane.

        Parameters
        ----------
        vertices : ndarray of shape (V, 3), millimetres
            The fitted face, all parts, in model space.
        pixels : ndarray of shape (K, 2)
            Where the picture shows the anchors; any value where not `present`.
        intrinsics, camera_from_model
            The camera of the picture.
        present : ndarray of shape (K,), bool, optional
            Points that were found; all where absent.

        Raises
        ------
        DegenerateError
            If fewer than 8 points are present.
        """
        K = len(self.anchors)
        check_shape("pixels", pixels, K, 2)
        use = np.ones(K, bool) if present is None else np.asarray(present).copy()
        if use.sum() < _MIN_POINTS:
            raise DegenerateError(f"at least {_MIN_POINTS} landmarks are needed to adjust a face, got {use.sum()}.")
        check_finite("pixels", np.asarray(pixels)[use])
        seen = camera_from_model.apply(np.asarray(vertices, dtype=np.float64))
        points = self.anchors.at(seen)
        per_pixel = points[:, 2:] / [intrinsics.focal_x, intrinsics.focal_y]  # millimetres at the point's depth
        wanted = np.where(use[:, None], (pixels - intrinsics.project(points)) * per_pixel, 0.0)
        noise = self.anchors.noise_mm / np.maximum(_facing(self.face, seen, self.anchors), _LEAST_FACING)
        coefficients = _robust_kriging(self._prior, noise, wanted, use)
        surface = np.zeros((len(self._columns), 3))  # parallel to the image plane: no depth
        surface[:, :2] = self._scale * (self._columns @ coefficients)
        return self._field.spread(surface) @ camera_from_model.rotation  # R^T d, row by row


def _field_energy(
    face: Face, pieces: FacePieces, surface: NDArray[np.intp], number: NDArray[np.intp]
) -> sparse.csc_matrix:
    """Return the energy of a displacement of the surface: bending on the skin, stretching and size everywhere."""
    rest = face.mean_shape.astype(np.float64)[surface]
    faces = number[pieces.surface_faces]
    L = cotangent_laplacian(rest, faces)
    area = np.maximum(mass_matrix(rest, faces).diagonal(), 1e-6)
    bending = L @ sparse.diags(1.0 / area) @ L
    # (1 - r^2 Laplace)^2 in three terms: Matern covariance of range r
    energy = _REACH_MM**4 * bending + 2.0 * _REACH_MM**2 * L + sparse.diags(area)
    return energy.tocsc()


def _jaw_share(face: Face) -> NDArray[np.float64]:
    """Return how much of the jaw's motion each vertex makes when it opens, (V,), in [0, 1]."""
    size = np.linalg.norm(face.blendshape_deltas[face.blendshape_names.index("jawOpen")], axis=1).astype(np.float64)
    part, mask = face.topology.parts.get("teeth_lower"), face.topology.masks.get("teeth_lower")
    teeth = np.arange(*part) if part is not None else mask
    reference = size[teeth].mean() if teeth is not None and len(teeth) else size.max()
    return np.clip(size / max(float(reference), 1e-9), 0.0, 1.0)


def _facing(face: Face, seen: NDArray[np.float64], anchors: Anchors) -> NDArray[np.float64]:
    """Return the cosine between the surface's normal at the anchors and the ray to the camera, (K,)."""
    n = face.n_skin
    normals = vertex_normals(seen[:n], face.topology.submesh(n).faces)
    there, points = anchors.at(normals), anchors.at(seen)
    return -(there * points).sum(axis=1) / np.maximum(
        np.linalg.norm(there, axis=1) * np.linalg.norm(points, axis=1), 1e-9
    )


def _robust_kriging(
    prior: NDArray[np.float64], noise: NDArray[np.float64], wanted: NDArray[np.float64], use: NDArray[np.bool_]
) -> NDArray[np.float64]:
    """Return coefficients (K, 2) of the field; points that all others contradict are left out one by one.

    The error of a point predicted by all others is c_i / (M^-1)_ii with M = prior + noise^2 and c = M^-1 wanted.
    """
    use = use.copy()
    coefficients = np.zeros_like(wanted)
    for _ in range(int(_BAD_SHARE * use.sum()) + 1):
        ids = np.flatnonzero(use)
        inverse = np.linalg.inv(prior[np.ix_(ids, ids)] + np.diag(noise[ids] ** 2))
        c = inverse @ wanted[ids]
        coefficients[:] = 0.0
        coefficients[ids] = c
        # predicted error over its standard deviation, (M^-1)_ii^-1/2
        z = np.linalg.norm(c, axis=1) / np.sqrt(np.diag(inverse))
        scale = max(1.0, float(np.median(z)) / 1.18)  # the median of a 2D Gaussian's length
        worst = int(np.argmax(z))
        if z[worst] <= _BAD_SIGMAS * scale:
            break
        use[ids[worst]] = False
    return coefficients


class CarriedResidual:
    """The residual of a photo on other expressions of the same person.

    It stays with the skin, but for what opens or closes lips and lids against each other: that part shrinks in
    proportion as they close, so that they meet where the model's do. On the photo's own mesh it is the residual itself,
    to the last bit.

    Parameters
    ----------
    face : Face
        All parts of it.
    displacement : ndarray of shape (V, 3), millimetres
        Of `LandmarkResidual.displacement`.
    source : ndarray of shape (V, 3), millimetres
        The mesh it was found for.
    """

    def __init__(self, face: Face, displacement: NDArray[np.floating], source: NDArray[np.floating]) -> None:
        check_shape("displacement", displacement, face.topology.n_vertices, 3)
        check_shape("source", source, face.topology.n_vertices, 3)
        self.displacement = np.asarray(displacement, dtype=np.float64)
        self._contacts = [*smooth_field(face).lip_contacts, *smooth_field(face).lid_contacts]
        self._source_gaps = [contact.offsets(source)[:, 1] for contact in self._contacts]
        self._parting = [contact.offsets(self.displacement) for contact in self._contacts]

    def at(self, vertices: NDArray[np.floating]) -> NDArray[np.float64]:
        """Return the displacement (V, 3), millimetres, of another expression or shape (V, 3) in model space."""
        moved = self.displacement
        for contact, gaps, parting in zip(self._contacts, self._source_gaps, self._parting, strict=True):
            ratio = contact.offsets(vertices)[:, 1] / np.maximum(gaps, _CLOSED_MM)
            ratio = np.where(gaps > _CLOSED_MM, np.clip(ratio, 0.0, 1.0), 1.0)
            if (ratio < 1.0).any():
                if moved is self.displacement:
                    moved = self.displacement.copy()
                contact.change(moved, (ratio - 1.0)[:, None] * parting)
        return moved
