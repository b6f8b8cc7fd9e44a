"""Where on a generic face a performer's markers are glued: once per performer, from one frame at rest."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree
from scipy.spatial.transform import Rotation

from facewright.errors import DegenerateError
from facewright.fitting.marker_template import MarkerTemplate, at_places
from facewright.io.marker_units import UP_AXES, turned_up
from facewright.mesh.closest_point import ClosestPoints
from facewright.mesh.normals import vertex_normals
from facewright.numeric.check import check_finite, check_shape
from facewright.numeric.robust import tukey_weights
from facewright.numeric.similarity import Similarity, estimate_similarity

Array = NDArray[np.float64]

#: Fewer do not tell a face's place and proportions.
LEAST_MARKERS = 20
#: Sizes of faces relative to the template; beyond, the unit or the data are wrong.
SCALES = (0.75, 1.3)
_TURNS, _REFINED, _FEW = 16, 3, 100  # starting poses about the upright axis, how many go on, markers tried first
_ROUNDS = 20
_NORMAL_MM = (3.0, 0.7)  # deviation of markers from the fitted shape across the surface, from first to last round
_TANGENTIAL = 0.03  # of the distance along the surface, relative to across: closest points say little about it
_ROUGH_MM = 25.0
_WORST_RMS_MM = 6.0
_FIELD_MM, _NOISE_MM = 2.0, 0.3


@dataclass(frozen=True, eq=False)
class MarkerPlacement:
    """A performer's neutral and where markers sit on it, in the head's own frame (y up, face towards +z).

    Parameters
    ----------
    recorded_from_model : Similarity
        Of the rest frame, with scale 1.
    neutral : ndarray of shape (S, 3), float64, millimetres
        The template's surface as the performer at rest.
    corners : ndarray of shape (M, 3), int
        Triangle of each marker, among the S.
    weights : ndarray of shape (M, 3), float64
        Barycentric coordinates.
    rest : ndarray of shape (M, 3), float64, millimetres
        Marker centres of the rest frame, in the head's frame.
    identity_weights : ndarray of shape (I,), float64
        In standard deviations.
    scale : float
        Size relative to the template.
    model_rms_mm : float
        Distance of the markers' feet from the best face of the identity modes, across its surface.
    """

    recorded_from_model: Similarity
    neutral: Array
    corners: NDArray[np.int64]
    weights: Array
    rest: Array
    identity_weights: Array
    scale: float
    model_rms_mm: float


def place_markers(template: MarkerTemplate, rest: NDArray[np.floating], standoff_mm: float = 1.5) -> MarkerPlacement:
    """Fit the template to markers (M, 3) of one frame at rest and say where each one sits.

    As Tena et al. 2006: a global map (here a similarity found from many turns, then identity modes), local matching
    (closest points, the markers' centres stand off the skin), and the smoothest deformation for what remains.

    Parameters
    ----------
    template : MarkerTemplate
        Generic face.
    rest : ndarray of shape (M, 3), millimetres
        Centres of the markers; y up, in any place and turned any way about y.
    standoff_mm : float
        Height of the centres above the skin.

    Raises
    ------
    ShapeError, ValueRangeError
        If `rest` is not (M, 3) or not finite.
    DegenerateError
        If there are fewer than 20 markers or no face can be found in them.
    """
    M = check_shape("rest", rest, "M", 3)["M"]
    check_finite("rest", rest)
    if M < LEAST_MARKERS:
        raise DegenerateError(f"rest must hold at least {LEAST_MARKERS} markers of a face, got {M}.")
    points = np.asarray(rest, dtype=np.float64)
    model_from_recorded, cost = _find_face(template, points)
    if cost > _ROUGH_MM:
        raise DegenerateError("markers must lie on a face, got points that none fits; check unit and axes.")
    here = model_from_recorded.apply(points)
    weights, here, change = _fit_identity(template, here, standoff_mm / model_from_recorded.scale)
    model_from_recorded = change.compose(model_from_recorded)
    scale = 1.0 / model_from_recorded.scale
    if not SCALES[0] <= scale <= SCALES[1]:
        raise DegenerateError(
            f"markers must span a face of {SCALES[0]} to {SCALES[1]} times the usual size, got {scale:.2f}; "
            "give the file's unit."
        )
    shape = scale * (template.points + np.tensordot(weights, template.identity, 1))
    here = scale * here
    found, normals, feet = _feet(template, shape, here, standoff_mm)
    corners = template.faces[found.faces]
    across = ((feet - found.points) * normals).sum(axis=1)
    model_rms = float(np.sqrt(np.mean(across**2)))
    if model_rms > _WORST_RMS_MM:
        raise DegenerateError(
            f"markers must lie on a face, got {model_rms:.1f} mm RMS from the nearest face that is likely; "
            "check unit and axes."
        )
    neutral = _bend(template, shape, corners, found.barycentric, feet)
    rotation = model_from_recorded.rotation.T
    translation = -(rotation @ model_from_recorded.translation) / model_from_recorded.scale
    recorded = Similarity(1.0, rotation, translation)
    return MarkerPlacement(recorded, neutral, corners, found.barycentric, here, weights, scale, model_rms)


def find_up(template: MarkerTemplate, rest: NDArray[np.floating]) -> str:
    """Return which axis of the recording points up: that with which the template finds the markers best.

    Parameters
    ----------
    template : MarkerTemplate
        Generic face.
    rest : ndarray of shape (M, 3), millimetres
        Centres of the markers, axes as recorded.
    """
    points = np.asarray(rest, dtype=np.float64)
    found = {up: _find_face(template, turned_up(points, up)) for up in ("y", "z", "x")}
    best = min(found, key=lambda up: found[up][1])
    if found[best][1] > 1.02 * found["y"][1]:
        best = "y"
    # the found pose may be pitched any way: what counts is where the face's own up points
    head_up = turned_up(np.eye(3), best) @ found[best][0].rotation.T @ [0.0, 1.0, 0.0]
    axis = int(np.abs(head_up).argmax())
    return UP_AXES[axis + 3 * int(head_up[axis] < 0)]


def _find_face(template: MarkerTemplate, points: Array) -> tuple[Similarity, float]:
    """Return the similarity, model from recorded, by which markers and acting surface cover each other best.

    Also how far they then are from each other, mm (`_cover`).
    """
    surface = template.points[:: max(1, len(template.points) // 2000)]
    inner = template.points[template.inner]
    inner = inner[:: max(1, len(inner) // 300)]
    tree = cKDTree(surface)
    few, sparse = points[:: max(1, len(points) // _FEW)], inner[::2]
    starts = []
    for turn in np.arange(_TURNS) * (2 * np.pi / _TURNS):
        rotation = Rotation.from_rotvec([0.0, turn, 0.0]).as_matrix()
        start = Similarity(1.0, rotation, inner.mean(axis=0) - rotation @ points.mean(axis=0))
        pose = _iterate_closest(tree, surface, sparse, few, start, 10, with_scale=False)
        starts.append((_cover(tree, sparse, pose.apply(few)), turn, pose))
    found = []
    for _, turn, start in sorted(starts, key=lambda entry: entry[0])[:_REFINED]:
        pose = _iterate_closest(tree, surface, inner, points, start, 20, with_scale=False)
        pose = _iterate_closest(tree, surface, inner, points, pose, 15, with_scale=True)
        found.append((_cover(tree, inner, pose.apply(points)), turn, pose))
    cost, _, best = min(found, key=lambda entry: entry[0])
    return best, cost


def _iterate_closest(
    tree: cKDTree, surface: Array, inner: Array, points: Array, pose: Similarity, rounds: int, *, with_scale: bool
) -> Similarity:
    """Improve a similarity: markers go to their nearest vertices, and inner vertices pull their nearest markers."""
    for _ in range(rounds):
        moved = pose.apply(points)
        to_surface, nearest = tree.query(moved)
        back, owner = cKDTree(moved).query(inner)
        source = np.concatenate([points, points[owner]])
        target = np.concatenate([surface[nearest], inner])
        far = np.concatenate([to_surface, np.maximum(back - 6.0, 0.0)])
        weights = tukey_weights(far, 3.0 * max(float(np.median(to_surface)), 5.0)) + 1e-6
        weights[len(points) :] *= 0.5 * len(points) / len(inner)
        step = estimate_similarity(source, target, weights=weights, with_scale=with_scale)
        if with_scale:
            scale = float(np.clip(step.scale, 1.0 / SCALES[1], 1.0 / SCALES[0]))
            middle = weights @ source / weights.sum()
            step = Similarity(scale, step.rotation, step.apply(middle) - scale * step.rotation @ middle)
        pose = step
    return pose


def _cover(tree: cKDTree, inner: Array, moved: Array) -> float:
    """Return how far markers are from the surface and it from them, mm: mean of both, blind to a tenth."""
    there = np.minimum(tree.query(moved)[0], 40.0)
    back = np.minimum(cKDTree(moved).query(inner)[0], 40.0)
    return float(np.sort(there)[: int(0.9 * len(there)) + 1].mean() + np.sort(back)[: int(0.9 * len(back)) + 1].mean())


def _feet(template: MarkerTemplate, shape: Array, centres: Array, standoff: float):  # type: ignore[no-untyped-def]
    """Return closest points of the shape, its normals there and the markers' feet."""
    found = ClosestPoints(shape, template.faces).query(centres)
    at = vertex_normals(shape, template.faces)
    normals = at_places(at, template.faces[found.faces], found.barycentric)
    normals /= np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-12)
    return found, normals, centres - standoff * normals


def _fit_identity(template: MarkerTemplate, here: Array, standoff: float) -> tuple[Array, Array, Similarity]:
    """Fit identity weights and a small similarity: distances across the surface, Gaussian prior on the weights.

    Returns the weights, the markers in the moved frame and that move.
    """
    n_modes, M = len(template.identity), len(here)
    w = np.zeros(n_modes)
    total = Similarity(1.0, np.eye(3), np.zeros(3))
    centre = template.points[template.inner].mean(axis=0)
    for deviation in np.geomspace(*_NORMAL_MM, _ROUNDS):
        shape = template.points + np.tensordot(w, template.identity, 1)
        found, normals, feet = _feet(template, shape, here, standoff)
        modes = at_places(template.identity, template.faces[found.faces], found.barycentric)
        gap = feet - found.points
        across = (gap * normals).sum(axis=1)
        robust = np.sqrt(tukey_weights(across, 6.0 * max(deviation, float(np.median(np.abs(across))))) + 1e-6)
        # unknowns: weights, and how the markers move: turn, shift, log of the size
        arms = here - centre
        moves = np.stack([_turned(arms, k) for k in range(3)] + [np.eye(3)[k] + 0.0 * arms for k in range(3)] + [arms])
        basis = np.concatenate([modes, -moves])
        rows = np.concatenate(
            [
                (np.einsum("pmc,mc->mp", basis, normals) * robust[:, None]),
                _TANGENTIAL * basis.transpose(1, 2, 0).reshape(3 * M, -1),
            ]
        )
        start = gap + at_places(np.tensordot(w, template.identity, 1), template.faces[found.faces], found.barycentric)
        right = np.concatenate([(start * normals).sum(axis=1) * robust, _TANGENTIAL * start.ravel()])
        prior = np.concatenate([np.ones(n_modes), 1e-6 * np.ones(6), [1e-6]]) * deviation**2
        solution = np.linalg.solve(rows.T @ rows + np.diag(prior), rows.T @ right)
        w = solution[:n_modes]
        turn, shift, size = solution[-7:-4], solution[-4:-1], float(np.exp(np.clip(solution[-1], -0.1, 0.1)))
        rotation = Rotation.from_rotvec(turn).as_matrix()
        step = Similarity(size, rotation, centre + shift - size * rotation @ centre)
        here, total = step.apply(here), step.compose(total)
    return w, here, total


def _turned(arms: Array, axis: int) -> Array:
    return np.cross(np.eye(3)[axis], arms)


def _bend(template: MarkerTemplate, shape: Array, corners: NDArray[np.int64], weights: Array, feet: Array) -> Array:
    """Move the shape smoothly so that the markers' places go to their feet."""
    covariance = _FIELD_MM**2 * template.field_covariance(corners, weights)
    among = np.einsum("mk,mkn->mn", weights, covariance[corners]) + _NOISE_MM**2 * np.eye(len(corners))
    gap = feet - at_places(shape, corners, weights)
    return np.asarray(shape + covariance @ np.linalg.solve(among, gap))
