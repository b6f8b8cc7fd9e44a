"""Posing a region-based model by dragged vertices (Tena et al. 2011, section 3.2, eq. 8-10)."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.linalg import cho_factor, cho_solve, cholesky

from facewright.errors import ShapeError, ValueRangeError
from facewright.models._region_boundary import boundary_form
from facewright.models._region_kernels import settle, update
from facewright.models.region_blend import Blend, RegionBlend
from facewright.models.region_model import RegionModel
from facewright.numeric.box_pivoting import BoxPivoting
from facewright.numeric.check import check_choice, check_indices, check_shape

_FLOOR = 1e-12  # of the system's scale: keeps what neither a constraint nor beta nor gamma holds where it was
_SMALL_GAMMA = 1e-6  # below, an update of the free system would lose digits
#: What beta holds: the boundaries together, as eq. 9 says, or as they were before the drag.
Boundaries = Literal["meet", "keep"]


@dataclass(frozen=True, eq=False)
class _Constraints:
    """The coordinates of constrained copies: origin + rows zeta, and whose target each shall meet."""

    vertices: NDArray[np.intp]
    owner: NDArray[np.int64]
    axis: NDArray[np.int64]
    rows: NDArray[np.float64]
    origin: NDArray[np.float64]
    weights: NDArray[np.float64]


class RegionPoser:
    r"""Minimise eq. 9 for a few constrained vertices, fast enough to follow a mouse.

    .. math:: E(\zeta) = \sum_i \sum_k \|v_k^i - B_k^i c^i\|^2
        + \beta \sum_{i<j} \|B_j^i c^i - B_i^j c^j\|^2 + \gamma \sum_i \|c_0^i - c^i\|^2

    A vertex of several regions is constrained in each of them. With one region this is eq. 8. The part of beta and
    gamma is factored once; constraints are an update of it by as many rows as they have coordinates.

    Parameters
    ----------
    model : RegionModel
        Its `neutral` is the face that is posed.
    beta : float
        Weight of the boundaries against constraints; no unit (mm^2 against mm^2). The paper's: 0.5.
    gamma : float
        Weight of a change of the coefficients against constraints; no unit, because `RegionModel.units` turns
        coefficients into millimetres of the whole region. The paper's: 0.025.
    blend : {"average", "gradient"}
        How boundaries are made one, see `RegionBlend`.
    boundaries : {"meet", "keep"}
        ``"meet"`` is eq. 9: the gaps themselves count, so that every new drag closes a little of those that earlier
        ones left, and moves what nobody touches. ``"keep"``: only what a drag changes counts, of gaps as of copies of a
        constrained vertex (c - c_0 for c); without constraints, or with them met, nothing moves. From a pose without
        gaps both are the same.

    Raises
    ------
    ValueRangeError
        If beta or gamma is negative or not finite.
    """

    def __init__(
        self,
        model: RegionModel,
        beta: float = 0.5,
        gamma: float = 0.025,
        *,
        blend: Blend = "average",
        boundaries: Boundaries = "meet",
    ) -> None:
        check_choice("boundaries", boundaries, ("meet", "keep"))
        self.model, self.boundaries = model, boundaries
        self.beta, self.gamma = float(beta), float(gamma)
        self.blend = RegionBlend(model, blend)
        self._boundary, self._offset = boundary_form(model, self.blend.layout)
        self._units = np.concatenate([np.zeros(0), *model.units])
        self._lower = np.concatenate([np.zeros(0), *model.lower])
        self._upper = np.concatenate([np.zeros(0), *model.upper])
        self.bounded = bool(np.isfinite(self._lower).any() or np.isfinite(self._upper).any())
        P = model.n_coefficients
        self._box = BoxPivoting(np.eye(P), self._lower, self._upper)
        self._rest, self._free = np.full(P, np.nan), np.zeros(P)
        self._constraints = self._make_constraints(np.zeros(0, np.intp), np.zeros(0))
        self._origin = self._constraints.origin
        self.set_weights()
        self.solve(np.zeros((0, 3)), np.zeros(P), np.empty((model.n_vertices, 3), np.float32))  # compiles

    def set_weights(self, beta: float | None = None, gamma: float | None = None) -> None:
        """Change beta or gamma; factors the system again.

        Raises
        ------
        ValueRangeError
            If a value is negative or not finite.
        """
        beta = self.beta if beta is None else float(beta)
        gamma = self.gamma if gamma is None else float(gamma)
        for name, value in (("beta", beta), ("gamma", gamma)):
            if not (np.isfinite(value) and value >= 0.0):
                raise ValueRangeError(f"{name} must be finite and not negative, got {value}.")
        self.beta, self.gamma = beta, gamma
        diagonal = self._units**2
        H = beta * self._boundary
        floor = _FLOOR * max(float(np.diag(H).max(initial=0.0)), float(diagonal.max(initial=1.0)))
        self._pull = gamma * diagonal + floor  # of the coefficients towards where they were
        H[np.diag_indices_from(H)] += self._pull
        self._system = H
        self._factor = np.ascontiguousarray(cholesky(H, lower=True)) if H.size else H
        self._constant = -beta * self._offset
        self._update_gain()

    def set_constraints(self, vertices: ArrayLike, weights: ArrayLike | None = None) -> None:
        """Say which vertices are constrained; their targets are given to `solve`.

        Parameters
        ----------
        vertices : array_like of shape (K,), int
            Vertices, none twice.
        weights : array_like of shape (K,), optional
            Weight of each constraint; 1 by default, as in the paper.

        Raises
        ------
        ShapeError, ValueRangeError
            If a vertex is out of range or given twice, or a weight is not positive.
        """
        ids = np.asarray(vertices, dtype=np.intp if np.size(vertices) == 0 else None)
        K = check_shape("vertices", ids, "K")["K"]
        check_indices("vertices", ids, self.model.n_vertices)
        if len(np.unique(ids)) != K:
            raise ValueRangeError("vertices must not be constrained twice, got one that is.")
        strength = np.ones(K) if weights is None else np.asarray(weights, dtype=np.float64)
        check_shape("weights", strength, K)
        if not (np.isfinite(strength).all() and (strength > 0).all()):
            raise ValueRangeError("weights must be finite and positive.")
        self._constraints = self._make_constraints(ids.astype(np.intp), strength)
        self._update_gain()

    @property
    def constrained(self) -> NDArray[np.intp]:
        """The constrained vertices (K,)."""
        return self._constraints.vertices

    def solve(
        self,
        targets: NDArray[np.floating[Any]],
        rest: NDArray[np.float64],
        out: NDArray[np.floating[Any]] | None = None,
    ) -> NDArray[np.float64]:
        """Return the coefficients zeta (P,) that minimise eq. 9, and write the positions into `out`.

        Parameters
        ----------
        targets : ndarray of shape (K, 3), millimetres
            Where the constrained vertices shall be, in the order of `set_constraints`.
        rest : ndarray of shape (P,)
            c_0: the coefficients before the drag began.
        out : ndarray of shape (N, 3), float32 or float64, C order, optional
            Receives the blended positions, mm.

        Raises
        ------
        ShapeError
            If a shape does not match.
        """
        made = self._constraints
        goal = np.ascontiguousarray(targets, dtype=np.float64)
        start = np.ascontiguousarray(rest, dtype=np.float64)
        if goal.shape != (len(made.vertices), 3):
            raise ShapeError(f"targets must have shape ({len(made.vertices)}, 3), got {goal.shape}.")
        if start.shape != self._free.shape:
            raise ShapeError(f"rest must have shape {self._free.shape}, got {start.shape}.")
        if not np.array_equal(start, self._rest):
            self._begin(start)
        if self.bounded:
            zeta = self._solve_in_box(goal, start)
        else:
            zeta = np.empty_like(start)
            update(made.rows, self._origin, made.owner, made.axis, self._gain, goal, self._free, zeta)
        if out is not None:
            self.blend.positions(zeta, out)
        return zeta

    def positions(self, zeta: NDArray[np.float64], out: NDArray[np.floating[Any]] | None = None) -> NDArray[Any]:
        """Return the blended positions (N, 3), mm, of coefficients, in `out` where given."""
        return self.blend.positions(zeta, out)

    def _begin(self, start: NDArray[np.float64]) -> None:
        """Find where the pose goes without constraints, and where constrained copies count from."""
        made = self._constraints
        self._rest[:] = start
        self._origin = made.origin
        if self.boundaries == "meet":
            if not self.bounded:
                settle(self._factor, self._constant, self._pull, start, self._free)
            return
        self._free[:] = start
        if len(made.rows):
            moved = made.rows @ start
            # a copy counts from the vertex as it is seen, the mean of its copies
            key = 3 * made.owner + made.axis
            seen = np.bincount(key, moved + made.origin) / np.maximum(np.bincount(key), 1)
            self._origin = np.ascontiguousarray(seen[key] - moved)

    def _solve_in_box(self, goal: NDArray[np.float64], start: NDArray[np.float64]) -> NDArray[np.float64]:
        made = self._constraints
        miss = made.weights * (goal[made.owner, made.axis] - self._origin)
        held = self._constant + self._pull * start if self.boundaries == "meet" else self._system @ start
        return self._box.solve(held + made.rows.T @ miss)

    def _make_constraints(self, vertices: NDArray[np.intp], weights: NDArray[np.float64]) -> _Constraints:
        model, layout = self.model, self.blend.layout
        number = np.full(model.n_vertices, -1)
        number[vertices] = np.arange(len(vertices))
        copies = np.flatnonzero(number[layout.vertices] >= 0)
        owner = number[layout.vertices[copies]]
        rows = np.zeros((len(copies), 3, model.n_coefficients))
        region = np.searchsorted(layout.starts, copies, side="right") - 1
        for i in np.unique(region):
            here = region == i
            matrix = layout.matrix(i).reshape(
                len(model.regions.members[i]), 3, layout.offsets[i + 1] - layout.offsets[i]
            )
            rows[here, :, layout.coefficients(i)] = matrix[copies[here] - layout.starts[i]]
        origin = model.neutral[layout.vertices[copies]] + layout.means[copies]
        return _Constraints(
            vertices=vertices,
            owner=np.repeat(owner, 3).astype(np.int64),
            axis=np.tile(np.arange(3), len(copies)).astype(np.int64),
            rows=np.ascontiguousarray(rows.reshape(3 * len(copies), model.n_coefficients)),
            origin=np.ascontiguousarray(origin.ravel(), dtype=np.float64),
            weights=np.repeat(weights[owner], 3),
        )

    def _update_gain(self) -> None:
        """Precompute how zeta answers to a constrained copy's distance from its target, (R, P)."""
        made = self._constraints
        self._rest[:] = np.nan
        R, P = made.rows.shape
        weighted = made.rows * made.weights[:, None]
        if self.bounded:
            self._box.replace(self._system + made.rows.T @ weighted)
            self._gain = np.zeros((R, P))
        elif R == 0 or P == 0:
            self._gain = np.zeros((R, P))
        elif R < P and self.gamma > _SMALL_GAMMA:
            # Woodbury: (H + A'WA)^-1 A'W = H^-1 A' (W^-1 + A H^-1 A')^-1
            Y = cho_solve((self._factor, True), made.rows.T, check_finite=False)
            inner = made.rows @ Y
            inner[np.diag_indices_from(inner)] += 1.0 / made.weights
            self._gain = np.ascontiguousarray(cho_solve(cho_factor(inner), Y.T, check_finite=False))
        else:
            full = self._system + made.rows.T @ weighted
            self._gain = np.ascontiguousarray(cho_solve(cho_factor(full), weighted.T, check_finite=False).T)
