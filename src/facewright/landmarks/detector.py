"""What a landmark detector is: one small protocol, and the default one."""

from __future__ import annotations

from pathlib import Path
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from facewright.landmarks.points import Landmarks


class LandmarkDetector(Protocol):
    """Finds the landmarks of all faces in a picture."""

    def detect(self, image: NDArray[np.uint8]) -> list[Landmarks]:
        """Return the landmarks of every face in an sRGB picture (H, W, 3), the largest face first."""
        ...

    def __enter__(self) -> LandmarkDetector:
        """Return the detector."""
        ...

    def __exit__(self, *error: object) -> None:
        """Free what it holds."""
        ...


def open_detector(
    task_file: str | Path | None = None, max_faces: int = 8, *, thorough: bool = True
) -> LandmarkDetector:
    """Return the default detector, MediaPipe.

    Parameters
    ----------
    task_file : str or path, optional
        A ``face_landmarker.task`` file, for MediaPipe releases without the built-in face mesh; where absent, the
        built-in face mesh of MediaPipe 0.10.21 is used.
    max_faces : int
        At most so many faces are returned.
    thorough : bool
        Search small and cut faces as well; False is far faster where there is no face.

    Raises
    ------
    MissingExtraError
        If MediaPipe is not installed, or its release has no built-in face mesh and no task file is given.
    StoreError, FileFormatError
        If the task file does not exist or is not one.
    """
    from facewright.landmarks.mediapipe_detector import MediaPipeDetector

    return MediaPipeDetector(task_file=task_file, max_faces=max_faces, thorough=thorough)
