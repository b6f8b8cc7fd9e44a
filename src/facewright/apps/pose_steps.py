"""The steps and the time of a session: keyframes, undo, redo, saving."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from facewright.apps.pose_solver import Gesture, PoseSolver
from facewright.apps.pose_state import PoseHistory, PoseState
from facewright.errors import ValueRangeError
from facewright.models.pose_keyframes import PoseKeyframes
from facewright.models.region_model import RegionModel
from facewright.numeric.check import check_indices, check_shape


class PoseSteps:
    """A pose in time, each change of it a step; `PoseSession` adds the hand that pulls.

    Parameters
    ----------
    solver : PoseSolver
    beta, gamma : float
        Weights of eq. 9.
    autosave : Path, optional
        Where every step is saved.
    """

    def __init__(self, solver: PoseSolver, beta: float, gamma: float, autosave: Path | None) -> None:
        self._solver = solver
        self.models = solver.models
        self.autosave = autosave
        self.state = PoseState(
            solver.at_rest(),
            {kind: PoseKeyframes.none(one.n_coefficients) for kind, one in self.models.items()},
            beta=beta,
            gamma=gamma,
        )
        self._history = PoseHistory(self.state)
        self._gesture: Gesture | None = None  # what was solved last
        self._sought = False  # whether `seek` has changed the pose since the last step
        self._place()

    # What there is

    @property
    def model(self) -> RegionModel:
        """The region-based model."""
        return self.models["region"]

    @property
    def kinds(self) -> tuple[str, ...]:
        """Kinds of models that are posed: "region" and perhaps "holistic"."""
        return tuple(self.models)

    @property
    def dragging(self) -> bool:
        """Whether a vertex is held."""
        return False

    def release(self) -> tuple[str, ...]:
        """Let go of what is held."""
        return ()

    def cancel(self) -> None:
        """Let go of what is held, where it was grabbed."""

    def coefficients(self, kind: str = "region") -> NDArray[np.float64]:
        """Return zeta (P,) of a model."""
        return self.state.coefficients[self._checked(kind)]

    def positions(self, kind: str = "region") -> NDArray[np.float32]:
        """Return the posed vertices (N, 3), mm, in a buffer that the next change overwrites."""
        return self._solver.positions[self._checked(kind)]

    # Time

    def set_key(self, time: float | None = None) -> None:
        """Keep the present pose as a keyframe, here or at another time, seconds.

        Raises
        ------
        ValueRangeError
            If the time is negative or not finite.
        """
        self.release()
        at = self.state.time if time is None else float(time)
        keys = {kind: keys.with_key(at, self.coefficients(kind)) for kind, keys in self.state.keyframes.items()}
        self._commit("set key", keyframes=keys, time=at, keep=True)

    def delete_key(self, index: int) -> None:
        """Remove keyframe number `index`.

        Raises
        ------
        ValueRangeError
            If there is no such keyframe.
        """
        self.release()
        self._commit("delete key", keyframes={k: keys.without(index) for k, keys in self.state.keyframes.items()})

    def move_key(self, index: int, time: float) -> None:
        """Bring keyframe number `index` to another time, seconds.

        Raises
        ------
        ValueRangeError
            If there is no such keyframe, or the time is negative or not finite.
        """
        self.release()
        self._commit("move key", keyframes={k: keys.moved(index, time) for k, keys in self.state.keyframes.items()})

    @property
    def keyframes(self) -> PoseKeyframes:
        """Keyframes of the region-based model."""
        return self.state.keyframes["region"]

    def seek(self, time: float) -> NDArray[np.float32]:
        """Go to a time, seconds; with keyframes the pose becomes what it is there. Returns the positions (N, 3).

        No step of its own; but where it left a pose that is no keyframe, `undo` first returns to that pose.

        Raises
        ------
        ValueRangeError
            If the time is negative or not finite.
        """
        self.release()
        state = replace(self.state, time=float(time))
        if len(self.keyframes):
            poses = {kind: keys.at([state.time])[0] for kind, keys in state.keyframes.items()}
            state = replace(state, coefficients=poses)
        self.state, self._gesture, self._sought = state, None, True
        self._place()
        return self.positions()

    def sample(self, times: ArrayLike, kind: str = "region") -> NDArray[np.float64]:
        """Return the coefficients (T, P) of a model at `times` (T,), seconds; the present pose without keyframes."""
        keys = self.state.keyframes[self._checked(kind)]
        if len(keys):
            return keys.at(times)
        return np.repeat(self.coefficients(kind)[None], len(np.asarray(times)), axis=0)

    # Steps

    @property
    def undo_label(self) -> str | None:
        """What `undo` would take back; None if nothing."""
        return self._history.undo_label

    @property
    def redo_label(self) -> str | None:
        """What `redo` would do again; None if nothing."""
        return self._history.redo_label

    def undo(self) -> None:
        """Take the last step back; a vertex that is held is let go where it was grabbed.

        Raises
        ------
        ValueRangeError
            If there is nothing to take back.
        """
        if self.dragging:
            self.cancel()
            return
        self._restore(self._history.present if self._left_a_pose() else self._history.back())

    def redo(self) -> None:
        """Do the step again that was taken back last.

        Raises
        ------
        ValueRangeError
            If there is none.
        """
        self.cancel()
        self._restore(self._history.forth())

    def _restore(self, state: PoseState) -> None:
        self._solver.set_weights(state.beta, state.gamma)
        self.state, self._gesture, self._sought = state, None, False
        self._place()
        self._save()

    def _left_a_pose(self) -> bool:
        """Tell whether `seek` left a pose that no keyframe holds."""
        last = self._history.present
        poses = last.keyframes["region"].coefficients
        return self._sought and len(poses) > 0 and not (poses == last.coefficients["region"]).all(axis=1).any()

    def take_up(self, state: PoseState) -> None:
        """Go on from another state, such as a file's; the steps before are forgotten.

        Raises
        ------
        ShapeError, ValueRangeError
            If the state is of other models.
        """
        if set(state.coefficients) != set(self.models):
            raise ValueRangeError(
                f"state must pose {', '.join(self.models)}, got one that poses {', '.join(state.coefficients)}."
            )
        for kind, one in self.models.items():
            check_shape(f"{kind} coefficients", state.coefficients[kind], one.n_coefficients)
            check_shape(f"{kind} keyframes", state.keyframes[kind].coefficients, "K", one.n_coefficients)
        check_indices("vertex of a pin", np.array(list(state.pins), dtype=np.int64), self.model.n_vertices)
        self.cancel()
        self._solver.set_weights(state.beta, state.gamma)
        self.state, self._gesture, self._sought = state, None, False
        self._history = PoseHistory(state)
        self._place()

    def _commit(self, label: str, *, keep: bool = False, merge: bool = False, **changes: Any) -> None:
        """Make the present state, with changes, one step; `keep` what was solved last for changed weights."""
        self.state = replace(self.state, **changes)
        if not keep:
            self._gesture = None
            self._place()
        self._sought = False
        self._history.push(label, self.state, merge=merge)
        self._save()

    def _save(self) -> None:
        if self.autosave is not None:
            self.save(self.autosave)

    def save(self, path: Path) -> None:
        """Write the session to a .fwpose file.

        Raises
        ------
        StoreError
            If the file cannot be written.
        """
        from facewright.apps.pose_file import write_pose

        write_pose(path, self.state, self.models)

    def _place(self) -> None:
        self._solver.place(self.state.coefficients)

    def _checked(self, kind: str) -> str:
        if kind not in self.models:
            raise ValueRangeError(f"kind must be one of {', '.join(self.models)}, got {kind!r}.")
        return kind
