"""Stage 1 of scan fitting: rigid pose and coefficients of a linear basis (FaceWarehouse 3.2.1, eq. 1-5)."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from facewright.camera.pinhole import RigidMotion
from facewright.camera.rotation import rotation_from_vector
from facewright.errors import DegenerateError, NoFaceError
from facewright.fitting.scan_correspondence import Gates, Matches, ScanSurface, seen_from_camera
from facewright.fitting.scan_landmarks import LandmarkPull, LandmarkTerm
from facewright.mesh.normals import vertex_normals
from facewright.numeric.bounded_least_squares import solve_bounded_quadratic
from facewright.numeric.similarity import estimate_similarity

#: A closest point holds a vertex along the surface with this share of the weight that it has across it.
_ALONG = 0.1
#: Closest points in a round, at most: a regular sample of the matches says as much as all.
_MOST_MATCHES = 3000
#: Rounds that ask anew which vertices the camera sees; it changes little between them.
_NEW_VISIBILITY = (0, 1, 4)


@dataclass(frozen=True, eq=False)
class LinearShapes:
    """Shapes base + sum_k c_k basis_k with a normal prior on c and bounds.

    Parameters
    ----------
    base : ndarray of shape (V, 3), float64, millimetres
        The shape at c = 0.
    basis : ndarray of shape (V, 3, K), float64, millimetres
        Displacements; the last axis is the coefficient's, so that a vertex's rows lie together.
    mean, spread : ndarray of shape (K,)
        The prior: c ~ N(mean, spread^2). For modes at one standard deviation 0 and 1, which makes eq. (4) |c|^2 / 2.
    lower, upper : float
        Bounds of every coefficient.
    """

    base: NDArray[np.float64]
    basis: NDArray[np.float64]
    mean: NDArray[np.float64]
    spread: NDArray[np.float64]
    lower: float = -np.inf
    upper: float = np.inf

    def shape(self, c: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return the shape (V, 3) of coefficients (K,)."""
        return self.base + self.basis @ c


@dataclass(frozen=True)
class Stage1Options:
    """How stage 1 weighs and iterates.

    Parameters
    ----------
    landmarks, depth, prior : float
        w1, w2, w3 of eq. (5).
    gates_mm : tuple of float
        Largest distance of a closest point, one for each round: five to eight rounds in the paper.
    pose_only_rounds : int
        So many of the first rounds move the pose alone.
    """

    landmarks: float = 2.0
    depth: float = 0.5
    prior: float = 1.0
    gates_mm: tuple[float, ...] = (25.0, 20.0, 15.0, 12.0, 10.0, 8.0, 6.0, 6.0)
    pose_only_rounds: int = 1


@dataclass(frozen=True, eq=False)
class Stage1Fit:
    """What stage 1 found: pose, coefficients, the mesh in model space, the last matches and what could be matched."""

    target_from_model: RigidMotion
    coefficients: NDArray[np.float64]
    vertices: NDArray[np.float64]
    matches: Matches
    candidates: NDArray[np.intp]
    landmark_residuals_mm: NDArray[np.float64] = field(default_factory=lambda: np.empty(0))


class Visibility:
    """Which vertices of a posed mesh may be matched: outside surfaces that the scan's camera sees.

    Parameters
    ----------
    faces : ndarray of shape (F, 3)
        Triangles of the template.
    allowed : ndarray of shape (V,), bool
        Vertices that some scan may show.
    """

    def __init__(self, faces: NDArray[np.integer], allowed: NDArray[np.bool_]) -> None:
        self.faces = faces
        self.allowed = allowed

    def candidates(
        self, posed: NDArray[np.float64], normals: NDArray[np.float64], surface: ScanSurface
    ) -> NDArray[np.intp]:
        """Return the vertices to match of a mesh (V, 3) in the scan's frame."""
        camera = surface.target.intrinsics
        if camera is None or posed[:, 2].min() <= 0:
            return np.flatnonzero(self.allowed)
        away = np.einsum("vc,vc->v", posed, normals) >= -0.15 * np.linalg.norm(posed, axis=1)
        return np.flatnonzero(self.allowed & ~away & seen_from_camera(posed, self.faces, camera))


def start_pose(model_points: NDArray[np.float64], goals: NDArray[np.float64], weights: NDArray) -> RigidMotion:
    """Return the rigid motion of landmarks (N, 3) onto their goals.

    Raises
    ------
    NoFaceError
        If fewer than four landmarks have a position, they determine no pose, or they fit no face.
    """
    if len(goals) < 4:
        raise NoFaceError(f"at least 4 landmarks must have a 3D position, got {len(goals)}.")
    try:
        found = estimate_similarity(model_points, goals, weights=weights, with_scale=False)
    except DegenerateError as error:
        raise NoFaceError("landmarks must not lie on one line: they determine no pose.") from error
    return RigidMotion(found.rotation, found.translation)


def fit_linear(
    shapes: LinearShapes,
    surface: ScanSurface,
    landmarks: LandmarkTerm | None,
    visibility: Visibility,
    start: RigidMotion,
    options: Stage1Options,
    *,
    c0: NDArray[np.float64] | None = None,
    pose_weights: NDArray[np.float64] | None = None,
) -> Stage1Fit:
    """Find pose and coefficients that bring the shapes onto a scan.

    Each round matches closest points and contour anew and solves one small least-squares problem for a turn, a shift
    and the coefficients together, which takes fewer rounds than alternating between them.

    Parameters
    ----------
    shapes : LinearShapes
        The shapes.
    surface : ScanSurface
        The scan.
    landmarks : LandmarkTerm or None
        The landmark term; None goes by the surface alone.
    visibility : Visibility
        Chooses the vertices that are matched.
    start : RigidMotion
        First pose, target_from_model.
    options : Stage1Options
        Weights and rounds.
    c0 : ndarray of shape (K,), optional
        First coefficients; the prior's mean where absent.
    pose_weights : ndarray of shape (V,), optional
        Further weight of each vertex's closest point in the pose: 0 where a vertex tells nothing of it.

    Raises
    ------
    NoFaceError
        If hardly any vertex finds a point of the scan.
    """
    motion = start
    c = (shapes.mean if c0 is None else c0).copy()
    faces = visibility.faces
    candidates = np.empty(0, dtype=np.intp)
    for number, gate in enumerate(options.gates_mm):
        model = shapes.shape(c)
        posed = motion.apply(model)
        normals = vertex_normals(posed, faces)
        if number in _NEW_VISIBILITY:
            candidates = visibility.candidates(posed, normals, surface)
        matches = surface.match(posed, normals, candidates, Gates(gate))
        if len(matches.vertices) < 50:
            raise NoFaceError(
                f"the scan must lie within {gate:g} mm of the face placed at the landmarks, got "
                f"{len(matches.vertices)} of {len(candidates)} vertices there: check landmarks, unit and orientation."
            )
        pull = landmarks.pulls(posed, motion.rotation, surface.target) if landmarks is not None else None
        system = _System(shapes, motion, posed, c, with_shape=number >= options.pose_only_rounds)
        system.add_matches(matches, options.depth, pose_weights)
        if pull is not None:
            system.add_pull(pull, options.landmarks)
        turn, shift, c = system.solve(options.prior)
        rotation = rotation_from_vector(turn)
        motion = RigidMotion(
            rotation @ motion.rotation, rotation @ (motion.translation - system.centre) + system.centre + shift
        )
    model = shapes.shape(c)
    residuals = np.empty(0)
    if landmarks is not None:
        residuals = landmarks.pulls(motion.apply(model), motion.rotation, surface.target).residuals_mm
    return Stage1Fit(motion, c, model, matches, candidates, residuals)


class _System:
    """Normal equations of one round: 3 of rotation (about the mesh's centre), 3 of translation, K coefficients."""

    def __init__(
        self,
        shapes: LinearShapes,
        motion: RigidMotion,
        posed: NDArray[np.float64],
        c: NDArray[np.float64],
        *,
        with_shape: bool,
    ) -> None:
        self.shapes, self.motion, self.posed, self.c = shapes, motion, posed, c
        self.n_shape = len(c) if with_shape else 0
        self.centre = posed.mean(axis=0)
        size = 6 + self.n_shape
        self.H, self.g = np.zeros((size, size)), np.zeros(size)

    def add_matches(self, matches: Matches, weight: float, pose_weights: NDArray[np.float64] | None) -> None:
        """Add eq. (2): full weight across the scan's surface, little along it."""
        step = -(-len(matches.vertices) // _MOST_MATCHES)
        some = slice(None, None, step)
        ids, normals = matches.vertices[some], matches.normals[some]
        root = np.sqrt(weight * step * matches.weights[some])
        across = normals[:, :, None] * normals[:, None, :]
        M = (across + np.sqrt(_ALONG) * (np.eye(3) - across)) * root[:, None, None]
        pose = None if pose_weights is None else pose_weights[ids]
        self._add(ids, M, self.posed[ids] - matches.points[some], pose)

    def add_pull(self, pull: LandmarkPull, weight: float) -> None:
        """Add eq. (1)."""
        M = pull.projectors * np.sqrt(weight * pull.weights)[:, None, None]
        self._add(pull.vertices, M, self.posed[pull.vertices] - pull.goals, None)

    def _add(
        self, ids: NDArray[np.intp], M: NDArray[np.float64], residual: NDArray[np.float64], pose: NDArray | None
    ) -> None:
        arms = self.posed[ids] - self.centre
        J = np.zeros((len(ids), 3, 6 + self.n_shape))
        J[:, 0, 1], J[:, 0, 2] = arms[:, 2], -arms[:, 1]  # w x arm
        J[:, 1, 0], J[:, 1, 2] = -arms[:, 2], arms[:, 0]
        J[:, 2, 0], J[:, 2, 1] = arms[:, 1], -arms[:, 0]
        J[:, :, 3:6] = np.eye(3)
        if pose is not None:
            J[:, :, :6] *= pose[:, None, None]
        if self.n_shape:
            J[:, :, 6:] = self.motion.rotation @ self.shapes.basis[ids]
        J = np.matmul(M, J).reshape(-1, J.shape[2])
        r = np.einsum("nij,nj->ni", M, residual).ravel()
        self.H += J.T @ J
        self.g += J.T @ r

    def solve(self, prior: float) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]]:
        """Return rotation vector, translation and new coefficients."""
        H, g, n = self.H, self.g, self.n_shape
        H[np.diag_indices(6)] += 1e-9 * max(float(np.trace(H[:6, :6])), 1e-12)
        if n:
            precision = prior / self.shapes.spread**2  # Eq. (4)
            H[np.arange(6, 6 + n), np.arange(6, 6 + n)] += precision
            g[6:] += precision * (self.c - self.shapes.mean)
        lower, upper = np.full(6 + n, -np.inf), np.full(6 + n, np.inf)
        if n:
            lower[6:], upper[6:] = self.shapes.lower - self.c, self.shapes.upper - self.c
        if np.isfinite(lower).any() or np.isfinite(upper).any():
            step = solve_bounded_quadratic(H, -g, lower, upper)
        else:
            step = -np.linalg.solve(H, g)
        c = self.c + step[6:] if n else self.c
        return step[:3], step[3:6], c
