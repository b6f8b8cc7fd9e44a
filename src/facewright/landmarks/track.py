"""The landmarks of one face through a video: what is kept of each frame."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from facewright.errors import ShapeError, ValueRangeError
from facewright.landmarks.points import Landmarks
from facewright.landmarks.scheme import load_scheme
from facewright.numeric.check import check_finite, check_shape

_SCHEME = "mediapipe478"


@dataclass(frozen=True, eq=False)
class LandmarkTrack:
    """Where the points of one face are in the T frames of a video; 4 kB a frame.

    Parameters
    ----------
    times : ndarray of shape (T,), float64, seconds
        Strictly increasing.
    points : ndarray of shape (T, 478, 2), float32, pixels
        Points of scheme ``mediapipe478``; NaN in frames that are not tracked.
    tracked : ndarray of shape (T,), bool
        Frames in which the face was found.
    image_size : (height, width)
        Size of the frames, pixels.
    cuts : ndarray of shape (T,), bool
        Frames that begin another shot: nothing is carried over from the frame before.

    Raises
    ------
    ShapeError, ValueRangeError
        If arrays do not match, times do not increase, or a point of a tracked frame is not finite.
    """

    times: NDArray[np.float64]
    points: NDArray[np.float32]
    tracked: NDArray[np.bool_]
    image_size: tuple[int, int]
    cuts: NDArray[np.bool_] = field(default_factory=lambda: np.zeros(0, bool))

    def __post_init__(self) -> None:
        if not len(self.cuts):
            object.__setattr__(self, "cuts", np.zeros(len(self.times), bool))
        sizes = check_shape("times", self.times, "T")
        check_shape("points", self.points, "T", load_scheme(_SCHEME).n_points, 2, **sizes)
        check_shape("tracked", self.tracked, "T", **sizes)
        check_shape("cuts", self.cuts, "T", **sizes)
        check_finite("times", self.times)
        check_finite("points of tracked frames", self.points[self.tracked])
        if (np.diff(self.times) <= 0).any():
            raise ValueRangeError("times must increase from frame to frame, got one that does not.")
        if min(self.image_size) < 1:
            raise ValueRangeError(f"image_size must be positive, got {self.image_size}.")

    @classmethod
    def of(
        cls,
        times: Sequence[float] | NDArray[np.float64],
        frames: Iterable[NDArray[np.floating] | None],
        image_size: tuple[int, int],
        cuts: Sequence[bool] | NDArray[np.bool_] | None = None,
    ) -> LandmarkTrack:
        """Return the track of the points (478, 2) of each frame, None where no face was found.

        Raises
        ------
        ShapeError, ValueRangeError
            As the class.
        """
        found = list(frames)
        if len(found) != len(times):
            raise ShapeError(f"frames must be as many as times, got {len(found)} and {len(times)}.")
        points = np.full((len(found), load_scheme(_SCHEME).n_points, 2), np.nan, np.float32)
        for row, frame in zip(points, found, strict=True):
            if frame is not None:
                check_shape("points of a frame", frame, *row.shape)
                row[:] = frame
        tracked = np.array([frame is not None for frame in found], dtype=bool)
        starts = np.zeros(len(found), bool) if cuts is None else np.asarray(cuts, dtype=bool)
        return cls(np.asarray(times, dtype=np.float64), points, tracked, image_size, starts)

    @property
    def n_frames(self) -> int:
        """Number of frames T."""
        return len(self.times)

    def landmarks(self, frame: int) -> Landmarks:
        """Return one frame's landmarks; all are missing where the face was not found."""
        confidence = np.full(self.points.shape[1], float(self.tracked[frame]))
        return Landmarks(_SCHEME, self.points[frame].astype(np.float64), confidence)

    def part(self, frames: slice) -> LandmarkTrack:
        """Return a part of the track."""
        return LandmarkTrack(
            self.times[frames], self.points[frames], self.tracked[frames], self.image_size, self.cuts[frames]
        )

    def shots(self) -> list[slice]:
        """Return the unbroken shots, in order: runs of frames between cuts."""
        starts = [0, *(int(i) for i in np.flatnonzero(self.cuts) if i > 0), self.n_frames]
        return [slice(a, b) for a, b in pairwise(starts) if b > a]
