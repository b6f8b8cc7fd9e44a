"""Where the eyes look in a video: irises against the corners of the eyes."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from facewright.fitting.clip_person import FrameState
from facewright.fitting.dense_model import ClipPerson, DenseModel

#: Points of ``mediapipe478``: corners and iris centre of the right and the left eye.
_CORNERS = ((33, 133), (263, 362))
_IRISES = (468, 473)
#: The eyeball's centre behind the middle of the eye's corners, and the iris before it, millimetres.
_CENTRE_BEHIND, _IRIS_BEFORE = 6.0, 10.5
_FARTHEST = 0.7
#: Eyes that are closed by more than this keep the gaze they had.
_SHUT = 0.5


def frame_gaze(
    model: DenseModel, points478: NDArray[np.floating], person: ClipPerson, state: FrameState
) -> NDArray[np.float64]:
    """Return yaw and pitch (2,), radians, of both eyes, which turn together; zeros where the model lacks the points.

    The detected irises are moved by what the corners of their eye are off the fit; the ray through each meets the
    sphere on which the eyeball carries the iris.

    Parameters
    ----------
    model : DenseModel
        The model; only those of measured faces know the corners.
    points478 : ndarray of shape (478, 2), pixels
        Detected points.
    person : ClipPerson
        Who.
    state : FrameState
        Head and coefficients.
    """
    if model.points.n_points != len(points478):
        return np.zeros(2)
    found = np.asarray(points478, dtype=np.float64)
    K, motion = state.pose.intrinsics, state.pose.motion
    eye = motion.inverse().translation
    axes = []
    for corners, iris in zip(_CORNERS, _IRISES, strict=True):
        ids = list(corners)
        rest = person.neutral[ids].mean(axis=0)
        predicted = K.project(motion.apply(person.neutral[ids])).mean(axis=0)
        x, y = found[iris] - found[ids].mean(axis=0) + predicted
        ray = motion.rotation.T @ np.array([(x - K.centre_x) / K.focal_x, (y - K.centre_y) / K.focal_y, 1.0])
        ray /= np.linalg.norm(ray)
        centre = rest - [0.0, 0.0, _CENTRE_BEHIND]
        along = float((centre - eye) @ ray)
        off2 = float(((eye + along * ray - centre) ** 2).sum())
        axes.append(eye + (along - np.sqrt(max(_IRIS_BEFORE**2 - off2, 0.0))) * ray - centre)
    axis = np.mean(axes, axis=0)
    axis /= np.linalg.norm(axis)
    return np.clip([np.arctan2(axis[0], axis[2]), np.arcsin(np.clip(axis[1], -1, 1))], -_FARTHEST, _FARTHEST)


def keep_through_blinks(gaze: NDArray[np.float64], closure: NDArray[np.floating]) -> NDArray[np.float64]:
    """Return gaze (T, 2) that closed eyes do not disturb: frames around a blink hold what was seen before it.

    Parameters
    ----------
    gaze : ndarray of shape (T, 2), radians
        Measured.
    closure : ndarray of shape (T,)
        How far the eyes are closed.
    """
    shut = np.convolve(closure > _SHUT, np.ones(3), mode="same") > 0
    seen = np.flatnonzero(~shut)
    if not len(seen):
        return np.zeros_like(gaze)
    before = np.clip(np.searchsorted(seen, np.arange(len(gaze)), side="right") - 1, 0, len(seen) - 1)
    held = gaze[seen[before]]
    padded = np.pad(held, ((2, 2), (0, 0)), mode="edge")
    windows = np.stack([padded[k : k + len(gaze)] for k in range(5)])
    return np.median(windows, axis=0)  # eyes jump: the median of five frames keeps steps
