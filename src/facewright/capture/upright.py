"""Find which way is up: a phone held upright stores pictures in which heads lie on their side.

Detectors see faces in pictures that are turned any way, also where there is none that way round (eyes upon a mouth).
What they found is therefore held against the depth: the points in 3D must fit a face's in size and shape.
"""

from __future__ import annotations

from functools import cache

import numpy as np
from numpy.typing import NDArray

from facewright.camera.pinhole import RigidMotion
from facewright.capture.camera_file import read_camera_file
from facewright.capture.frame import RGBDFrame
from facewright.capture.quarter_turns import turn_intrinsics, turn_picture
from facewright.capture.recording import Recording
from facewright.landmarks.detector import LandmarkDetector
from facewright.landmarks.lift import lift_landmarks

#: A found face is one if its points are this near to those of the mean face (median), mm.
MAX_OFF_MM = 9.0
#: Kinds of recordings in which a head may lie on its side: phones are held upright, their sensors are not.
_TURNED_KINDS = ("truedepth", "record3d")
_MIN_POINTS = 12
_MAX_TILT = np.cos(np.deg2rad(45.0))
_ROUNDS, _SCALE_MM = 10, 8.0


def turns_of_a_phone(recording: Recording, detector: LandmarkDetector) -> int:
    """Return by how many more counter-clockwise quarter turns a phone's recording is upright.

    Parameters
    ----------
    recording : Recording
        Of any kind; those of other cameras are left as they are, and so are those whose camera file says how to turn.
    detector : LandmarkDetector
        Finds faces.

    Returns
    -------
    int
        0 to 3; 0 also where no face is found any way round.

    Raises
    ------
    FileFormatError, StoreError
        If frames or camera file are damaged.
    """
    if recording.kind not in _TURNED_KINDS or read_camera_file(recording.path).quarter_turns is not None:
        return 0
    return find_quarter_turns(recording, detector) or 0


def find_quarter_turns(recording: Recording, detector: LandmarkDetector) -> int | None:
    """Return by how many more counter-clockwise quarter turns the recording's heads are upright.

    Parameters
    ----------
    recording : Recording
        Its middle frame is looked at in all four ways, then one before and one after until a face is found.
    detector : LandmarkDetector
        Finds faces; it may also find some where there are none.

    Returns
    -------
    int or None
        0 to 3, to add to `recording.quarter_turns`; None where no face is found any way round.
    """
    n = recording.n_frames
    for i in dict.fromkeys((n // 2, n // 4, (3 * n) // 4)):
        turns = upright_turns(recording.frame(i), detector)
        if turns is not None:
            return turns
    return None


def upright_turns(frame: RGBDFrame, detector: LandmarkDetector) -> int | None:
    """Return the counter-clockwise quarter turns after which an upright face fits its depth best, or None."""
    found = [(how_far_off(turned_frame(frame, turns), detector), turns) for turns in range(4)]
    off, turns = min(found)
    return turns if off <= MAX_OFF_MM else None


def how_far_off(frame: RGBDFrame, detector: LandmarkDetector) -> float:
    """Return how far the points of the likeliest upright face of a frame are from those of the mean face.

    Parameters
    ----------
    frame : RGBDFrame
        Picture and depth.
    detector : LandmarkDetector
        Finds faces.

    Returns
    -------
    float, millimetres
        Median distance of the lifted landmarks after rigid alignment; infinite where no face is found whose head is
        within 45 degrees of upright and looks towards the camera.
    """
    best = np.inf
    for face in detector.detect(frame.color):
        points, confidence = lift_landmarks(face.convert("fw74"), frame.depth, frame.intrinsics)
        use = (confidence > 0) & np.isfinite(points).all(axis=1)
        if use.sum() < _MIN_POINTS:
            continue
        template = _mean_landmarks()[use]
        pose = _align(template, points[use])
        up, ahead = pose.rotation[:, 1], pose.rotation[:, 2]
        if -up[1] >= _MAX_TILT and ahead[2] < 0:  # y points down in the camera's frame, z away from it
            best = min(best, float(np.median(np.linalg.norm(pose.apply(template) - points[use], axis=1))))
    return best


def turned_frame(frame: RGBDFrame, turns: int) -> RGBDFrame:
    """Return a frame turned counter-clockwise by quarter turns."""
    k = turn_intrinsics(frame.intrinsics, frame.size, turns)
    return RGBDFrame(turn_picture(frame.color, turns), turn_picture(frame.depth, turns), k, frame.time)


@cache
def _mean_landmarks() -> NDArray[np.float64]:
    """Landmarks (74, 3) of the built-in mean face, mm; those of the contour have no place of their own."""
    from facewright.faces import load_face

    face = load_face("builtin")
    return np.asarray(face.mean_shape, dtype=np.float64)[face.topology.landmarks["fw74"]]


def _align(source: NDArray[np.float64], target: NDArray[np.float64]) -> RigidMotion:
    """Return the rigid motion of points onto points (N, 3) that outliers do not pull (Cauchy weights)."""
    weights = np.ones(len(source))
    for _ in range(_ROUNDS):
        a, b = np.average(source, axis=0, weights=weights), np.average(target, axis=0, weights=weights)
        left, _, right = np.linalg.svd(((target - b) * weights[:, None]).T @ (source - a))
        R = left @ np.diag([1.0, 1.0, np.linalg.det(left @ right)]) @ right
        motion = RigidMotion(R, b - R @ a)
        off = np.linalg.norm(motion.apply(source) - target, axis=1)
        weights = 1.0 / (1.0 + (off / _SCALE_MM) ** 2)
    return motion
