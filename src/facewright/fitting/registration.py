"""Registration of a template to a mesh without any model of people: landmarks, closest points, smoothness."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy import sparse

from facewright.errors import DegenerateError, ValueRangeError
from facewright.mesh.areas import vertex_areas
from facewright.mesh.closest_point import ClosestPoints
from facewright.mesh.connectivity import boundary_edges
from facewright.mesh.laplacian import cotangent_laplacian
from facewright.mesh.normals import vertex_normals
from facewright.numeric.check import check_finite, check_indices, check_shape
from facewright.numeric.similarity import estimate_similarity
from facewright.numeric.sparse_solve import SymmetricSolver

Progress = Callable[[str, int, int], None]
Array = NDArray[np.float64]

#: From so many landmarks on they bend the template before its surface is looked at.
_LEAST_TO_BEND = 12
#: With fewer vertices matched than this share, target and template are not the same thing or not turned alike.
_LEAST_MATCHED = 0.2
#: What the preconditioner takes for the mean of n n^T.
_ISOTROPIC = 0.4


@dataclass(frozen=True)
class RegistrationOptions:
    """How stiff the template is, and what it may be matched with.

    Parameters
    ----------
    stiffness : tuple of float, mm^4
        Weight of bending against distance, from round to round: sqrt(sqrt(weight)) is about the length in mm below
        which the surface does not bend.
    stretch : float, 1 / mm^2
        Weight of stretching, relative to that of bending.
    landmark_weight : float
        Of one landmark, relative to one vertex of mean area.
    tangential : float
        Weight of the distance along the surface to the closest point, relative to that across it.
    angle_degrees : float
        Largest angle between the normals of a vertex and its closest point.
    match_rim : bool
        Whether points on the target's rim count: where template and target end at the same place.
    """

    stiffness: tuple[float, ...] = (300.0, 100.0, 30.0, 10.0, 3.0, 1.0, 0.3)
    stretch: float = 0.03
    landmark_weight: float = 10.0
    tangential: float = 0.02
    angle_degrees: float = 55.0
    match_rim: bool = False

    def __post_init__(self) -> None:
        if not self.stiffness or min(self.stiffness) <= 0:
            raise ValueRangeError(f"stiffness must be positive numbers, got {self.stiffness}.")
        for name in ("stretch", "landmark_weight", "tangential"):
            if getattr(self, name) < 0:
                raise ValueRangeError(f"{name} must not be negative, got {getattr(self, name)}.")


@dataclass(frozen=True, eq=False)
class Registration:
    """A template on a target.

    Parameters
    ----------
    vertices : ndarray of shape (V, 3), float64, millimetres
        The template's vertices on the target, in the target's frame.
    start : ndarray of shape (V, 3), float64, millimetres
        Where the landmarks alone put them.
    matched : ndarray of shape (V,), bool
        Vertices that had a closest point in the last round.
    surface_rms_mm, landmark_rms_mm : float
        Distance of the matched vertices across the target's surface, and of the landmarks.
    """

    vertices: Array
    start: Array
    matched: NDArray[np.bool_]
    surface_rms_mm: float
    landmark_rms_mm: float


class TemplateRegistration:
    r"""Registers one template to many targets; keeps the template's Laplacian.

    Minimises over displacements d from what the landmarks alone give:

    .. math:: \sum_v a_v (n_v^T (x_v + d_v - c_v))^2 + \beta \sum_l |x_l + d_l - y_l|^2
              + \lambda\, d^T (L M^{-1} L + \mu L) d

    with closest points c and their normals n, cotangent Laplacian L and areas M of the template. In each round closest
    points are searched anew and lambda falls, so that first large shapes and then details follow; along the surface,
    where closest points say nothing, the displacement is the smoothest that agrees with the rest. Each round is one
    linear system, solved by conjugate gradients; its part that is alike for x, y and z is factored as preconditioner.

    Parameters
    ----------
    vertices : ndarray of shape (V, 3), millimetres
        The template.
    faces : ndarray of shape (F, 3)
        Its triangles, counter-clockwise seen from outside.
    options : RegistrationOptions
        Weights.
    """

    def __init__(
        self,
        vertices: NDArray[np.floating],
        faces: NDArray[np.integer],
        options: RegistrationOptions | None = None,
    ) -> None:
        check_shape("vertices", vertices, "V", 3)
        check_finite("vertices", vertices)
        self.template: Array = np.asarray(vertices, dtype=np.float64)
        self.faces = np.asarray(faces)
        self.options = options or RegistrationOptions()
        L = cotangent_laplacian(self.template, faces)
        areas = vertex_areas(self.template, faces)
        self._areas = areas / areas.mean()
        bending = L.T @ sparse.diags(1.0 / areas) @ L
        self._smoothness = ((bending + self.options.stretch * L) * areas.mean()).tocsr()

    def register(
        self,
        target_vertices: NDArray[np.floating],
        target_faces: NDArray[np.integer],
        landmark_vertices: NDArray[np.integer],
        landmark_positions: NDArray[np.floating],
        progress: Progress | None = None,
    ) -> Registration:
        """Register the template to a target.

        Parameters
        ----------
        target_vertices : ndarray of shape (N, 3), millimetres
            The target, in any pose.
        target_faces : ndarray of shape (G, 3)
            Its triangles, counter-clockwise seen from outside.
        landmark_vertices : ndarray of shape (K,), int
            Vertices of the template, K >= 3.
        landmark_positions : ndarray of shape (K, 3), millimetres
            Where they are on the target.
        progress : callable, optional
            Called as progress("registering", done, total).

        Returns
        -------
        Registration
            Vertices and residuals.

        Raises
        ------
        ShapeError, ValueRangeError
            If shapes do not match or values are not finite.
        DegenerateError
            If landmarks do not give a pose, or no vertex finds a point of the target.
        """
        V = len(self.template)
        K = check_shape("landmark_vertices", landmark_vertices, "K")["K"]
        check_indices("landmark_vertices", landmark_vertices, V)
        check_shape("landmark_positions", landmark_positions, K, 3)
        check_finite("landmark_positions", landmark_positions)
        surface = _Surface(target_vertices, target_faces, self.options)
        ids, wanted = _one_per_vertex(landmark_vertices, landmark_positions)
        start = bend_by_landmarks(self.template, ids, wanted)
        marked = np.zeros(V)
        marked[ids] = self.options.landmark_weight
        d = np.zeros((V, 3))
        # the smoothness is measured on the template, which a similarity may have scaled
        rounds = self.options.stiffness
        for done, stiffness in enumerate(rounds):
            points, normals, matched = surface.match(start + d, self.faces)
            weights = self._areas * matched
            offset = points - start
            across = (weights * (offset * normals).sum(axis=1))[:, None] * normals
            right = across + self.options.tangential * weights[:, None] * offset
            right[ids] += self.options.landmark_weight * (wanted - start[ids])
            d = self._solve(stiffness, weights, normals, marked, right, d)
            if progress is not None:
                progress("registering", done + 1, len(rounds))
        vertices = start + d
        points, normals, matched = surface.match(vertices, self.faces)
        left = ((vertices - points) * normals).sum(axis=1)[matched]
        return Registration(
            vertices,
            start,
            matched,
            float(np.sqrt(np.mean(left**2))),
            float(np.sqrt(((vertices[ids] - wanted) ** 2).sum(axis=1).mean())),
        )

    def _solve(self, stiffness: float, weights: Array, normals: Array, marked: Array, right: Array, d: Array) -> Array:
        """Solve one round's system for the displacements (V, 3), from `d`."""
        S = stiffness * self._smoothness
        alike = self.options.tangential * weights + marked
        # weight for all vertices, also unmatched ones, so that the factor exists
        factor = SymmetricSolver((S + sparse.diags(_ISOTROPIC * np.maximum(weights, 1e-3) + marked)).tocsc())

        def apply(x: Array) -> Array:
            along = (weights * (x * normals).sum(axis=1))[:, None] * normals
            return np.asarray(S @ x + along + alike[:, None] * x)

        return conjugate_gradients(apply, factor.solve, right, d)


def conjugate_gradients(
    apply: Callable[[Array], Array],
    precondition: Callable[[Array], Array],
    right: Array,
    start: Array,
    *,
    iterations: int = 60,
    tolerance: float = 1e-3,
) -> Array:
    """Solve A x = right for a symmetric positive definite A by preconditioned conjugate gradients.

    Parameters
    ----------
    apply, precondition : callable
        x -> A x and x -> P^-1 x on arrays of the shape of `right`.
    right, start : ndarray
        Right-hand side and first guess.
    iterations : int
        At most so many.
    tolerance : float
        Residual in the preconditioner's norm, relative to that of `right`, at which to stop.
    """
    x, residual = start.copy(), right - apply(start)
    z = precondition(residual)
    direction, square = z.copy(), float((residual * z).sum())
    enough = tolerance**2 * float((right * precondition(right)).sum())
    for _ in range(iterations):
        if square <= enough:
            break
        image = apply(direction)
        step = square / float((direction * image).sum())
        x += step * direction
        residual -= step * image
        z = precondition(residual)
        following = float((residual * z).sum())
        direction = z + following / square * direction
        square = following
    return x


def bend_by_landmarks(vertices: Array, ids: NDArray[np.integer], wanted: NDArray[np.floating]) -> Array:
    """Move a mesh (V, 3) so that vertices `ids` (K,) go to `wanted` (K, 3) and the rest follows smoothly.

    With a dozen landmarks or more that span space, the interpolation is the smoothest in space (biharmonic, kernel r,
    with an affine part); with fewer it is the best similarity.
    """
    moved = estimate_similarity(vertices[ids], wanted).apply(vertices)
    points = moved[ids]
    K = len(ids)
    spread = np.linalg.svd(points - points.mean(axis=0), compute_uv=False)
    if K < _LEAST_TO_BEND or spread[2] < 0.05 * spread[0]:
        return np.asarray(moved)
    affine = np.concatenate([np.ones((K, 1)), points], axis=1)
    kernel = np.linalg.norm(points[:, None] - points[None], axis=2)
    system = np.block([[kernel, affine], [affine.T, np.zeros((4, 4))]])
    weights = np.linalg.lstsq(system, np.concatenate([wanted - points, np.zeros((4, 3))]), rcond=None)[0]
    distances = np.sqrt(np.maximum(_squared_distances(moved, points), 0.0))
    return np.asarray(moved + distances @ weights[:K] + weights[K] + moved @ weights[K + 1 :])


def _squared_distances(a: Array, b: Array) -> Array:
    centre = b.mean(axis=0)
    a, b = a - centre, b - centre
    return np.asarray((a**2).sum(axis=1)[:, None] + (b**2).sum(axis=1)[None] - 2.0 * a @ b.T)


def _one_per_vertex(ids: NDArray[np.integer], positions: NDArray[np.floating]) -> tuple[NDArray[np.intp], Array]:
    """Average the positions of landmarks that share a vertex, as the inner mouth corners may."""
    unique, inverse = np.unique(ids, return_inverse=True)
    count = np.bincount(inverse.ravel(), minlength=len(unique))
    summed = [np.bincount(inverse.ravel(), np.asarray(positions)[:, k], minlength=len(unique)) for k in range(3)]
    return unique.astype(np.intp), np.stack(summed, axis=1) / count[:, None]


class _Surface:
    """The target, searched for closest points that face the same way."""

    def __init__(self, vertices: NDArray[Any], faces: NDArray[Any], options: RegistrationOptions) -> None:
        self._search = ClosestPoints(vertices, faces)
        self._faces = np.asarray(faces)
        self._normals = vertex_normals(np.asarray(vertices, dtype=np.float64), faces)
        self._cosine = float(np.cos(np.deg2rad(options.angle_degrees)))
        rim = np.zeros(len(vertices), dtype=bool)
        if not options.match_rim:
            rim[boundary_edges(faces)] = True
        self._rim = rim[self._faces]

    def match(self, vertices: Array, faces: NDArray[np.integer]) -> tuple[Array, Array, NDArray[np.bool_]]:
        """Return closest points (V, 3), their normals (V, 3) and whether they may be used (V,)."""
        found = self._search.query(vertices)
        normals = np.einsum("vk,vkx->vx", found.barycentric, self._normals[self._faces[found.faces]])
        normals /= np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-12)
        facing = (normals * vertex_normals(vertices, faces)).sum(axis=1) >= self._cosine
        matched = facing & ~(self._rim[found.faces] | (found.barycentric <= 1e-6)).all(axis=1)
        if matched.mean() < _LEAST_MATCHED:
            raise DegenerateError(
                f"the template must find points of the target that face the same way for at least "
                f"{100 * _LEAST_MATCHED:.0f} % of its vertices, got {100 * matched.mean():.0f} %."
            )
        return found.points, normals, matched
