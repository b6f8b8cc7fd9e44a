"""MediaPipe as landmark detector: several looks at a picture, so that small and cut faces are found too."""

from __future__ import annotations

import os
import zipfile
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from facewright.errors import FileFormatError, MissingExtraError, ShapeError, StoreError
from facewright.landmarks.points import Landmarks
from facewright.landmarks.scheme import load_scheme

#: Relative precision (1 / variance) of the detector's points against a point placed on the true vertex to within 1 mm,
#: from its errors on 40 renders of simulated people with known landmarks: per coordinate 2.2 % of the inter-ocular
#: distance around the eyes, 3.5 % on the lips, 4 % on brows and nose, 8 % across the contour (it follows a fixed line
#: on the head, not the visible outline).
GROUP_CONFIDENCE = {"eye": 0.35, "mouth": 0.18, "brow": 0.15, "nose": 0.13, "contour": 0.03, "iris": 0.35}
#: Of all other points.
_OTHER_CONFIDENCE = 0.1
#: Further factor for points beyond the picture's edge, which the detector can only guess.
_UNSEEN = 0.1
#: Two finds whose boxes overlap by more than this share (intersection over union) are one face.
_SAME_FACE = 0.3
#: Smallest side, in pixels, at which a part of a picture is shown to the network.
_LOOK_SIZE = 384

Look = Callable[[NDArray[np.uint8]], list[NDArray[np.float64]]]


class MediaPipeDetector:
    """Find 478 points of every face with MediaPipe's face mesh.

    The whole picture is looked at first; then what a long-range face finder proposes, enlarged; and, while no face
    has been found, the picture with a wide border (faces that fill it or are cut by its edge) and overlapping tiles
    (small faces).

    Parameters
    ----------
    task_file : str or path, optional
        A ``face_landmarker.task`` file, for the tasks interface of newer MediaPipe releases; the built-in face mesh
        of MediaPipe 0.10.21 where absent.
    max_faces : int
        At most so many faces are returned.
    min_confidence : float
        Least detection confidence, 0 to 1.
    thorough : bool
        False looks at the whole picture and at what the finder proposes only: far faster where there is no face.

    Raises
    ------
    MissingExtraError
        If MediaPipe is not installed, or its release has no built-in face mesh and no task file is given.
    StoreError, FileFormatError
        If the task file does not exist or is not one.
    """

    def __init__(
        self,
        task_file: str | Path | None = None,
        max_faces: int = 8,
        min_confidence: float = 0.5,
        *,
        thorough: bool = True,
    ) -> None:
        self._closers: list[Any] = []
        with quiet_native_log():
            mediapipe = import_mediapipe()
            if task_file is not None:
                self._look = self._open_task(mediapipe, Path(task_file), max_faces, min_confidence)
            else:
                self._look = self._open_face_mesh(mediapipe, max_faces, min_confidence)
            self._finder = self._open_finder(mediapipe, min_confidence)
            # its threads greet the log when they first work: let them do it unheard
            blank = np.zeros((_LOOK_SIZE, _LOOK_SIZE, 3), np.uint8)
            self._look(blank)
            if self._finder:
                self._finder(blank)
        self.max_faces = max_faces
        self.thorough = thorough

    def detect(self, image: NDArray[np.uint8]) -> list[Landmarks]:
        """Find all faces in a picture.

        Parameters
        ----------
        image : ndarray of shape (H, W, 3), uint8
            sRGB picture.

        Returns
        -------
        list of Landmarks
            One per face in scheme ``mediapipe478``, the largest face first; empty where there is none.

        Raises
        ------
        ShapeError
            If the picture is not (H, W, 3) of uint8.
        """
        if image.ndim != 3 or image.shape[2] != 3 or image.dtype != np.uint8 or 0 in image.shape:
            raise ShapeError(f"image must be (H, W, 3) of uint8, got {image.shape} of {image.dtype}.")
        with quiet_native_log():
            found = self._look_at(image, (0, 0, image.shape[1], image.shape[0]))
            found += self._look_closer(image, (0, 0, image.shape[1], image.shape[0]), found)
            if not found and self.thorough:
                found = self._look_at(image, _bordered(image))
            for tile in _tiles(image) if not found and self.thorough else []:
                found += self._look_closer(image, tile, found) if self._finder else self._look_at(image, tile)
        faces = _largest_first(found)[: self.max_faces]
        return [Landmarks("mediapipe478", points, _confidence(points, image)) for points in faces]

    def close(self) -> None:
        """Free the networks; `detect` must not be called any more."""
        while self._closers:
            self._closers.pop().close()

    def __enter__(self) -> MediaPipeDetector:
        return self

    def __exit__(self, *error: object) -> None:
        self.close()

    def _look_closer(
        self,
        image: NDArray[np.uint8],
        window: tuple[int, int, int, int],
        known: list[NDArray[np.float64]],
    ) -> list[NDArray[np.float64]]:
        """Look at what the long-range finder proposes in a window, but for faces that are known already."""
        found: list[NDArray[np.float64]] = []
        for left, top, right, bottom in self._finder(_cut(image, window)) if self._finder else []:
            around = (left + window[0], top + window[1], right + window[0], bottom + window[1])
            if not any(_overlap(_box(points), _inner(around)) > 0.1 for points in known + found):
                found += self._look_at(image, around)
        return found

    def _look_at(self, image: NDArray[np.uint8], window: tuple[int, int, int, int]) -> list[NDArray[np.float64]]:
        """Look at a window (left, top, right, bottom; may reach beyond the picture); returns pixels of the picture."""
        left, top, right, bottom = window
        part = _cut(image, window)
        zoom = 1
        if min(part.shape[:2]) < _LOOK_SIZE:
            zoom = int(np.ceil(_LOOK_SIZE / min(part.shape[:2])))
            part = _enlarge(part, zoom)
        # MediaPipe silently finds nothing in an array that is not contiguous
        normalised = self._look(np.ascontiguousarray(part))
        # its unit square spans the outer edges of the pixels; our first pixel's centre is (0, 0)
        size = np.array([right - left, bottom - top], dtype=np.float64)
        return [points * size + [left - 0.5, top - 0.5] for points in normalised]

    def _open_face_mesh(self, mediapipe: Any, max_faces: int, min_confidence: float) -> Look:
        solutions = getattr(mediapipe, "solutions", None)
        if solutions is None or not hasattr(solutions, "face_mesh"):
            raise MissingExtraError(
                f"MediaPipe {getattr(mediapipe, '__version__', 'of this release')} has no built-in face mesh: "
                "give a face_landmarker.task file (--task-file) or install facewright[landmarks]."
            )
        mesh = solutions.face_mesh.FaceMesh(
            static_image_mode=True,
            max_num_faces=max_faces,
            refine_landmarks=True,
            min_detection_confidence=min_confidence,
        )
        self._closers.append(mesh)

        def look(part: NDArray[np.uint8]) -> list[NDArray[np.float64]]:
            faces = mesh.process(part).multi_face_landmarks or []
            return [np.array([[p.x, p.y] for p in face.landmark]) for face in faces]

        return look

    def _open_task(self, mediapipe: Any, path: Path, max_faces: int, min_confidence: float) -> Look:
        if not path.is_file():
            raise StoreError(f"task file {path} does not exist.")
        if not zipfile.is_zipfile(path):
            raise FileFormatError(f"{path} must be a MediaPipe face_landmarker.task file, got something else.")
        from mediapipe.tasks.python import BaseOptions, vision

        options = vision.FaceLandmarkerOptions(
            base_options=BaseOptions(model_asset_path=str(path)),
            num_faces=max_faces,
            min_face_detection_confidence=min_confidence,
        )
        try:
            landmarker = vision.FaceLandmarker.create_from_options(options)
        except (RuntimeError, ValueError) as error:
            raise FileFormatError(
                f"{path} must be a MediaPipe face_landmarker.task file; MediaPipe refuses it."
            ) from error
        self._closers.append(landmarker)

        def look(part: NDArray[np.uint8]) -> list[NDArray[np.float64]]:
            picture = mediapipe.Image(image_format=mediapipe.ImageFormat.SRGB, data=part)
            faces = landmarker.detect(picture).face_landmarks
            return [np.array([[p.x, p.y] for p in face]) for face in faces]

        return look

    def _open_finder(
        self, mediapipe: Any, min_confidence: float
    ) -> Callable[[NDArray[np.uint8]], list[tuple[int, int, int, int]]] | None:
        """Return the long-range face finder, or None where this release has none."""
        solutions = getattr(mediapipe, "solutions", None)
        if solutions is None or not hasattr(solutions, "face_detection"):
            return None
        finder = solutions.face_detection.FaceDetection(model_selection=1, min_detection_confidence=min_confidence)
        self._closers.append(finder)

        def find(image: NDArray[np.uint8]) -> list[tuple[int, int, int, int]]:
            height, width = image.shape[:2]
            windows = []
            for found in finder.process(np.ascontiguousarray(image)).detections or []:
                box = found.location_data.relative_bounding_box
                x, y = (box.xmin + box.width / 2) * width, (box.ymin + box.height / 2) * height
                # the face takes up the middle half, which is what the short-range network expects
                reach = max(box.width * width, box.height * height)
                windows.append((int(x - reach), int(y - reach), int(x + reach) + 1, int(y + reach) + 1))
            return windows

        return find


def import_mediapipe() -> Any:
    """Return the package MediaPipe; MissingExtraError where it is not installed."""
    try:
        import mediapipe
    except ImportError as error:
        raise MissingExtraError(
            "finding landmarks needs MediaPipe: pip install 'facewright[landmarks]', or give a points file."
        ) from error
    return mediapipe


def _confidence(points: NDArray[np.float64], image: NDArray[np.uint8]) -> NDArray[np.float64]:
    scheme = load_scheme("mediapipe478")
    confidence = np.full(scheme.n_points, _OTHER_CONFIDENCE)
    for group, ids in scheme.groups.items():
        confidence[ids] = GROUP_CONFIDENCE[group.rsplit("_", maxsplit=1)[-1]]
    seen = ((points >= 0) & (points < [image.shape[1], image.shape[0]])).all(axis=1)
    return np.where(seen, confidence, _UNSEEN * confidence)


@contextmanager
def quiet_native_log() -> Iterator[None]:
    """Hide what MediaPipe's native code writes straight to the process's standard error."""
    try:
        saved = os.dup(2)
    except OSError:  # no standard error to hide
        yield
        return
    sink = os.open(os.devnull, os.O_WRONLY)
    try:
        os.dup2(sink, 2)
        yield
    finally:
        os.dup2(saved, 2)
        os.close(saved)
        os.close(sink)


def _cut(image: NDArray[np.uint8], window: tuple[int, int, int, int]) -> NDArray[np.uint8]:
    """Return the window of the picture; the edge colour continues beyond the picture."""
    left, top, right, bottom = window
    height, width = image.shape[:2]
    rows = np.clip(np.arange(top, bottom), 0, height - 1)
    columns = np.clip(np.arange(left, right), 0, width - 1)
    if left >= 0 and top >= 0 and right <= width and bottom <= height:
        return image[top:bottom, left:right]
    return image[rows[:, None], columns[None, :]]


def _enlarge(part: NDArray[np.uint8], zoom: int) -> NDArray[np.uint8]:
    from PIL import Image

    height, width = part.shape[:2]
    picture = Image.fromarray(np.ascontiguousarray(part)).resize(
        (width * zoom, height * zoom), Image.Resampling.BICUBIC
    )
    return np.asarray(picture)


def _bordered(image: NDArray[np.uint8]) -> tuple[int, int, int, int]:
    height, width = image.shape[:2]
    x, y = width // 2, height // 2
    return -x, -y, width + x, height + y


def _tiles(image: NDArray[np.uint8]) -> list[tuple[int, int, int, int]]:
    """Return square tiles that overlap by half, of a half and a quarter of the shorter side."""
    height, width = image.shape[:2]
    windows = []
    for share in (2, 4):
        side = min(height, width) // share
        if side < 48:
            break
        for top in range(0, height - side // 2, side // 2):
            for left in range(0, width - side // 2, side // 2):
                windows.append((left, top, left + side, top + side))
    return windows


def _box(points: NDArray[np.float64]) -> tuple[float, float, float, float]:
    low, high = points.min(axis=0), points.max(axis=0)
    return float(low[0]), float(low[1]), float(high[0]), float(high[1])


def _inner(window: tuple[int, int, int, int]) -> tuple[float, float, float, float]:
    """Return the middle half of a window: the face that it was made round."""
    left, top, right, bottom = window
    x, y = (right - left) / 4, (bottom - top) / 4
    return left + x, top + y, right - x, bottom - y


def _overlap(a: tuple[float, float, float, float], b: tuple[float, float, float, float]) -> float:
    """Return the intersection over union of two boxes."""
    width = min(a[2], b[2]) - max(a[0], b[0])
    height = min(a[3], b[3]) - max(a[1], b[1])
    if width <= 0 or height <= 0:
        return 0.0
    common = width * height
    return common / ((a[2] - a[0]) * (a[3] - a[1]) + (b[2] - b[0]) * (b[3] - b[1]) - common)


def _largest_first(found: list[NDArray[np.float64]]) -> list[NDArray[np.float64]]:
    """Sort faces by the area of their box and drop the repeats."""

    def area(points: NDArray[np.float64]) -> float:
        left, top, right, bottom = _box(points)
        return (right - left) * (bottom - top)

    kept: list[NDArray[np.float64]] = []
    for points in sorted(found, key=area, reverse=True):
        if all(_overlap(_box(points), _box(other)) <= _SAME_FACE for other in kept):
            kept.append(points)
    return kept
