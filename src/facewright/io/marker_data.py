"""What a motion capture file holds: labelled points over time, some of them unseen."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from facewright.errors import ValueRangeError
from facewright.numeric.check import check_finite, check_shape


@dataclass(frozen=True, eq=False)
class MarkerData:
    """M labelled markers in T frames.

    Parameters
    ----------
    times : ndarray of shape (T,), float64, seconds
        Strictly increasing.
    labels : tuple of str
        Names of the M markers, unique.
    positions : ndarray of shape (T, M, 3), float64, millimetres
        NaN in all three coordinates where a marker was not seen.

    Raises
    ------
    ShapeError, ValueRangeError
        If arrays do not match, labels repeat, times do not increase, or a position is partly NaN or infinite.
    """

    times: NDArray[np.float64]
    labels: tuple[str, ...]
    positions: NDArray[np.float64]

    def __post_init__(self) -> None:
        sizes = check_shape("times", self.times, "T")
        check_shape("positions", self.positions, "T", len(self.labels), 3, **sizes)
        check_finite("times", self.times)
        if len(set(self.labels)) != len(self.labels):
            raise ValueRangeError("labels must be unique, got a label more than once.")
        if (np.diff(self.times) <= 0).any():
            raise ValueRangeError("times must increase from frame to frame, got one that does not.")
        missing = np.isnan(self.positions)
        if np.isinf(self.positions).any() or (missing.any(axis=2) != missing.all(axis=2)).any():
            raise ValueRangeError("positions must be finite or NaN in all three coordinates, got another value.")

    @property
    def seen(self) -> NDArray[np.bool_]:
        """Where a marker was seen, (T, M)."""
        return ~np.isnan(self.positions[..., 0])
