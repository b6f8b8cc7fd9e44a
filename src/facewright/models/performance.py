"""What a face does over time: FACS coefficients and the motion of the head, one row a frame."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from facewright.errors import ValueRangeError
from facewright.numeric.check import check_finite, check_shape


@dataclass(frozen=True, eq=False)
class Performance:
    """FACS coefficients and head poses of T moments; says nothing about who acts.

    Coefficients are absolute: the neutral is the all-zero row, whatever the first frame shows.

    Parameters
    ----------
    times : ndarray of shape (T,), float64, seconds
        Strictly increasing.
    names : tuple of str
        Names of the B blendshapes (without the neutral).
    weights : ndarray of shape (T, B), float64
        FACS coefficients in [0, 1].
    rotations : ndarray of shape (T, 3, 3), float64
        Rotation of the head, camera_from_model; half a turn about x is the upright frontal head.
    translations : ndarray of shape (T, 3), float64, millimetres
        Of the model's origin in the camera's axes; all zero where a source does not say.
    gaze : ndarray of shape (T, 2, 2), float64, radians
        Yaw and pitch of the right and the left eyeball relative to the head: yaw positive towards the subject's left,
        pitch positive upwards. Zero is straight ahead.
    tracked : ndarray of shape (T,), bool
        Frames in which a face was seen; the others hold or ease (see the function that made them).

    Raises
    ------
    ShapeError, ValueRangeError
        If arrays do not match, a value is not finite, a coefficient lies outside [0, 1] or times do not increase.
    """

    times: NDArray[np.float64]
    names: tuple[str, ...]
    weights: NDArray[np.float64]
    rotations: NDArray[np.float64]
    translations: NDArray[np.float64]
    gaze: NDArray[np.float64]
    tracked: NDArray[np.bool_]

    def __post_init__(self) -> None:
        sizes = check_shape("times", self.times, "T")
        check_shape("weights", self.weights, "T", len(self.names), **sizes)
        check_shape("rotations", self.rotations, "T", 3, 3, **sizes)
        check_shape("translations", self.translations, "T", 3, **sizes)
        check_shape("gaze", self.gaze, "T", 2, 2, **sizes)
        check_shape("tracked", self.tracked, "T", **sizes)
        for name in ("times", "weights", "rotations", "translations", "gaze"):
            check_finite(name, getattr(self, name))
        if self.weights.size and not (self.weights.min() >= 0 and self.weights.max() <= 1):
            raise ValueRangeError(
                f"weights must lie in [0, 1], got [{self.weights.min():.3g}, {self.weights.max():.3g}]."
            )
        if (np.diff(self.times) <= 0).any():
            raise ValueRangeError("times must increase from frame to frame, got one that does not.")

    @property
    def n_frames(self) -> int:
        """Number of moments T."""
        return len(self.times)
