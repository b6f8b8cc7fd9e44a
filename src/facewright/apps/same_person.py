"""Do two photos show one person? By the shape of the face, and by the pattern of light and dark on it."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage, sparse
from scipy.spatial import cKDTree

from facewright.errors import TopologyError
from facewright.fitting.shape_evidence import ShapeEvidence, ShapeWitness, sharing_loss
from facewright.imaging.colour import linear_from_srgb
from facewright.mesh.normals import vertex_normals

if TYPE_CHECKING:
    from facewright.apps.photo_subject import PhotoSubject
    from facewright.faces.face import Face

#: Patterns between these sizes, millimetres, are looked at: brows, eyes, nostrils, folds; not light, not pores.
_FINE_MM, _COARSE_MM = 2.0, 8.0
_SAMPLE_MM = 1.0
_BETWEEN_EYES_MM = 62.0
#: What one unit of `sharing_loss` weighs against the correlation of patterns, and the sum from which two people are
#: told: by the pictures of simulated people, see docs/measured.md.
_SHAPE_WEIGHT, _TWO_PEOPLE = 0.038, -0.40
_LEAST_SEEN = 0.3  # of the upper face, in both photos


@dataclass(frozen=True)
class Comparison:
    """How alike two photos' faces are.

    Parameters
    ----------
    sharing_loss : float
        See `facewright.fitting.shape_evidence.sharing_loss`.
    correlation : float
        Of the patterns on the upper face, -1 to 1.
    """

    sharing_loss: float
    correlation: float

    @property
    def score(self) -> float:
        """The larger the less alike."""
        return _SHAPE_WEIGHT * self.sharing_loss - self.correlation

    @property
    def two_people(self) -> bool:
        """Whether the photos seem to show two people."""
        return self.score > _TWO_PEOPLE


def compare_people(
    first: PhotoSubject, second: PhotoSubject, focal_lengths: tuple[float | None, float | None] = (None, None)
) -> Comparison | None:
    """Compare the faces in two photos; None without the detector's points, or where they are turned too far apart.

    Parameters
    ----------
    first, second : PhotoSubject
        Of one model.
    focal_lengths : (float or None, float or None)
        Of the photos, pixels, where they are known.
    """
    if any(subject.landmarks.scheme != "mediapipe478" for subject in (first, second)):
        return None
    try:
        witness = ShapeWitness(first.fit.model)
    except TopologyError:
        return None
    evidence: list[ShapeEvidence] = [
        witness.evidence(subject.landmarks, subject.fit.image_size, focal)
        for subject, focal in zip((first, second), focal_lengths, strict=True)
    ]
    correlation = pattern_correlation(first, second)
    if correlation is None:
        return None
    return Comparison(sharing_loss(*evidence), correlation)


def pattern_correlation(first: PhotoSubject, second: PhotoSubject) -> float | None:
    """Return the correlation of the patterns on the upper face, or None where too little of it is seen in both."""
    ids = _upper_face(first.face)
    (x, seen), (y, also) = (_pattern(subject, ids) for subject in (first, second))
    w = seen * also
    if w.mean() < _LEAST_SEEN:
        return None
    x, y = (values - (w @ values) / w.sum() for values in (x, y))
    return float((w * x) @ y / np.sqrt(max(float(((w * x) @ x) * ((w * y) @ y)), 1e-30)))


def _upper_face(face: Face) -> NDArray[np.intp]:
    """Return the vertices of the face above the lips, which expressions and the mouth's inside change least."""
    masks = face.topology.masks
    region = masks["face_region"] if "face_region" in masks else masks["face"]
    region = region[region < face.n_skin]
    above = face.mean_shape[region, 1] > face.mean_shape[masks["lips"], 1].max()
    dark = masks["nostril_insides"] if "nostril_insides" in masks else region[:0]
    return np.setdiff1d(region[above], dark).astype(np.intp)


def _pattern(subject: PhotoSubject, ids: NDArray[np.intp]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return the band-passed logarithm of the light from vertices (N,), and how well they are seen, 0 to 1."""
    face, view = subject.face, subject.source
    n = face.n_skin
    camera = view.camera_vertices[:n].astype(np.float64)
    normals = vertex_normals(camera, face.skin().topology.faces)
    facing = -np.einsum("ij,ij->i", normals, camera / np.linalg.norm(camera, axis=1, keepdims=True))[ids]
    seen = np.clip((facing - 0.25) / 0.4, 0.0, 1.0)
    irises = [view.pixels[face.topology.masks[f"iris_{side}"]].mean(axis=0) for side in ("left", "right")]
    per_mm = float(np.linalg.norm(irises[0] - irises[1])) / _BETWEEN_EYES_MM
    pixels = view.pixels[ids]
    low = np.maximum(np.floor(pixels.min(axis=0) - 5 * per_mm).astype(int), 0)
    high = np.maximum(np.ceil(pixels.max(axis=0) + 5 * per_mm).astype(int), low + 1)
    crop = linear_from_srgb(subject.photo[low[1] : high[1] + 1, low[0] : high[0] + 1] / np.float32(255.0))
    light = np.empty((len(ids), 3))
    for k in range(3):
        blurred = ndimage.gaussian_filter(np.asarray(crop[..., k], dtype=np.float64), _SAMPLE_MM * per_mm)
        light[:, k] = ndimage.map_coordinates(blurred, (pixels - low)[:, ::-1].T, order=1, mode="nearest")
    level = np.log(np.maximum(light, 1e-3)).mean(axis=1)
    fine, coarse = _smoothers(face, ids.tobytes())
    bands = [(smooth @ (seen * level)) / np.maximum(smooth @ seen, 1e-6) for smooth in (fine, coarse)]
    return bands[0] - bands[1], seen


@lru_cache(maxsize=2)
def _smoothers(face: Face, ids: bytes) -> tuple[sparse.csr_array, sparse.csr_array]:
    """Return Gaussian sums over the vertices of the mean face, fine and coarse."""
    points = face.mean_shape[np.frombuffer(ids, dtype=np.intp)].astype(np.float64)
    tree = cKDTree(points)
    sums = []
    for size in (_FINE_MM, _COARSE_MM):
        near = tree.sparse_distance_matrix(tree, 3 * size, output_type="coo_matrix")
        weights = sparse.coo_array((np.exp(-0.5 * (near.data / size) ** 2), (near.row, near.col)), shape=near.shape)
        sums.append((weights.tocsr() + sparse.eye_array(len(points), format="csr")).tocsr())
    return sums[0], sums[1]
