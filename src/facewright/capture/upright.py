"""Find which way is up: a phone held upright stores pictures in which heads lie on their side."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from facewright.capture.quarter_turns import turn_picture
from facewright.capture.recording import Recording
from facewright.landmarks.detector import LandmarkDetector
from facewright.landmarks.points import Landmarks

# As stored first; phones held upright need 3; upside down is rare.
_ORDER = (0, 3, 1, 2)
_N_FRAMES = 3
_MAX_TILT_DEGREES = 45.0


def find_quarter_turns(recording: Recording, detector: LandmarkDetector) -> int | None:
    """Return by how many more counter-clockwise quarter turns the recording's heads are upright.

    Parameters
    ----------
    recording : Recording
        Its middle frame is looked at, then one before and one after.
    detector : LandmarkDetector
        Finds faces; it may also find some that lie on their side.

    Returns
    -------
    int or None
        0 to 3, to add to `recording.quarter_turns`; None where no face is found any way round.
    """
    n = recording.n_frames
    for i in list(dict.fromkeys((n // 2, n // 4, (3 * n) // 4)))[:_N_FRAMES]:
        turns = upright_turns(recording.frame(i).color, detector)
        if turns is not None:
            return turns
    return None


def upright_turns(picture: NDArray[np.uint8], detector: LandmarkDetector) -> int | None:
    """Return the counter-clockwise quarter turns after which a face is found upright in a picture (H, W, 3)."""
    for turns in _ORDER:
        if any(is_upright(face) for face in detector.detect(turn_picture(picture, turns))):
            return turns
    return None


def is_upright(face: Landmarks) -> bool:
    """Tell whether the mouth lies below the eyes, within 45 degrees of straight down."""
    groups = face.definition.groups
    eyes = np.nanmean(face.points[np.concatenate([groups["right_eye"], groups["left_eye"]])], axis=0)
    x, y = np.nanmean(face.points[groups["outer_mouth"]], axis=0) - eyes
    return bool(y > 0 and np.degrees(np.arctan2(abs(x), y)) <= _MAX_TILT_DEGREES)
