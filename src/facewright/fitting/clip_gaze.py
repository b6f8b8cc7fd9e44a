"""Where the eyes of a clip look: both eyes together, from the irises, held while the lids are closed."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter1d, median_filter

from facewright.camera.pinhole import Intrinsics, RigidMotion
from facewright.errors import MissingFaceError
from facewright.faces.face import Face
from facewright.fitting.gaze import find_gaze
from facewright.landmarks.scheme import load_scheme
from facewright.landmarks.track import LandmarkTrack
from facewright.models.bilinear import BilinearModel
from facewright.models.performance import Performance

#: Blink coefficient from which an eye shows too little of its iris.
_CLOSED = 0.45
#: Frames: outliers up to one, then noise.
_MEDIAN, _SMOOTHING = 3, 0.8


def clip_gaze(
    face: Face, neutral: NDArray[np.floating], intrinsics: Intrinsics, performance: Performance, track: LandmarkTrack
) -> NDArray[np.float64]:
    """Find the gaze in every frame of a fitted clip.

    Each iris gives the turn of its eyeball (`facewright.fitting.gaze.find_gaze`). Both eyes turn together: the mean of
    the two, and the clip's usual difference between them. Frames with closed eyes, or without a face, take the gaze
    between their neighbours' within the shot.

    Parameters
    ----------
    face : Face
        All parts of it.
    neutral : ndarray of shape (V, 3), millimetres
        The person at rest, all parts.
    intrinsics : Intrinsics
        The camera.
    performance : Performance
        Coefficients and poses of the clip.
    track : LandmarkTrack
        The points it was fitted to.

    Returns
    -------
    ndarray of shape (T, 2, 2), radians
        Yaw and pitch of the right and the left eyeball relative to the head; zero where no frame shows an open eye.
    """
    groups = load_scheme("mediapipe478").groups
    irises = np.stack([track.points[:, groups[f"{side}_iris"]].mean(axis=1) for side in ("right", "left")], axis=1)
    seen = track.tracked & (_blink(performance) < _CLOSED)
    gaze = np.full((track.n_frames, 2, 2), np.nan)
    for k in np.flatnonzero(seen):
        pose = RigidMotion(performance.rotations[k], performance.translations[k])
        gaze[k] = find_gaze(face, neutral, irises[k].astype(np.float64), intrinsics, pose)
    if not seen.any():
        return np.zeros_like(gaze)
    apart = np.median(gaze[seen, 1] - gaze[seen, 0], axis=0)
    both = gaze.mean(axis=1)
    for shot in track.shots():
        known = np.flatnonzero(seen[shot])
        if not len(known):
            both[shot] = np.median(both[seen], axis=0)
            continue
        for axis in range(2):
            row = np.interp(np.arange(shot.stop - shot.start), known, both[shot, axis][known])
            row = median_filter(row, size=min(_MEDIAN, len(row)), mode="nearest")
            both[shot, axis] = gaussian_filter1d(row, _SMOOTHING, mode="nearest")
    return np.stack([both - 0.5 * apart, both + 0.5 * apart], axis=1)


def whole_face(model: BilinearModel, neutral: NDArray[np.floating]) -> tuple[Face, NDArray[np.float64]] | None:
    """Return the face of a model with all parts, and a person on it, (V, 3); None where it is not installed."""
    from facewright.faces import load_face
    from facewright.faces.attach_parts import parts_attacher

    try:
        face = load_face(str(model.provenance.get("face", "")))
    except MissingFaceError:
        return None
    vertices = np.asarray(neutral, dtype=np.float64)
    if model.topology.fingerprint == face.topology.fingerprint:
        return face, vertices
    if model.topology.fingerprint == face.skin().topology.fingerprint:
        return face, parts_attacher(face).neutral(vertices).astype(np.float64)
    return None


def _blink(performance: Performance) -> NDArray[np.float64]:
    """Return the larger blink coefficient of each frame, (T,)."""
    columns = [k for k, name in enumerate(performance.names) if name.startswith("eyeBlink")]
    return performance.weights[:, columns].max(axis=1, initial=0.0)
