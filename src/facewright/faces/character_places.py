"""Where the vertices of a region-based model lie on a character of any topology."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import RBFInterpolator

from facewright.errors import TopologyError
from facewright.faces.face import Face
from facewright.faces.load import load_face
from facewright.mesh.closest_point import closest_points
from facewright.mesh.topology import Topology
from facewright.models.dense_weights import SurfacePlaces
from facewright.models.region_model import RegionModel

#: Entries of `RegionModel.provenance` that tell which vertices of which face the model's mesh consists of.
TEMPLATE, VERTEX_IDS = "template", "vertex_ids"

_CURVE_POINTS = 15  # along each lip and lid, from corner to corner
_SMOOTHING = 0.05
#: What lies on one of a pair must not be laid on the other: they touch.
_OPPOSITE = (
    ("lips_upper", "lips_lower"),
    ("eyelid_upper_left", "eyelid_lower_left"),
    ("eyelid_upper_right", "eyelid_lower_right"),
)


def character_places(model: RegionModel, character: Face, template: Face | None = None) -> SurfacePlaces:
    """Return where each vertex of a model lies on a character's skin.

    A model knows the face that its mesh was taken from. Where the character is of that topology the places are
    vertices. Else the template is warped to the character by their common landmarks, lip and lid lines (a thin-plate
    spline), and its vertices are laid on the nearest skin; upper and lower lips and lids are kept apart.

    Parameters
    ----------
    model : RegionModel
        Its provenance names ``"template"`` and ``"vertex_ids"``, as training writes it.
    character : Face
    template : Face, optional
        The template's face; loaded by its name where absent.

    Raises
    ------
    TopologyError
        If the model does not say where its vertices come from, or the faces share no landmarks.
    MissingFaceError
        If the template is not installed.
    """
    name, listed = model.provenance.get(TEMPLATE), model.provenance.get(VERTEX_IDS)
    if not isinstance(name, str) or listed is None or len(listed) != model.n_vertices:
        raise TopologyError(
            "model must say which vertices of which face it consists of to drive a character, got one that does not; "
            "train it from data that `facewright mocap import` fitted to a template."
        )
    ids = np.asarray(listed, dtype=np.intp)
    if name in (character.name, character.topology.name):
        _check(ids, character.n_skin, name)
        return SurfacePlaces.at_vertices(ids)
    source = template or load_face(name)
    _check(ids, source.n_skin, name)
    a, b = _common_points(source, character)
    if len(a) < 8:
        raise TopologyError(f"faces {name!r} and {character.name!r} must share landmarks, got {len(a)} points.")
    warped = RBFInterpolator(a, b, kernel="thin_plate_spline", smoothing=_SMOOTHING)(
        source.mean_shape[ids].astype(np.float64)
    )
    return _laid_on(warped, ids, source.topology, character)


def _check(ids: NDArray[np.intp], n_skin: int, name: str) -> None:
    if ids.size and (ids.min() < 0 or ids.max() >= n_skin):
        raise TopologyError(f"vertex_ids must lie within the {n_skin} skin vertices of {name!r}, got {ids.max()}.")


def _common_points(source: Face, target: Face) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return points (K, 3) of both mean shapes that correspond: landmarks, and lip and lid lines evenly divided."""
    pairs: list[tuple[NDArray[np.float64], NDArray[np.float64]]] = []
    for scheme in ("fw74", "ibug68"):
        a, b = source.topology.landmarks.get(scheme), target.topology.landmarks.get(scheme)
        if a is not None and b is not None:
            known = (a >= 0) & (b >= 0)
            pairs.append((source.mean_shape[a[known]], target.mean_shape[b[known]]))
    for mask in source.topology.masks:
        if "_contact_" in mask and mask in target.topology.masks:
            pairs.append((_curve(source, mask), _curve(target, mask)))
    a, b = (np.concatenate([np.zeros((0, 3)), *(pair[k] for pair in pairs)]).astype(np.float64) for k in (0, 1))
    _, first = np.unique(np.round(a, 1), axis=0, return_index=True)  # landmarks of two schemes may be the same vertex
    return a[np.sort(first)], b[np.sort(first)]


def _curve(face: Face, mask: str) -> NDArray[np.float64]:
    """Return points evenly spaced along a lip or lid line, from the face's right to its left."""
    points = face.mean_shape[np.unique(face.topology.masks[mask])].astype(np.float64)
    points = points[np.argsort(points[:, 0])]
    along = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(points, axis=0), axis=1))])
    wanted = np.linspace(0.0, along[-1], _CURVE_POINTS)
    return np.stack([np.interp(wanted, along, points[:, c]) for c in range(3)], axis=1)


def _laid_on(points: NDArray[np.float64], ids: NDArray[np.intp], topology: Topology, character: Face) -> SurfacePlaces:
    """Lay points on the character's skin; those of one lip or lid not on the other."""
    skin = character.skin().topology
    corners, barycentric = np.zeros((len(points), 3), np.intp), np.zeros((len(points), 3))
    left = np.ones(len(points), dtype=bool)
    sides = [(own, other) for pair in _OPPOSITE for own, other in (pair, pair[::-1])]
    for own, other in [*sides, ("", "")]:
        if own and (own not in topology.masks or other not in skin.masks):
            continue
        chosen = np.flatnonzero(left & np.isin(ids, topology.masks[own]) if own else left)
        if not len(chosen):
            continue
        faces = skin.faces[~np.isin(skin.faces, skin.masks[other]).any(axis=1)] if own else skin.faces
        found = closest_points(character.mean_shape[: character.n_skin], faces, points[chosen])
        corners[chosen], barycentric[chosen] = faces[found.faces], found.barycentric
        left[chosen] = False
    return SurfacePlaces(corners, barycentric)
