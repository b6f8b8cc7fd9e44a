"""Posing a face by hand: drag vertices, pin them, set keyframes, take steps back (Tena et al. 2011, 3.2 and 6)."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike, NDArray

from facewright.apps.pose_conflicts import pin_conflicts
from facewright.apps.pose_solver import Gesture, PoseSolver
from facewright.apps.pose_steps import PoseSteps
from facewright.errors import ValueRangeError
from facewright.models.region_model import RegionModel
from facewright.models.region_symmetry import nearest_mirror
from facewright.numeric.check import check_finite, check_indices, check_shape

#: The paper's weights of boundary and deformation (section 6).
BETA, GAMMA = 0.5, 0.025
_MIRROR = np.array([-1.0, 1.0, 1.0])


class PoseSession(PoseSteps):
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
    out : ndarray of shape (N, 3), float32, C order, optional
        The caller's buffer, such as mapped graphics memory: every change writes the posed vertices straight into it.

    Raises
    ------
    ShapeError
        If `out` is of another shape.
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
        out: NDArray[np.float32] | None = None,
    ) -> None:
        super().__init__(PoseSolver(model, holistic, beta, gamma, out), beta, gamma, autosave)
        self.mirror = nearest_mirror(model.neutral, model.faces)
        self._grabbed: NDArray[np.int64] | None = None  # vertices that follow the hand, the grabbed one first
        self._grabbed_at: NDArray[np.float64] = np.zeros((0, 3))

    # What there is

    @property
    def dragging(self) -> bool:
        """Whether a vertex is held."""
        return self._grabbed is not None

    def boundary_gap(self) -> tuple[float, float]:
        """Return mean and largest distance between the regions' own boundaries before blending, mm."""
        gaps = self._solver.posers["region"].blend.gaps(self.coefficients())
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
        self._gesture = Gesture(vertices, np.zeros((len(vertices), 3)), self.state.coefficients)
        self._solver.constrain(vertices)

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
        return pin_conflicts(self._solver.posers["region"], self.state.pins, self.coefficients())

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
        self._solver.set_weights(state.beta, state.gamma)
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

    # The whole pose

    def reset(self) -> None:
        """Return to the neutral face; pins go, keyframes stay."""
        self.release()
        self._commit("reset", coefficients=self._solver.at_rest(), pins={})

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
        return self._solver.as_holistic(zeta)

    # Solving

    def _solve_pins(self) -> None:
        vertices = np.array(list(self.state.pins), dtype=np.int64)
        self._solver.constrain(vertices)
        self._solve(Gesture(vertices, np.array(list(self.state.pins.values())), self.state.coefficients))

    def _solve(self, gesture: Gesture) -> None:
        self.state = replace(self.state, coefficients=self._solver.solve(gesture))
        self._gesture = gesture

    def _checked_vertex(self, vertex: int) -> int:
        check_indices("vertex", np.array([vertex]), self.model.n_vertices)
        return int(vertex)


def _checked_point(target: ArrayLike) -> NDArray[np.float64]:
    goal = np.asarray(target, dtype=np.float64)
    check_shape("target", goal, 3)
    check_finite("target", goal)
    return goal
