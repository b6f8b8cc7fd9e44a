"""Where the eyes of a tracked clip look: from the irises, both eyes together, held while they are closed."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter1d, median_filter

from facewright.apps.paint_person import face_of_model
from facewright.camera.pinhole import RigidMotion
from facewright.fitting.gaze import find_gaze
from facewright.landmarks.scheme import load_scheme
from facewright.landmarks.track import LandmarkTrack

if TYPE_CHECKING:
    from facewright.faces.face import Face
    from facewright.fitting.video import VideoFit

#: Blink coefficient from which an eye shows too little of its iris.
CLOSED = 0.45
#: Frames: outliers up to one, then noise.
_MEDIAN, _SMOOTHING = 3, 0.8


def track_gaze(fit: VideoFit, track: LandmarkTrack) -> NDArray[np.float64]:
    """Find the gaze in every frame of a fitted clip.

    Each iris gives the turn of its eyeball (`facewright.fitting.gaze.find_gaze`). Both eyes turn together: the mean of
    the two, and the clip's usual difference between them. Frames with closed eyes, or without a face, take the gaze
    between their neighbours' within the shot.

    Parameters
    ----------
    fit : VideoFit
        Identity, camera and poses.
    track : LandmarkTrack
        The points it was fitted to.

    Returns
    -------
    ndarray of shape (T, 2, 2), radians
        Yaw and pitch of the right and the left eyeball relative to the head; zero where the model's face is not
        installed or no frame shows an open eye.
    """
    T = track.n_frames
    whole = _whole_face(fit)
    if whole is None:
        return np.zeros((T, 2, 2))
    face, vertices = whole
    performance, groups = fit.performance, load_scheme("mediapipe478").groups
    irises = np.stack([track.points[:, groups[f"{side}_iris"]].mean(axis=1) for side in ("right", "left")], axis=1)
    seen = track.tracked & (_blink(fit) < CLOSED)
    gaze = np.full((T, 2, 2), np.nan)
    for k in np.flatnonzero(seen):
        pose = RigidMotion(performance.rotations[k], performance.translations[k])
        gaze[k] = find_gaze(face, vertices, irises[k].astype(np.float64), fit.identity.intrinsics, pose)
    if not seen.any():
        return np.zeros((T, 2, 2))
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


def _blink(fit: VideoFit) -> NDArray[np.float64]:
    """Return the larger blink coefficient of each frame, (T,)."""
    performance = fit.performance
    columns = [k for k, name in enumerate(performance.names) if name.startswith("eyeBlink")]
    return performance.weights[:, columns].max(axis=1, initial=0.0)


def _whole_face(fit: VideoFit) -> tuple[Face, NDArray[np.float64]] | None:
    """Return the face with all parts and the clip's person on it, (V, 3)."""
    from facewright.faces import load_face
    from facewright.faces.attach_parts import parts_attacher

    model = fit.identity.model
    if face_of_model(model) is None:
        return None
    face = load_face(str(model.provenance["face"]))
    neutral = fit.identity.rig.neutral.astype(np.float64)
    if len(neutral) == face.topology.n_vertices:
        return face, neutral
    return face, parts_attacher(face).neutral(neutral).astype(np.float64)
