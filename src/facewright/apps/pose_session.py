"""Posing a face by hand: drag vertices, pin them, set keyframes, take steps back (Tena et al. 2011, 3.2 and 6)."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from facewright.apps.pose_conflicts import pin_conflicts
from facewright.apps.pose_state import PoseHistory, PoseState
from facewright.errors import TopologyError, ValueRangeError
from facewright.models.pose_keyframes import PoseKeyframes
from facewright.models.region_fit import RegionFitter
from facewright.models.region_model import RegionModel
from facewright.models.region_poser import RegionPoser
from facewright.models.region_symmetry import nearest_mirror
from facewright.numeric.check import check_finite, check_indices, check_shape

#: The paper's weights of boundary and deformation (section 6).
BETA, GAMMA = 0.5, 0.025
_MIRROR = np.array([-1.0, 1.0, 1.0])


@dataclass(frozen=True, eq=False)
class _Gesture:
    """Constraints as they were solved last, and from where: changed weights solve them again."""

    vertices: NDArray[np.int64]
    targets: NDArray[np.float64]
    rest: Mapping[str, NDArray[np.float64]]


class PoseSession:
    """One person's work on one model: a pose, pins, keyframes and the steps that led there.

    Parameters
    ----------
    model : RegionModel
        The model that is posed.
    holistic : RegionModel, optional
        A model of one region on the same mesh; it gets the same constraints, for comparison (the paper's Fig. 7).
    beta, gamma : float
        Weights of eq. 9; see `RegionPoser`.
    autosave : Path, optional
        Where every step is saved (.fwpose); `facewright.apps.pose_file.open_pose` takes it up again.

    Raises
    ------
    TopologyError
        If the holistic model is of another mesh.
    ValueRangeError
        If beta or gamma is negative, or the holistic model has several regions.
    """

    def __init__(
        self,
        model: RegionModel,
        *,
        holistic: RegionModel | None = None,
        beta: float = BETA,
        gamma: float = GAMMA,
        autosave: Path | None = None,
    ) -> None:
        models = {"region": model}
        if holistic is not None:
            if not np.array_equal(holistic.faces, model.faces) or holistic.n_vertices != model.n_vertices:
                raise TopologyError("holistic model must be of the region-based model's mesh, got another mesh.")
            if len(holistic.bases) != 1:
                raise ValueRangeError(f"holistic model must have one region, got {len(holistic.bases)}.")
            models["holistic"] = holistic
        self.models = models
        self.autosave = autosave
        self.state = PoseState(
            {kind: _at_rest(one) for kind, one in models.items()},
            {kind: PoseKeyframes.none(one.n_coefficients) for kind, one in models.items()},
            beta=beta,
            gamma=gamma,
        )
        self._posers = {kind: RegionPoser(one, beta, gamma) for kind, one in models.items()}
        self._positions = {kind: np.zeros((model.n_vertices, 3), np.float32) for kind in models}
        self.mirror = nearest_mirror(model.neutral)
        self._history = PoseHistory(self.state)
        self._gesture: _Gesture | None = None
        self._grabbed: NDArray[np.int64] | None = None  # vertices that follow the hand, the grabbed one first
        self._grabbed_at: NDArray[np.float64] = np.zeros((0, 3))
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
        return self._grabbed is not None

    def coefficients(self, kind: str = "region") -> NDArray[np.float64]:
        """Return zeta (P,) of a model."""
        return self.state.coefficients[self._checked(kind)]

    def positions(self, kind: str = "region") -> NDArray[np.float32]:
        """Return the posed vertices (N, 3), mm, in a buffer that the next change overwrites."""
        return self._positions[self._checked(kind)]

    def boundary_gap(self) -> tuple[float, float]:
        """Return mean and largest distance between the regions' own boundaries before blending, mm."""
        gaps = self._posers["region"].blend.gaps(self.coefficients())
        return gaps.mean_mm, gaps.max_mm

    # Dragging

    def drag(self, vertex: int, target: ArrayLike) -> NDArray[np.float32]:
        """Move a vertex towards `target` (3,), mm; what it takes with it follows eq. 9. Returns the positions (N, 3).

        The first call grabs the vertex, further ones move it; another vertex releases the one before. Pins hold as
        further constraints. In symmetric mode the mirrored vertex moves likewise, and one on the midline stays there.

        Raises
        ------
        ShapeError, ValueRangeError
            If there is no such vertex or the target is not three finite numbers.
        """
        vertex, goal = self._checked_vertex(vertex), _checked_point(target)
        if self._grabbed is None or self._grabbed[0] != vertex:
            self.release()
            self._grab(vertex)
        assert self._grabbed is not None
        move = goal - self._grabbed_at[0]
        moves = np.stack([move, move * _MIRROR])[: len(self._grabbed)]
        if self.state.symmetric and len(self._grabbed) == 1:
            moves[0, 0] = 0.0  # on the midline
        pins = {v: p for v, p in self.state.pins.items() if v not in self._grabbed}
        assert self._gesture is not None
        gesture = replace(
            self._gesture, targets=np.concatenate([self._grabbed_at + moves, *(p[None] for p in pins.values())])
        )
        self._solve(gesture)
        return self.positions()

    def release(self) -> tuple[str, ...]:
        """Let go of the held vertex, which makes it one step; returns `conflicts`."""
        if self._grabbed is None:
            return ()
        pins = dict(self.state.pins)
        assert self._gesture is not None
        for vertex, target in zip(self._grabbed, self._gesture.targets, strict=False):
            if int(vertex) in pins:  # a pin that was dragged stays where it was brought
                pins[int(vertex)] = target
        self._grabbed = None
        self._commit("drag", pins=pins, keep=True)
        return self.conflicts()

    def cancel(self) -> None:
        """Let go of the held vertex and return to where it was grabbed."""
        if self._grabbed is None:
            return
        assert self._gesture is not None
        self._grabbed = None
        self.state = replace(self.state, coefficients=self._gesture.rest)
        self._gesture = None
        self._place()

    def _grab(self, vertex: int) -> None:
        other = int(self.mirror[vertex]) if self.state.symmetric else vertex
        self._grabbed = np.unique([vertex, other])
        if self._grabbed[0] != vertex:
            self._grabbed = self._grabbed[::-1].copy()
        self._grabbed_at = self.positions()[self._grabbed].astype(np.float64)
        pinned = [v for v in self.state.pins if v not in self._grabbed]
        vertices = np.concatenate([self._grabbed, np.array(pinned, dtype=np.int64)])
        self._gesture = _Gesture(vertices, np.zeros((len(vertices), 3)), self.state.coefficients)
        for poser in self._posers.values():
            poser.set_constraints(vertices)

    # Pins

    def pin(self, vertex: int, target: ArrayLike | None = None) -> tuple[str, ...]:
        """Hold a vertex where it is, or at `target` (3,), mm, while others are dragged; returns `conflicts`.

        In symmetric mode the mirrored vertex is pinned likewise.

        Raises
        ------
        ShapeError, ValueRangeError
            If there is no such vertex or the target is not three finite numbers.
        """
        vertex = self._checked_vertex(vertex)
        goal = self.positions()[vertex].astype(np.float64) if target is None else _checked_point(target)
        self.release()
        pins = dict(self.state.pins)
        other = int(self.mirror[vertex])
        if self.state.symmetric and other != vertex:
            at = self.positions()[other].astype(np.float64)
            pins[other] = at if target is None else goal * _MIRROR
        pins[vertex] = goal
        self.state = replace(self.state, pins=pins)
        if target is not None:
            self._solve_pins()
        self._commit("pin", pins=pins, keep=target is not None)
        return self.conflicts()

    def unpin(self, vertex: int) -> None:
        """Let a pinned vertex go; in symmetric mode the mirrored one too.

        Raises
        ------
        ValueRangeError
            If the vertex is not pinned.
        """
        vertex = self._checked_vertex(vertex)
        if vertex not in self.state.pins:
            raise ValueRangeError(f"vertex must be pinned to be unpinned, got {vertex}, which is not.")
        gone = {vertex, int(self.mirror[vertex])} if self.state.symmetric else {vertex}
        self.release()
        self._commit("unpin", pins={v: p for v, p in self.state.pins.items() if v not in gone})

    def unpin_all(self) -> None:
        """Let all pins go."""
        self.release()
        if self.state.pins:
            self._commit("unpin all", pins={})

    def conflicts(self) -> tuple[str, ...]:
        """Say in one sentence which pins the face cannot meet, alone or together; empty where all are met."""
        return pin_conflicts(self._posers["region"], self.state.pins, self.coefficients())

    # Weights and modes

    def set_weights(self, beta: float | None = None, gamma: float | None = None) -> None:
        """Change beta or gamma; the constraints that were solved last are solved again with them.

        Raises
        ------
        ValueRangeError
            If a value is negative or not finite.
        """
        state = replace(
            self.state,
            beta=self.state.beta if beta is None else float(beta),
            gamma=self.state.gamma if gamma is None else float(gamma),
        )
        self._set_weights(state.beta, state.gamma)
        self.state = state
        if self._gesture is not None:
            self._solve(self._gesture)
        if self._grabbed is None:
            self._commit("weights", keep=True, merge=True)

    def set_symmetric(self, symmetric: bool) -> None:
        """Let the other side of the face do the same from now on, or no longer."""
        self.release()
        if symmetric != self.state.symmetric:
            self._commit("symmetry", symmetric=bool(symmetric))

    def _set_weights(self, beta: float, gamma: float) -> None:
        for poser in self._posers.values():
            if (poser.beta, poser.gamma) != (beta, gamma):
                poser.set_weights(beta, gamma)

    # The whole pose

    def reset(self) -> None:
        """Return to the neutral face; pins go, keyframes stay."""
        self.release()
        self._commit("reset", coefficients={kind: _at_rest(one) for kind, one in self.models.items()}, pins={})

    def set_pose(self, coefficients: ArrayLike) -> None:
        """Take a pose (P,) of the region-based model; a holistic one comes as near to it as it can.

        Raises
        ------
        ShapeError, ValueRangeError
            If it is not P finite numbers.
        """
        zeta = np.array(coefficients, dtype=np.float64)
        check_shape("coefficients", zeta, self.model.n_coefficients)
        check_finite("coefficients", zeta)
        self.release()
        poses = {"region": zeta}
        if "holistic" in self.models:
            poses["holistic"] = self.as_holistic(zeta)
        self._commit("pose", coefficients=poses)

    def as_holistic(self, zeta: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return the holistic model's coefficients that come nearest to a pose (P,) of the region-based one."""
        moved = self._posers["region"].positions(zeta) - self.model.neutral
        return np.asarray(RegionFitter(self.models["holistic"], 0.0).fit(moved[None])[0])

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
        self._set_weights(state.beta, state.gamma)
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
        for vertex in state.pins:
            self._checked_vertex(vertex)
        self._set_weights(state.beta, state.gamma)
        self.state, self._gesture, self._grabbed, self._sought = state, None, None, False
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

    # Solving

    def _solve_pins(self) -> None:
        vertices = np.array(list(self.state.pins), dtype=np.int64)
        for poser in self._posers.values():
            poser.set_constraints(vertices)
        self._solve(_Gesture(vertices, np.array(list(self.state.pins.values())), self.state.coefficients))

    def _solve(self, gesture: _Gesture) -> None:
        poses = {
            kind: poser.solve(gesture.targets, gesture.rest[kind], self._positions[kind])
            for kind, poser in self._posers.items()
        }
        self.state = replace(self.state, coefficients=poses)
        self._gesture = gesture

    def _place(self) -> None:
        for kind, poser in self._posers.items():
            poser.positions(self.state.coefficients[kind], self._positions[kind])

    def _checked(self, kind: str) -> str:
        if kind not in self.models:
            raise ValueRangeError(f"kind must be one of {', '.join(self.models)}, got {kind!r}.")
        return kind

    def _checked_vertex(self, vertex: int) -> int:
        check_indices("vertex", np.array([vertex]), self.model.n_vertices)
        return int(vertex)


def _at_rest(model: RegionModel) -> NDArray[np.float64]:
    """Return the coefficients (P,) of the face nearest to the neutral."""
    lower = np.concatenate([np.zeros(0), *model.lower])
    upper = np.concatenate([np.zeros(0), *model.upper])
    mean = any(np.abs(one).max(initial=0.0) > 0 for one in model.means)
    zeta = RegionFitter(model, BETA).fit(np.zeros((1, model.n_vertices, 3)))[0] if mean else np.zeros(len(lower))
    return np.clip(zeta, lower, upper)


def _checked_point(target: ArrayLike) -> NDArray[np.float64]:
    goal = np.asarray(target, dtype=np.float64)
    check_shape("target", goal, 3)
    check_finite("target", goal)
    return goal
