"""Find the face in a photo, and refuse what cannot be redrawn."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from facewright.errors import NoFaceError, ValueRangeError
from facewright.fitting.image import PhotoFit
from facewright.fitting.lip_line import refine_lip_line
from facewright.landmarks.points import Landmarks

if TYPE_CHECKING:
    from facewright.io.image import PhotoFile
    from facewright.landmarks.detector import LandmarkDetector

#: Largest turn of a head, degrees, of which enough is seen to redraw the face.
MAX_YAW, MAX_PITCH = 55.0, 45.0
#: Largest mean distance of the landmarks from the fit's, as a share of the inter-ocular distance.
MAX_RESIDUAL_IOD = 0.15
#: Side, pixels, of the copy of a picture that faces are searched in.
_SEARCH_SIDE = 2000


def find_face(
    file: PhotoFile,
    name: str,
    face_index: int,
    given: Landmarks | None,
    detector: LandmarkDetector | None,
    task_file: Path | None,
) -> tuple[Landmarks, int]:
    """Return the landmarks to use and the number of faces found."""
    if face_index < 0:
        raise ValueRangeError(f"face_index must not be negative, got {face_index}.")
    from facewright.errors import MissingExtraError
    from facewright.landmarks.detector import open_detector

    picture = file.over_white()
    try:
        if detector is not None:
            faces = _detect(detector, picture)
        else:
            with open_detector(task_file) as opened:
                faces = _detect(opened, picture)
    except MissingExtraError:
        if given is None:
            raise
        faces = []
    if given is not None:
        if not faces:
            return given, 0
        by_hand = given.convert("fw74")
        nearest = min(faces, key=lambda face: _distance(face.convert("fw74"), by_hand))
        return refine_lip_line(picture, nearest).convert("fw74").overridden_by(by_hand), len(faces)
    if not faces:
        raise NoFaceError(
            f"{name} must show a face, the detector found none; give its points with --landmarks if there is one."
        )
    if face_index >= len(faces):
        counted = "1 face" if len(faces) == 1 else f"{len(faces)} faces"
        raise NoFaceError(f"{name} must show face {face_index} (0 is the largest), the detector found {counted}.")
    return refine_lip_line(picture, faces[face_index]), len(faces)


def _detect(detector: LandmarkDetector, picture: NDArray[np.uint8]) -> list[Landmarks]:
    """Search a small copy of large pictures first: the networks look at a few hundred pixels anyhow."""
    from facewright.io.image import reduced

    step = int(np.ceil(max(picture.shape[:2]) / _SEARCH_SIDE))
    if step > 1:
        small = detector.detect(reduced(picture, step))
        if small:
            # the centre of a small pixel is that of the block it was made from
            return [replace(found, points=found.points * step + (step - 1) / 2) for found in small]
    return detector.detect(picture)


def _distance(face: Landmarks, by_hand: Landmarks) -> float:
    present = by_hand.present
    return float(np.nanmean(np.linalg.norm(face.points[present] - by_hand.points[present], axis=1)))


def check_in_picture(found: Landmarks, picture: NDArray[np.uint8], name: str) -> None:
    """Refuse points of another picture: most of a face lies in its own."""
    height, width = picture.shape[:2]
    points = found.points[found.present]
    inside = ((points >= -0.5) & (points <= (width - 0.5, height - 0.5))).all(axis=1)
    if len(points) and inside.mean() < 1 / 3:
        raise ValueRangeError(
            f"landmarks must lie in the picture they belong to: {name} is {width} x {height} pixels, and "
            f"{int((~inside).sum())} of {len(points)} points lie outside."
        )


def check_fit(fit: PhotoFit, name: str) -> None:
    """Refuse heads that show too little of their face, and points that no face has."""
    yaw, pitch, _ = fit.head_angles_degrees
    if abs(yaw) > MAX_YAW or abs(pitch) > MAX_PITCH:
        way, angle, most = ("sideways", yaw, MAX_YAW) if abs(yaw) > MAX_YAW else ("up or down", pitch, MAX_PITCH)
        raise ValueRangeError(
            f"{name} must show a face turned {way} by at most {most:.0f} degrees, got {abs(angle):.0f}: too little of "
            "the face is seen to redraw it."
        )
    if not fit.reprojection_iod <= MAX_RESIDUAL_IOD:
        raise ValueRangeError(
            f"{name} must show a face whose points fit the model to within {100 * MAX_RESIDUAL_IOD:.0f} % of the "
            f"distance between the eyes, got {100 * fit.reprojection_iod:.0f} %: not a face seen from the front, or "
            "wrong points."
        )
