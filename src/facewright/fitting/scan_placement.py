"""Unit and pose of a face in a scan, by its landmarks; and what of the scan is there to be fitted."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import sparse
from scipy.sparse.csgraph import connected_components

from facewright.errors import DegenerateError, NoFaceError, ValueRangeError
from facewright.faces.face import Face
from facewright.fitting.scan_target import ScanTarget
from facewright.landmarks.scheme import load_scheme
from facewright.mesh.connectivity import half_edges
from facewright.mesh.normals import face_area_vectors, vertex_normals
from facewright.numeric.check import check_choice, check_finite, check_shape
from facewright.numeric.similarity import Similarity, estimate_similarity

Array = NDArray[np.float64]

#: Millimetres in one unit of a scan.
UNITS = {"mm": 1.0, "cm": 10.0, "m": 1000.0, "in": 25.4}
#: Size of a person's face relative to the mean face's: children and giants lie within.
_HUMAN = (0.7, 1.4)
#: Landmarks of a face, in any expression, lie within this of the mean face's after the best similarity; mm RMS.
_FACE_RMS_MM = 10.0
#: How far they stand out of their plane, relative to the mean face's.
_RELIEF = (0.45, 1.8)
#: What a scan keeps: this far around the landmarks' centre, which lies on the face.
_REACH_MM = 190.0
#: The middle of the head lies so far behind the landmarks' centre.
_DEPTH_MM = 70.0
#: Triangles with an edge longer than this, and than so many median ones, are spikes or bridge holes.
_LONG_MM, _LONG_TIMES = 25.0, 8.0
_LEAST_TRIANGLES = 150


@dataclass(frozen=True, eq=False)
class Placement:
    """Where the face is in a scan.

    Parameters
    ----------
    unit : str
        Unit of the scan: a key of `UNITS`.
    scan_from_model : Similarity
        From model space (mm, y up, face along +z) to the scan's frame and unit; its scale is the unit's.
    size : float
        Size of the face relative to the template's mean.
    landmark_rms_mm : float
        Distance of the landmarks from the mean face's, in that size and pose.
    """

    unit: str
    scan_from_model: Similarity
    size: float
    landmark_rms_mm: float


def place_face(
    face: Face, landmarks: NDArray[np.floating], confidence: NDArray[np.floating], unit: str = "auto"
) -> Placement:
    """Find unit and pose from landmarks of a scan.

    Parameters
    ----------
    face : Face
        The template, with ``fw74`` landmarks.
    landmarks : ndarray of shape (74, 3), the scan's unit
        ``fw74`` landmarks; NaN where there is none.
    confidence : ndarray of shape (74,)
        Their weights; 0 where there is none.
    unit : str
        ``"auto"`` decides by the size of the face; else a key of `UNITS`.

    Raises
    ------
    NoFaceError
        If fewer than four landmarks are known, they determine no pose, or they do not lie as those of a face.
    ValueRangeError
        If the unit is unknown, or the face is not of human size in it (in any, for ``"auto"``).
    """
    check_choice("unit", unit, ("auto", *UNITS))
    check_shape("landmarks", landmarks, 74, 3)
    check_shape("confidence", confidence, 74)
    ids = face.topology.landmarks["fw74"]
    fixed = load_scheme("fw74").fixed
    used = fixed[np.isfinite(landmarks[fixed]).all(axis=1) & (confidence[fixed] > 0) & (ids[fixed] >= 0)]
    model = face.mean_shape[ids[used]].astype(np.float64)
    return place_points(model, np.asarray(landmarks, np.float64)[used], np.asarray(confidence, np.float64)[used], unit)


def place_points(model: Array, points: Array, weights: Array, unit: str = "auto") -> Placement:
    """Find unit and pose from points (N, 3) of a scan and where they are on the mean face (N, 3); see `place_face`."""
    if len(points) < 4:
        raise NoFaceError(f"at least 4 landmarks must lie on the scan's surface, got {len(points)}.")
    try:
        free = estimate_similarity(model, points, weights=weights)
    except DegenerateError as error:
        raise NoFaceError("landmarks must not lie on one line: they determine no pose.") from error
    if not free.scale > 0:
        raise NoFaceError("landmarks must have an extent, got points that coincide.")
    residual = (points - free.apply(model)) / free.scale
    rms = float(np.sqrt(np.average((residual**2).sum(axis=1), weights=weights)))
    if rms > _FACE_RMS_MM:
        raise NoFaceError(
            f"landmarks must lie as those of a face do (within {_FACE_RMS_MM:g} mm of the mean face's), "
            f"got {rms:.1f} mm{_if_mirrored(model, points, weights)}."
        )
    _check_relief(model, points / free.scale, weights)
    name, size = decide_unit(free.scale, unit)
    exact = estimate_similarity(size * model, points * UNITS[name], weights=weights, with_scale=False)
    scale = 1.0 / UNITS[name]
    return Placement(name, Similarity(scale, exact.rotation, exact.translation * scale), size, rms)


def decide_unit(units_per_mm: float, unit: str = "auto") -> tuple[str, float]:
    """Return the unit in which the mean face, that measures `units_per_mm` of its millimetres, is nearest human size.

    Returns
    -------
    name : str
        Key of `UNITS`.
    size : float
        Size of the face in that unit, relative to the mean face.

    Raises
    ------
    ValueRangeError
        If the face is not of human size in it.

    Examples
    --------
    >>> decide_unit(0.00105)
    ('m', 1.05)
    """
    check_choice("unit", unit, ("auto", *UNITS))
    sizes = {name: units_per_mm * mm for name, mm in UNITS.items() if unit in ("auto", name)}
    name = min(sizes, key=lambda key: abs(np.log(sizes[key])))
    if not _HUMAN[0] <= sizes[name] <= _HUMAN[1]:
        found = ", ".join(f"{size:.3g} times in {key}" for key, size in sizes.items())
        raise ValueRangeError(
            f"the face in the scan must be {_HUMAN[0]:g} to {_HUMAN[1]:g} times the size of a mean face, got {found}: "
            f"{'scale the scan' if unit == 'auto' else 'leave the unit to be found, or scale the scan'}."
        )
    return name, float(sizes[name])


def _check_relief(model: Array, points: Array, weights: Array) -> None:
    """Refuse landmarks that lie far nearer to a plane than the mean face's, or further: a picture, a squeezed scan."""
    (usual, _), (found, extent) = _thickness(model, weights), _thickness(points, weights)
    relief = found / usual if usual > 1e-3 * extent else 1.0
    if not _RELIEF[0] <= relief <= _RELIEF[1]:
        raise NoFaceError(
            f"landmarks must stand {_RELIEF[0]:g} to {_RELIEF[1]:g} times as far out of their plane as those of a mean "
            f"face, got {relief:.2f} times: a flat picture or a squeezed scan is no face."
        )


def _thickness(points: Array, weights: Array) -> tuple[float, float]:
    """Return the smallest and the largest standard deviation of points (N, 3) over all directions."""
    centred = points - np.average(points, axis=0, weights=weights)
    variances = np.linalg.eigvalsh((weights[:, None] * centred).T @ centred / weights.sum())
    return float(np.sqrt(max(variances[0], 0.0))), float(np.sqrt(variances[2]))


def _if_mirrored(model: Array, points: Array, weights: Array) -> str:
    """Say so if the points fit the mirror image: left and right exchanged, or a scan that is inside out."""
    mirrored = model * [-1.0, 1.0, 1.0]
    try:
        turned = estimate_similarity(mirrored, points, weights=weights)
    except DegenerateError:
        return ""
    residual = (points - turned.apply(mirrored)) / max(turned.scale, 1e-12)
    if np.sqrt(np.average((residual**2).sum(axis=1), weights=weights)) > _FACE_RMS_MM:
        return ""
    return "; their mirror image fits: left and right are exchanged, or the scan is seen from inside"


def scan_target(
    vertices: NDArray[np.floating],
    faces: NDArray[np.integer],
    placement: Placement,
    landmarks: NDArray[np.floating],
    confidence: NDArray[np.floating],
) -> ScanTarget:
    """Cut the head out of a scan and bring it to model space.

    Vertices at one place become one; spikes, loose pieces and triangles without area are left out; triangles are turned
    to face outwards.

    Parameters
    ----------
    vertices : ndarray of shape (N, 3), the scan's unit
        The scan.
    faces : ndarray of shape (F, 3)
        Its triangles, of any orientation.
    placement : Placement
        Where the face is.
    landmarks : ndarray of shape (74, 3), the scan's unit
        ``fw74`` landmarks.
    confidence : ndarray of shape (74,)
        Their weights.

    Returns
    -------
    ScanTarget
        In model space: millimetres, upright, near the template.

    Raises
    ------
    NoFaceError
        If hardly any surface is left around the landmarks.
    """
    check_finite("vertices", vertices)
    to_model = placement.scan_from_model.inverse()
    marks = to_model.apply(landmarks)
    used = np.isfinite(marks).all(axis=1) & (np.asarray(confidence) > 0)
    middle = marks[used].mean(axis=0)
    points = to_model.apply(np.asarray(vertices, dtype=np.float64))
    near = (np.linalg.norm(points - middle, axis=1) <= _REACH_MM)[faces].all(axis=1)
    points, triangles = weld(points, np.asarray(faces)[near])
    triangles = drop_spikes(points, triangles)
    triangles = drop_loose_pieces(points, triangles)
    if len(triangles) < _LEAST_TRIANGLES:
        raise NoFaceError(
            f"the scan must have a surface around the landmarks (at least {_LEAST_TRIANGLES} triangles), "
            f"got {len(triangles)}."
        )
    triangles = face_outwards(points, triangles, middle - [0.0, 0.0, _DEPTH_MM])
    kept, flat = np.unique(triangles, return_inverse=True)
    points, rows = points[kept], flat.reshape(triangles.shape).astype(np.int32)
    marks[~used] = np.nan
    return ScanTarget(
        points, vertex_normals(points, rows), rows, marks, np.where(used, confidence, 0.0).astype(np.float64)
    )


def weld(points: Array, faces: NDArray[np.integer], tolerance: float = 1e-3) -> tuple[Array, NDArray[np.integer]]:
    """Make vertices (N, 3) at one place (to `tolerance`) one; return those used and the triangles that keep an area."""
    kept, flat = np.unique(faces, return_inverse=True)
    cells = np.round(points[kept] / tolerance).astype(np.int64)
    _, first, place = np.unique(cells, axis=0, return_index=True, return_inverse=True)
    triangles = place.ravel()[flat].reshape(-1, 3)
    joined = points[kept][first]
    area = np.linalg.norm(face_area_vectors(joined, triangles), axis=1) if len(triangles) else np.empty(0)
    return joined, triangles[area > 1e-9]


def drop_spikes(points: Array, faces: NDArray[np.integer]) -> NDArray[np.integer]:
    """Return the triangles (F, 3) without those that have a far longer edge than most."""
    if not len(faces):
        return faces
    corners = points[faces]
    longest = np.linalg.norm(corners - np.roll(corners, 1, axis=1), axis=2).max(axis=1)
    return faces[longest <= max(_LONG_MM, _LONG_TIMES * float(np.median(longest)))]


def drop_loose_pieces(points: Array, faces: NDArray[np.integer], share: float = 0.02) -> NDArray[np.integer]:
    """Return the triangles (F, 3) of pieces that have at least `share` of the largest piece's area.

    A soup of triangles without common vertices has no pieces to tell apart and is kept.
    """
    if not len(faces):
        return faces
    edges = half_edges(faces)
    graph = sparse.coo_matrix((np.ones(len(edges)), (edges[:, 0], edges[:, 1])), shape=(len(points), len(points)))
    _, labels = connected_components(graph, directed=False)
    piece = labels[faces[:, 0]]
    area = np.bincount(piece, np.linalg.norm(face_area_vectors(points, faces), axis=1))
    if area.max() < 0.3 * area.sum():
        return faces
    return faces[area[piece] >= share * area.max()]


def face_outwards(points: Array, faces: NDArray[np.integer], middle: Array) -> NDArray[np.integer]:
    """Return triangles (F, 3) turned so that they face away from `middle` (3,), as a whole where they agree.

    Where neighbours are turned against one another, each is turned on its own.
    """
    directed = half_edges(faces)
    keys = directed[:, 0] * (int(faces.max(initial=0)) + 1) + directed[:, 1]
    disagree = 1.0 - len(np.unique(keys)) / max(len(keys), 1)
    vectors = face_area_vectors(points, faces)
    outwards = (vectors * (points[faces].mean(axis=1) - middle)).sum(axis=1)
    turned = outwards < 0 if disagree > 0.02 else np.full(len(faces), outwards.sum() < 0)
    return np.where(turned[:, None], faces[:, ::-1], faces)
