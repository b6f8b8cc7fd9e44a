"""Following one face through a video with MediaPipe: a few milliseconds a frame, found again after losses and cuts."""

from __future__ import annotations

from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from facewright.errors import MissingExtraError, ShapeError, ValueRangeError
from facewright.landmarks.mediapipe_detector import MediaPipeDetector, import_mediapipe, quiet_native_log

#: The window that is looked at reaches this far beyond the face, in sides of its box, and is laid anew when the face
#: comes nearer to the window's edge than the second.
_REACH, _NEAREST = 0.9, 0.25
#: Two finds overlap by at least this share (intersection over union) if they are the same face, a frame apart.
_SAME = 0.25
#: A face that is lost is searched for in each of the first frames, then in one of so many.
_SEARCH_AT_ONCE, _SEARCH_EVERY = 3, 5
#: A new shot: the grey thumbnail changes by this much on average, and several times as much as of late.
_CUT_CHANGE, _CUT_RATIO = 0.09, 4.0
#: Of a face shorter than this, in pixels, points are guesses.
_SMALLEST = 12.0


class FrameFace(NamedTuple):
    """What is found in one frame.

    Parameters
    ----------
    points : ndarray of shape (478, 2), float32, pixels, or None
        Points of scheme ``mediapipe478``; None where the face is not seen.
    cut : bool
        Whether the frame begins another shot.
    """

    points: NDArray[np.float32] | None
    cut: bool


class VideoDetector:
    """Follow one face from frame to frame.

    A still detector finds the face at the start, after a cut and when it was lost; in between the face mesh follows
    it inside a window of the picture.

    Parameters
    ----------
    face_index : int
        Which face to follow, the largest being 0; chosen anew in every shot.
    task_file : str or path, optional
        A ``face_landmarker.task`` file, for MediaPipe releases without the built-in face mesh; every frame is then
        looked at on its own.

    Raises
    ------
    MissingExtraError
        If MediaPipe is not installed, or its release has no built-in face mesh and no task file is given.
    StoreError, FileFormatError
        If the task file does not exist or is not one.
    ValueRangeError
        If `face_index` is negative.
    """

    def __init__(self, face_index: int = 0, task_file: str | Path | None = None) -> None:
        if face_index < 0:
            raise ValueRangeError(f"face_index must not be negative, got {face_index}.")
        self.face_index = face_index
        self._finder = MediaPipeDetector(task_file=task_file, thorough=True)
        self._mesh = None if task_file is not None else self._open_mesh()
        self._restart()
        self._thumbnail: NDArray[np.float32] | None = None
        self._usual_change = 0.0
        self.n_faces = 0  # seen when the face was last searched for

    def _open_mesh(self) -> Any:
        with quiet_native_log():
            solutions = getattr(import_mediapipe(), "solutions", None)
            if solutions is None or not hasattr(solutions, "face_mesh"):
                raise MissingExtraError(
                    "following a face needs MediaPipe's face mesh: pip install 'facewright[landmarks]'."
                )
            mesh = solutions.face_mesh.FaceMesh(static_image_mode=False, max_num_faces=1, refine_landmarks=True)
            mesh.process(np.zeros((64, 64, 3), np.uint8))  # its threads greet the log: unheard
        return mesh

    def _restart(self) -> None:
        self._window: tuple[int, int, int, int] | None = None
        self._box: NDArray[np.float64] | None = None
        self._lost_for = 0

    def detect(self, image: NDArray[np.uint8]) -> FrameFace:
        """Find the face in the next frame.

        Parameters
        ----------
        image : ndarray of shape (H, W, 3), uint8
            sRGB picture; all frames of one size.

        Raises
        ------
        ShapeError
            If the picture is not (H, W, 3) of uint8.
        """
        if image.ndim != 3 or image.shape[2] != 3 or image.dtype != np.uint8 or 0 in image.shape:
            raise ShapeError(f"image must be (H, W, 3) of uint8, got {image.shape} of {image.dtype}.")
        cut = self._is_cut(image)
        if cut:
            self._restart()
        points = self._follow(image) if self._window is not None else None
        if points is None and (self._lost_for < _SEARCH_AT_ONCE or self._lost_for % _SEARCH_EVERY == 0):
            points = self._search(image)
        if points is None:
            self._window = None
            self._lost_for += 1
            return FrameFace(None, cut)
        self._lost_for = 0
        self._box = _box(points)
        self._keep_window(image)
        return FrameFace(points.astype(np.float32), cut)

    def close(self) -> None:
        """Free the networks; `detect` must not be called any more."""
        self._finder.close()
        if self._mesh is not None:
            self._mesh.close()
            self._mesh = None

    def __enter__(self) -> VideoDetector:
        return self

    def __exit__(self, *error: object) -> None:
        self.close()

    def _follow(self, image: NDArray[np.uint8]) -> NDArray[np.float64] | None:
        """Look at the window; None if the face is not there any more."""
        points = self._look(image)
        if points is None:  # the mesh looks for the face anew in the next picture it gets
            points = self._look(image)
        if points is None or self._box is None or _overlap(_box(points), self._box) < _SAME:
            return None
        return points

    def _look(self, image: NDArray[np.uint8]) -> NDArray[np.float64] | None:
        assert self._window is not None
        left, top, right, bottom = self._window
        if self._mesh is None:
            faces = [face.points for face in self._finder.detect(image[top:bottom, left:right])]
            points = faces[0] + [left, top] if faces else None
        else:
            # MediaPipe silently finds nothing in an array that is not contiguous
            found = self._mesh.process(np.ascontiguousarray(image[top:bottom, left:right])).multi_face_landmarks
            if not found:
                return None
            normalised = np.array([(p.x, p.y) for p in found[0].landmark])
            # its unit square spans the outer edges of the pixels; our first pixel's centre is (0, 0)
            points = normalised * [right - left, bottom - top] + [left - 0.5, top - 0.5]
        return points if points is not None and np.ptp(points[:, 1]) >= _SMALLEST else None

    def _search(self, image: NDArray[np.uint8]) -> NDArray[np.float64] | None:
        """Find the face in the whole picture: where it was last, else by its rank of size."""
        self._finder.thorough = self._lost_for == 0
        faces = [face.points for face in self._finder.detect(image)]
        self.n_faces = len(faces)
        if not faces:
            return None
        chosen = faces[self.face_index] if self.face_index < len(faces) else None
        if self._box is not None:
            known = self._box
            near = max(faces, key=lambda points: _overlap(_box(points), known))
            if _overlap(_box(near), known) > 0.0:
                chosen = near
        if chosen is None:
            return None
        self._lay_window(image, _box(chosen))
        # what the mesh says of it from now on, rather than the still detector
        self._look(image)
        points = self._look(image)
        return points if points is not None and _overlap(_box(points), _box(chosen)) > _SAME else chosen

    def _keep_window(self, image: NDArray[np.uint8]) -> None:
        """Lay the window anew where the face has come near its edge or changed its size; the picture's edge is none."""
        assert self._box is not None
        if self._window is None:
            self._lay_window(image, self._box)
        assert self._window is not None
        height, width = image.shape[:2]
        low, high = self._box[:2], self._box[2:]
        side = float((high - low).max())
        room = np.concatenate([low - self._window[:2], self._window[2:] - high])
        at_edge = np.array(
            [self._window[0] <= 0, self._window[1] <= 0, self._window[2] >= width, self._window[3] >= height]
        )
        too_wide = (room[~at_edge] > 2.5 * side).any()
        if (room[~at_edge] < _NEAREST * side).any() or too_wide:
            self._lay_window(image, self._box)

    def _lay_window(self, image: NDArray[np.uint8], box: NDArray[np.float64]) -> None:
        reach = _REACH * float((box[2:] - box[:2]).max())
        low = np.maximum(np.floor(box[:2] - reach), 0).astype(int)
        high = np.minimum(np.ceil(box[2:] + reach) + 1, image.shape[1::-1]).astype(int)
        high = np.maximum(high, low + 1)
        window = (int(low[0]), int(low[1]), int(high[0]), int(high[1]))
        self._window = window

    def _is_cut(self, image: NDArray[np.uint8]) -> bool:
        """Tell whether the picture has little to do with the one before."""
        height, width = image.shape[:2]
        step = max(1, min(height, width) // 48)
        fine = image[::step, ::step].astype(np.float32).mean(axis=2) / 255.0
        rows, columns = (4 * (n // 4) for n in fine.shape)  # blocks, so that a moving camera is no cut
        small = fine[:rows, :columns].reshape(rows // 4, 4, columns // 4, 4).mean(axis=(1, 3))
        before, self._thumbnail = self._thumbnail, small
        if before is None or before.shape != small.shape:
            return False
        change = float(np.abs(small - before).mean())
        usual, self._usual_change = self._usual_change, 0.8 * self._usual_change + 0.2 * min(change, _CUT_CHANGE)
        return change > _CUT_CHANGE and change > _CUT_RATIO * usual


def _box(points: NDArray[np.floating]) -> NDArray[np.float64]:
    """Return left, top, right, bottom of points (N, 2)."""
    return np.concatenate([points.min(axis=0), points.max(axis=0)]).astype(np.float64)


def _overlap(a: NDArray[np.float64], b: NDArray[np.float64]) -> float:
    """Return the intersection over union of two boxes."""
    common = np.prod(np.maximum(np.minimum(a[2:], b[2:]) - np.maximum(a[:2], b[:2]), 0.0))
    area = np.prod(a[2:] - a[:2]) + np.prod(b[2:] - b[:2]) - common
    return float(common / area) if area > 0 else 0.0
