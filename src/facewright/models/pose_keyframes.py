"""Poses at moments in time, and the smooth way between them in a model's parameter space."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from facewright.errors import ValueRangeError
from facewright.numeric.check import check_finite, check_shape

#: Two keyframes must be this far apart, seconds: below a frame of any film.
SHORTEST_SECONDS = 1e-3


@dataclass(frozen=True, eq=False)
class PoseKeyframes:
    """K poses of one model in time; between them each coefficient moves monotonically and smoothly.

    Cubic Hermite pieces whose slopes are the harmonic means of Fritsch and Butland: a coefficient never leaves the
    range of the two keyframes around it, so bounds of blendshapes hold. Motion begins and ends at rest, and so does
    every coefficient that turns back at a keyframe.

    Parameters
    ----------
    times : ndarray of shape (K,), float64, seconds
        Strictly increasing, not negative; K may be 0.
    coefficients : ndarray of shape (K, P), float64

    Raises
    ------
    ShapeError, ValueRangeError
        If arrays do not match, a value is not finite, or times do not increase from 0 or later.

    Examples
    --------
    >>> keys = PoseKeyframes(np.array([0.0, 2.0]), np.array([[0.0], [4.0]]))
    >>> keys.at([-1.0, 0.0, 1.0, 2.0, 3.0]).ravel().tolist()
    [0.0, 0.0, 2.0, 4.0, 4.0]
    """

    times: NDArray[np.float64]
    coefficients: NDArray[np.float64]

    def __post_init__(self) -> None:
        sizes = check_shape("times", self.times, "K")
        check_shape("coefficients", self.coefficients, "K", "P", **sizes)
        check_finite("times", self.times)
        check_finite("coefficients", self.coefficients)
        if sizes["K"] and (self.times[0] < 0 or (np.diff(self.times) < 0.999 * SHORTEST_SECONDS).any()):
            raise ValueRangeError(
                f"times of keyframes must increase from 0 or later, by {SHORTEST_SECONDS} s or more, got "
                f"{np.array2string(self.times, threshold=8, precision=3)}."
            )

    @classmethod
    def none(cls, n_coefficients: int) -> PoseKeyframes:
        """Return no keyframes of a model of `n_coefficients`."""
        return cls(np.zeros(0), np.zeros((0, n_coefficients)))

    def __len__(self) -> int:
        return len(self.times)

    @property
    def duration(self) -> float:
        """Time of the last keyframe, seconds; 0 without keyframes."""
        return float(self.times[-1]) if len(self.times) else 0.0

    def with_key(self, time: float, coefficients: NDArray[np.floating]) -> PoseKeyframes:
        """Return these keyframes with one more; one that is there at that time already is replaced.

        Raises
        ------
        ShapeError, ValueRangeError
            If the time is negative or not finite, or the coefficients are not P finite numbers.
        """
        check_shape("coefficients", coefficients, self.coefficients.shape[1])
        check_finite("coefficients", coefficients)
        if not (np.isfinite(time) and time >= 0):
            raise ValueRangeError(f"time of a keyframe must be 0 s or later, got {time}.")
        kept = np.abs(self.times - time) >= SHORTEST_SECONDS
        times = np.append(self.times[kept], float(time))
        order = np.argsort(times)
        return PoseKeyframes(times[order], np.concatenate([self.coefficients[kept], [coefficients]])[order])

    def without(self, index: int) -> PoseKeyframes:
        """Return these keyframes without number `index`.

        Raises
        ------
        ValueRangeError
            If there is no such keyframe.
        """
        self._check_index(index)
        return PoseKeyframes(np.delete(self.times, index), np.delete(self.coefficients, index, axis=0))

    def moved(self, index: int, time: float) -> PoseKeyframes:
        """Return these keyframes with number `index` at another time; one that is there already is replaced.

        Raises
        ------
        ValueRangeError
            If there is no such keyframe, or the time is negative or not finite.
        """
        self._check_index(index)
        return self.without(index).with_key(time, self.coefficients[index])

    def index_at(self, time: float, tolerance: float = SHORTEST_SECONDS) -> int | None:
        """Return the number of the keyframe nearest to `time`, None where none is within `tolerance` seconds."""
        if not len(self.times):
            return None
        nearest = int(np.argmin(np.abs(self.times - time)))
        return nearest if abs(self.times[nearest] - time) <= tolerance else None

    def at(self, times: ArrayLike) -> NDArray[np.float64]:
        """Return the coefficients at each of `times` (T,), shape (T, P); before and after they stay as at the ends.

        Raises
        ------
        ShapeError, ValueRangeError
            If `times` is not one row of finite numbers, or there are no keyframes.
        """
        t = np.asarray(times, dtype=np.float64)
        check_shape("times", t, "T")
        check_finite("times", t)
        K = len(self.times)
        if not K:
            raise ValueRangeError("there must be at least one keyframe, got none.")
        if K == 1:
            return np.repeat(self.coefficients, len(t), axis=0)
        t = np.clip(t, self.times[0], self.times[-1])
        k = np.clip(np.searchsorted(self.times, t, side="right") - 1, 0, K - 2)
        h = np.diff(self.times)[k][:, None]
        s = (t - self.times[k])[:, None] / h
        slopes = self._slopes()
        begin, end = self.coefficients[k], self.coefficients[k + 1]
        smooth = s * s * (3.0 - 2.0 * s)
        return (1.0 - smooth) * begin + smooth * end + h * s * (1.0 - s) * ((1.0 - s) * slopes[k] - s * slopes[k + 1])

    def _slopes(self) -> NDArray[np.float64]:
        """Return the derivatives (K, P) at the keyframes: zero at both ends and wherever a coefficient turns back."""
        h = np.diff(self.times)
        secants = np.diff(self.coefficients, axis=0) / h[:, None]
        slopes = np.zeros_like(self.coefficients)
        left, right = secants[:-1], secants[1:]
        w1, w2 = (2.0 * h[1:] + h[:-1])[:, None], (h[1:] + 2.0 * h[:-1])[:, None]
        onward = left * right > 0
        slopes[1:-1][onward] = ((w1 + w2) / (w1 / np.where(onward, left, 1) + w2 / np.where(onward, right, 1)))[onward]
        return slopes

    def _check_index(self, index: int) -> None:
        if not 0 <= index < len(self.times):
            raise ValueRangeError(f"index of a keyframe must lie in [0, {len(self.times)}), got {index}.")
