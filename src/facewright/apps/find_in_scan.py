"""Find the face in a scan of unknown orientation: look from many directions, lift what the detector finds by depth."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from facewright.camera.rotation import rotation_from_vector
from facewright.errors import NoFaceError, ValueRangeError
from facewright.faces.face import Face
from facewright.fitting.scan_placement import UNITS, Placement, place_face
from facewright.imaging.scan_views import ScanView, ScanViewer, axis_rotations, even_rotations
from facewright.landmarks.detector import LandmarkDetector
from facewright.landmarks.lift import lift_landmarks
from facewright.landmarks.points import Landmarks

Progress = Callable[[str, int, int], None]
Array = NDArray[np.float64]

#: Directions of the second search, when none of the 24 axis-aligned ones shows a face.
_EVEN = 72
#: A scan that is this many times longer than thick is more than a head: its ends are looked at as well.
_LONG = 2.5
#: Height of a face from the brows to the chin, by which pixels become millimetres before the unit is known.
_BROW_TO_CHIN_MM = 120.0
#: Turns about the face's axes, degrees (yaw, pitch), from which the landmarks are averaged.
_LOOKS = ((0, 0), (15, 0), (-15, 0), (30, 0), (-30, 0), (0, 12), (0, -12), (18, 10), (-18, 10))
#: Radius, in mm of a mean face, of the pictures of the face, and where their middle is in model space.
_FACE_RADIUS_MM, _FACE_MIDDLE = 125.0, (0.0, -5.0, 90.0)
_FEWEST_LOOKS = 3
_TWICE = 2
#: Landmarks of one look further than this from the median of all looks are left out; mm.
_OUTLIER_MM = 6.0


@dataclass(frozen=True, eq=False)
class FoundFace:
    """A face in a scan.

    Parameters
    ----------
    placement : Placement
        Unit and pose.
    landmarks : ndarray of shape (74, 3), float64, the scan's unit
        ``fw74`` landmarks on the surface; NaN where there is none.
    confidence : ndarray of shape (74,), float64
        Their weights; 0 where there is none.
    looks : int
        Pictures in which the detector found them; 0 for hand-placed ones.
    """

    placement: Placement
    landmarks: Array
    confidence: Array
    looks: int


def find_face(
    viewer: ScanViewer, face: Face, detector: LandmarkDetector, unit: str = "auto", progress: Progress | None = None
) -> FoundFace:
    """Find the face in a scan.

    Parameters
    ----------
    viewer : ScanViewer
        The scan.
    face : Face
        The template, with ``fw74`` landmarks.
    detector : LandmarkDetector
        Looks at the pictures; it should not look long where there is no face.
    unit : str
        ``"auto"`` or a key of `facewright.fitting.scan_placement.UNITS`.
    progress : callable, optional
        Called as progress("looking for the face", done, total).

    Raises
    ------
    NoFaceError
        If there is no face to be seen from any direction.
    ValueRangeError
        If there is one, but not of human size in any unit, or in the one that was given.
    """
    size_errors: list[ValueRangeError] = []
    total = 24 * len(_regions(viewer)) + _EVEN
    for done, (rotation, middle, radius) in enumerate(_directions(viewer)):
        if progress is not None:
            progress("looking for the face", done, total)
        view = viewer.view(rotation, middle=middle, radius=radius)
        for landmarks in detector.detect(view.image):
            try:
                placement = _place(view, landmarks, face, unit)
                found = _refine(viewer, face, detector, placement, unit)
            except ValueRangeError as error:
                size_errors.append(error)
            except NoFaceError:  # what looks like a face has not a face's depth: its inside, a picture, a chance
                continue
            else:
                if progress is not None:
                    progress("looking for the face", total, total)
                return found
    if len(size_errors) >= _TWICE:  # one alone may be a chance
        raise size_errors[0]
    raise NoFaceError(
        "the scan must show a face, the detector found none from any direction whose depth is a face's: "
        "give landmarks of the scan, or cut away what hides the face."
    )


def landmarks_by_looks(
    viewer: ScanViewer, face: Face, detector: LandmarkDetector, placement: Placement
) -> tuple[Array, Array, int]:
    """Average the landmarks that the detector finds from a dozen directions around a placed face.

    Returns
    -------
    landmarks : ndarray of shape (74, 3), the scan's unit
        Medians over the looks, NaN where there are too few.
    confidence : ndarray of shape (74,)
        The detector's, lower where the looks disagree.
    looks : int
        Looks in which the detector found the face.

    Raises
    ------
    NoFaceError
        If too few looks find the face.
    """
    mm = UNITS[placement.unit]
    expected = placement.scan_from_model.apply(_model_landmarks(face) * placement.size)
    lifted, weights = [], []
    for yaw, pitch in _LOOKS:
        view = _look(viewer, placement, yaw, pitch, size=448, supersample=2)
        for landmarks in detector.detect(view.image)[:1]:
            points, confidence = lift_landmarks(landmarks, view.depth * mm, view.intrinsics)
            points = view.to_scan(points / mm)
            known = np.isfinite(points).all(axis=1)
            away = np.linalg.norm(points - expected, axis=1)[known] * mm
            if known.sum() >= 20 and np.median(away) <= 15.0:  # else it looks at something else
                lifted.append(points)
                weights.append(np.where(known, confidence, 0.0))
    if len(lifted) < _FEWEST_LOOKS:
        raise NoFaceError(f"the face must be found in at least {_FEWEST_LOOKS} pictures, got {len(lifted)}.")
    return *_consensus(np.array(lifted), np.array(weights), mm), len(lifted)


def _consensus(points: Array, weights: Array, mm: float) -> tuple[Array, Array]:
    """Return robust means (74, 3) and confidences (74,) of looks (N, 74, 3) and (N, 74)."""
    known = weights > 0
    enough = known.sum(axis=0) >= _FEWEST_LOOKS
    middle = np.full(points.shape[1:], np.nan)
    middle[enough] = np.nanmedian(points[:, enough], axis=0)
    with np.errstate(invalid="ignore"):
        away = np.linalg.norm(points - middle, axis=2) * mm
    kept = known & (away <= _OUTLIER_MM) & enough
    w = np.where(kept, weights, 0.0)
    total = w.sum(axis=0)
    good = kept.sum(axis=0) >= _FEWEST_LOOKS
    mean = np.full(points.shape[1:], np.nan)
    mean[good] = np.einsum("nl,nlx->lx", w, np.where(kept[..., None], points, 0.0))[good] / total[good, None]
    spread = np.sqrt(np.where(kept, away**2, 0.0).sum(axis=0) / np.maximum(kept.sum(axis=0), 1))
    confidence = np.where(good, weights.max(axis=0) / (1.0 + (spread / 2.0) ** 2), 0.0)
    return mean, confidence


def _refine(viewer: ScanViewer, face: Face, detector: LandmarkDetector, placement: Placement, unit: str) -> FoundFace:
    """Look again from the front, until the pose stays, then from a dozen directions."""
    for _ in range(3):
        view = _look(viewer, placement, 0.0, 0.0, size=384, supersample=1)
        seen = detector.detect(view.image)
        if not seen:
            raise NoFaceError("the face must be found again from the front, got none.")
        before, placement = placement, _place(view, seen[0], face, unit)
        turn = before.scan_from_model.rotation.T @ placement.scan_from_model.rotation
        if np.trace(turn) > 1.0 + 2.0 * np.cos(np.deg2rad(6.0)):
            break
    landmarks, confidence, looks = landmarks_by_looks(viewer, face, detector, placement)
    return FoundFace(place_face(face, landmarks, confidence, unit), landmarks, confidence, looks)


def _place(view: ScanView, landmarks: Landmarks, face: Face, unit: str) -> Placement:
    """Place the face by the landmarks of one picture."""
    found = landmarks if landmarks.scheme == "fw74" else landmarks.convert("fw74")
    _, top, _, bottom = found.box
    rows, columns = np.nonzero(view.depth)
    left, right = found.box[0], found.box[2]
    inside = (rows >= top) & (rows <= bottom) & (columns >= left) & (columns <= right)
    if not inside.any() or not bottom > top:
        raise NoFaceError("a face must lie on the scan, got one in the background.")
    distance = float(np.median(view.depth[rows[inside], columns[inside]]))
    # lifting wants millimetres: to within what faces differ is near enough
    scale = _BROW_TO_CHIN_MM * view.intrinsics.focal_y / ((bottom - top) * distance)
    points, confidence = lift_landmarks(found, view.depth * scale, view.intrinsics)
    points = view.to_scan(points / scale)
    known = np.isfinite(points).all(axis=1)
    return place_face(face, points, np.where(known, confidence, 0.0), unit)


def _look(
    viewer: ScanViewer, placement: Placement, yaw: float, pitch: float, *, size: int, supersample: int
) -> ScanView:
    """Render the placed face from a direction about its own axes."""
    s = placement.scan_from_model
    turn = rotation_from_vector([np.deg2rad(pitch), 0.0, 0.0]) @ rotation_from_vector([0.0, np.deg2rad(yaw), 0.0])
    return viewer.view(
        turn @ s.rotation.T,
        middle=s.apply(np.array(_FACE_MIDDLE) * placement.size),
        radius=_FACE_RADIUS_MM * placement.size * s.scale,
        size=size,
        supersample=supersample,
    )


def _model_landmarks(face: Face) -> Array:
    ids = face.topology.landmarks["fw74"]
    points = face.mean_shape[np.maximum(ids, 0)].astype(np.float64)
    points[ids < 0] = np.nan
    return points


def _regions(viewer: ScanViewer) -> list[tuple[Array, float]]:
    """Return what to look at, middle and radius: the whole scan, and the ends of long scans, where a head may be."""
    regions = [(viewer.middle, viewer.radius)]
    used = viewer.vertices[np.unique(viewer.faces)]
    near = used[np.linalg.norm(used - viewer.middle, axis=1) <= 1.5 * viewer.radius]
    centred = near - near.mean(axis=0)
    _, _, axes = np.linalg.svd(centred[:: max(len(centred) // 5000, 1)], full_matrices=False)
    along = centred @ axes.T
    low, high = np.percentile(along, [0.5, 99.5], axis=0)
    extent = high - low
    for k in np.flatnonzero(extent > _LONG * extent.min()):
        for end, sign in ((high[k], 1.0), (low[k], -1.0)):
            part = near[sign * (end - along[:, k]) <= 0.15 * extent[k]]
            if len(part) >= 100:
                regions.append((np.median(part, axis=0), 0.13 * float(extent[k])))
    return regions


def _directions(viewer: ScanViewer) -> Iterator[tuple[Array, Array, float]]:
    """Yield rotation, middle and radius of the pictures to look at, the likeliest first."""
    regions = _regions(viewer)
    for middle, radius in regions:
        for rotation in axis_rotations():
            yield rotation, middle, radius
    for rotation in even_rotations(_EVEN):
        yield rotation, *regions[0]


def hand_placed(face: Face, landmarks: Array, confidence: Array, unit: str = "auto") -> FoundFace:
    """Return the face of landmarks that somebody placed on the scan: ``fw74``, (74, 3), the scan's unit.

    Raises
    ------
    NoFaceError, ValueRangeError
        If they are not those of a face; see `facewright.fitting.scan_placement.place_face`.
    """
    return FoundFace(place_face(face, landmarks, confidence, unit), landmarks, confidence, 0)


def complete_by_detector(
    viewer: ScanViewer, face: Face, detector: LandmarkDetector, given: FoundFace, unit: str = "auto"
) -> FoundFace:
    """Add what the detector sees of a face whose few points (confidence 1) somebody placed; those stay.

    Raises
    ------
    NoFaceError
        If the detector finds no face there.
    """
    landmarks, confidence, looks = landmarks_by_looks(viewer, face, detector, given.placement)
    stay = given.confidence >= 1.0
    landmarks[stay], confidence[stay] = given.landmarks[stay], 1.0
    return FoundFace(place_face(face, landmarks, confidence, unit), landmarks, confidence, looks)
