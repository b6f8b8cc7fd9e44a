"""All that an artist's work on a pose consists of, at one moment; and the way back and forth between moments."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from facewright.errors import ValueRangeError
from facewright.models.pose_keyframes import PoseKeyframes

#: The models a session may pose, the second for comparison.
KINDS = ("region", "holistic")


@dataclass(frozen=True, eq=False)
class PoseState:
    """One moment of a session.

    Parameters
    ----------
    coefficients : mapping of str to ndarray of shape (P,)
        zeta of each model that is posed, by its kind.
    keyframes : mapping of str to PoseKeyframes
        Of each model; all at the same times.
    pins : mapping of int to ndarray of shape (3,), millimetres
        Where each pinned vertex shall stay.
    beta, gamma : float
        Weights of eq. 9.
    symmetric : bool
        Whether the other side of the face does the same.
    time : float, seconds
        Where on the timeline the pose stands.
    """

    coefficients: Mapping[str, NDArray[np.float64]]
    keyframes: Mapping[str, PoseKeyframes]
    pins: Mapping[int, NDArray[np.float64]] = field(default_factory=dict)
    beta: float = 0.5
    gamma: float = 0.025
    symmetric: bool = False
    time: float = 0.0

    def __post_init__(self) -> None:
        for name in ("beta", "gamma"):
            value = getattr(self, name)
            if not (np.isfinite(value) and value >= 0):
                raise ValueRangeError(f"{name} must be finite and not negative, got {value}.")
        if not (np.isfinite(self.time) and self.time >= 0):
            raise ValueRangeError(f"time must be 0 s or later, got {self.time}.")


class PoseHistory:
    """States that can be taken back and done again, the oldest forgotten beyond `limit`.

    Parameters
    ----------
    first : PoseState
    limit : int
        How many steps can be taken back.
    """

    def __init__(self, first: PoseState, limit: int = 200) -> None:
        self._states = [("", first)]
        self._at = 0
        self._limit = limit

    def push(self, label: str, state: PoseState, *, merge: bool = False) -> None:
        """Add a step; with `merge` it takes the place of the step before where that has the same label."""
        del self._states[self._at + 1 :]
        if merge and self._at and self._states[-1][0] == label:
            self._states[-1] = (label, state)
            return
        self._states.append((label, state))
        if len(self._states) > self._limit + 1:
            del self._states[0]
        self._at = len(self._states) - 1

    @property
    def present(self) -> PoseState:
        """The state after the last step."""
        return self._states[self._at][1]

    @property
    def undo_label(self) -> str | None:
        """What would be taken back; None if nothing."""
        return self._states[self._at][0] if self._at else None

    @property
    def redo_label(self) -> str | None:
        """What would be done again; None if nothing."""
        return self._states[self._at + 1][0] if self._at + 1 < len(self._states) else None

    def back(self) -> PoseState:
        """Return the state before the last step.

        Raises
        ------
        ValueRangeError
            If there is none.
        """
        if not self._at:
            raise ValueRangeError("there is nothing to undo.")
        self._at -= 1
        return self._states[self._at][1]

    def forth(self) -> PoseState:
        """Return the state after the step that was taken back last.

        Raises
        ------
        ValueRangeError
            If there is none.
        """
        if self._at + 1 >= len(self._states):
            raise ValueRangeError("there is nothing to redo.")
        self._at += 1
        return self._states[self._at][1]
