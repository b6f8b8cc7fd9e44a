"""Meshes of every frame from a performer's markers: one linear map for all frames, mended labels and gaps."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from facewright.errors import ValueRangeError
from facewright.fitting.marker_placement import MarkerPlacement
from facewright.fitting.marker_template import MarkerTemplate, at_places
from facewright.models.marker_gaps import fill_gaps
from facewright.models.marker_swaps import mend_labels
from facewright.models.procrustes import RigidMotions, rigid_motions
from facewright.numeric.check import check_shape
from facewright.numeric.robust import tukey_weights

Array = NDArray[np.float64]


@dataclass(frozen=True)
class MotionPrior:
    """How faces are thought to move, standard deviations.

    Parameters
    ----------
    shape : float
        Of each generic blendshape's weight.
    field_mm : float
        Of what the blendshapes do not explain, a smooth field on the surface.
    noise_mm : float
        Of a marker, each coordinate.
    turn, shift_mm : float
        Of what is left of the head's motion, radians and mm.
    """

    shape: float = 0.35
    field_mm: float = 1.5
    noise_mm: float = 0.3
    turn: float = 0.02
    shift_mm: float = 1.5


@dataclass(frozen=True, eq=False)
class MarkerMotion:
    """A clip's meshes and what was mended.

    Parameters
    ----------
    vertices : ndarray of shape (T, N, 3), float64, millimetres
        The coarse mesh in the head's frame.
    recorded_from_head : RigidMotions
        Head motion.
    markers : ndarray of shape (T, M, 3), float64, millimetres
        The markers as mended and filled, in the head's frame.
    residual_mm : float
        RMS distance of the markers' feet from their places on the meshes.
    n_swapped, n_left_out, n_filled, n_beyond : int
        Values mended; see `mend_labels` and `fill_gaps`.
    longest_gap_s : float
    partner : ndarray of shape (T, M), int
        Whose label each marker bore, compared with the frame at rest; -1 where it was not seen or left out.
    n_stray : ndarray of shape (T,), int
        Markers still out of place, see `mend_labels`: where there are any, the frame's mesh is not to be believed.
    stray_mm : float
        How far, by the median.
    """

    vertices: Array
    recorded_from_head: RigidMotions
    markers: Array
    residual_mm: float
    n_swapped: int
    n_left_out: int
    n_filled: int
    n_beyond: int
    longest_gap_s: float
    partner: NDArray[np.intp]
    n_stray: NDArray[np.intp]
    stray_mm: float


class MarkerRegistration:
    r"""Registers all clips of a performer; everything that does not depend on the frame is computed once.

    Displacements d of the surface are Gaussian: :math:`d = \sum_b e_b \delta_b + u + r`, the template's blendshapes
    at weights e ~ N(0, shape^2), a smooth field u on the surface (`MarkerTemplate`), and a small rigid motion r.
    Markers see them at their places, with noise. The likeliest displacement of any vertex is then linear in those of
    the markers, ``d = C_vm (C_mm + noise^2 I)^-1 y``: one matrix for all frames. Where no marker is near, lips and
    lids follow the shapes that explain the others.

    Parameters
    ----------
    template : MarkerTemplate
        Generic face.
    placement : MarkerPlacement
        The performer.
    standoff_mm : float
        Height of the markers' centres above the skin.
    prior : MotionPrior, optional
        Standard deviations.
    """

    def __init__(
        self,
        template: MarkerTemplate,
        placement: MarkerPlacement,
        *,
        standoff_mm: float = 1.5,
        prior: MotionPrior | None = None,
    ) -> None:
        self.template, self.placement, self.standoff_mm = template, placement, standoff_mm
        self.prior = prior = prior or MotionPrior()
        corners, weights = placement.corners, placement.weights
        M = len(corners)
        deltas = placement.scale * template.deltas
        modes = np.concatenate([prior.shape * deltas, self._rigid_modes(placement.neutral)])
        field = prior.field_mm**2 * template.field_covariance(corners, weights)
        self._modes_at_markers = at_places(modes, corners, weights).reshape(len(modes), -1)
        among = _with_modes(field, corners, weights, self._modes_at_markers)
        self.precision: Array = np.linalg.inv(among + prior.noise_mm**2 * np.eye(3 * M))
        # how much the shapes move a marker: those that hardly move tell the head's motion
        motion = (at_places(prior.shape * deltas, corners, weights) ** 2).sum(axis=(0, 2))
        self._stability = 1.0 / (motion + prior.noise_mm**2 + 0.5**2)
        self._field, self._modes = field, modes
        self._to_coarse = self._gain(template.coarse_places)
        self._to_corners = self._gain(corners.ravel())
        coarse = ((prior.shape * deltas[:, template.coarse_places]) ** 2).sum(axis=(0, 2))
        self.coarse_stability: Array = 1.0 / (coarse + 0.5**2)
        self.neutral: Array = placement.neutral[template.coarse_places]

    def _rigid_modes(self, neutral: Array) -> Array:
        arms = neutral - neutral.mean(axis=0)
        turns = np.stack([np.cross(np.eye(3)[k], arms) for k in range(3)]) * self.prior.turn
        shifts = np.stack([np.broadcast_to(np.eye(3)[k], arms.shape) for k in range(3)]) * self.prior.shift_mm
        return np.concatenate([turns, shifts])

    def _gain(self, vertices: NDArray[np.integer]) -> Array:
        """Return the matrix (3K, 3M) from offsets of the markers to displacements of K vertices."""
        K, M = len(vertices), len(self.placement.corners)
        cross = self._modes[:, vertices].reshape(len(self._modes), -1).T @ self._modes_at_markers
        blocks = cross.reshape(K, 3, M, 3)
        for k in range(3):
            blocks[:, k, :, k] += self._field[vertices]
        return np.asarray(cross @ self.precision)

    def surface(self, markers: NDArray[np.floating]) -> Array:
        """Return the whole surface (T, S, 3) for mended markers (T, M, 3) in the head's frame; for pictures."""
        gain = self._gain(np.arange(len(self.template.ids)))
        offsets = self._foot_offsets(markers - self.placement.rest)
        return np.asarray(self.placement.neutral + (offsets @ gain.T).reshape(len(markers), -1, 3))

    def register(
        self, positions: NDArray[np.floating], times: NDArray[np.floating], *, gap_limit_s: float = 0.5
    ) -> MarkerMotion:
        """Register a clip.

        Parameters
        ----------
        positions : ndarray of shape (T, M, 3), millimetres
            As recorded; NaN where unseen.
        times : ndarray of shape (T,), seconds
        gap_limit_s : float
            Longest gap that is interpolated; see `fill_gaps`.

        Raises
        ------
        ShapeError, ValueRangeError
            If shapes do not match, or a frame has too few markers.
        """
        T, M = check_shape("positions", positions, "T", len(self.placement.rest), 3)["T"], len(self.placement.rest)
        seen = ~np.isnan(positions).any(axis=2)
        if T == 0 or (2 * seen.sum(axis=1) < M).any():
            least = int(seen.sum(axis=1).min(initial=0))
            raise ValueRangeError(
                f"at least half of the {M} markers must be seen in each frame, got {least}; cut such frames out."
            )
        rest = self.placement.rest
        motion = self._head_motion(positions, seen)
        offsets = motion.apply(positions) - rest
        mended = mend_labels(offsets, rest, self.precision)
        recorded = np.where(np.isnan(mended.offsets), 0.0, motion.inverse().apply(mended.offsets + rest))
        motion = self._head_motion(recorded, ~np.isnan(mended.offsets).any(axis=2))
        offsets = np.where(np.isnan(mended.offsets), np.nan, motion.apply(recorded) - rest)
        gaps = fill_gaps(offsets, times, self.precision, gap_limit_s)
        feet = self._foot_offsets(gaps.offsets)
        moved = (feet @ self._to_coarse.T).reshape(T, -1, 3) + self.neutral
        at_feet = self._corner_displacements(feet)
        on_mesh = np.einsum("mk,tmkc->tmc", self.placement.weights, at_feet)
        residual = np.sqrt(((on_mesh - feet.reshape(T, M, 3)) ** 2).sum(axis=2).mean())
        # the head's motion is what the parts of the face that hardly act do
        left = rigid_motions(moved, self.neutral, self.coarse_stability)
        return MarkerMotion(
            left.apply(moved),
            left.compose(motion).inverse(),
            left.apply(gaps.offsets + rest),
            float(residual),
            mended.n_swapped,
            mended.n_left_out,
            gaps.n_filled,
            gaps.n_beyond,
            gaps.longest_s,
            np.where(np.isnan(mended.offsets).any(axis=2), -1, mended.partner),
            mended.n_stray,
            mended.stray_mm,
        )

    def _head_motion(self, positions: NDArray[np.floating], seen: NDArray[np.bool_]) -> RigidMotions:
        """Return the motion into the head's frame, robust against markers out of place."""
        weights = self._stability * seen
        for _ in range(4):
            motion = rigid_motions(positions, self.placement.rest, weights)
            off = np.linalg.norm(np.where(seen[..., None], motion.apply(positions) - self.placement.rest, 0.0), axis=2)
            scaled = off * np.sqrt(self._stability)
            weights = self._stability * seen * (tukey_weights(scaled, 8.0) + 1e-6)
        return motion

    def _corner_displacements(self, feet: Array) -> Array:
        """Return the displacements of the corners of the markers' triangles, (T, M, 3, 3)."""
        return np.asarray((feet @ self._to_corners.T).reshape(len(feet), -1, 3, 3))

    def _foot_offsets(self, offsets: Array) -> Array:
        """Return (T, 3M) how far the markers' feet moved: less than the centres say, where the skin turned."""
        flat = offsets.reshape(len(offsets), -1)
        at_rest = self.placement.neutral[self.placement.corners]
        before = _normals(at_rest)
        after = _normals(at_rest + self._corner_displacements(flat))
        return np.asarray((offsets - self.standoff_mm * (after - before)).reshape(len(offsets), -1))


def _normals(triangles: Array) -> Array:
    """Return unit normals of triangles (..., 3, 3)."""
    n = np.cross(triangles[..., 1, :] - triangles[..., 0, :], triangles[..., 2, :] - triangles[..., 0, :])
    return np.asarray(n / np.maximum(np.linalg.norm(n, axis=-1, keepdims=True), 1e-12))


def _with_modes(field: Array, corners: NDArray[np.integer], weights: Array, modes: Array) -> Array:
    """Return the covariance (3M, 3M) of the markers: that of the modes, and the field's for each coordinate."""
    M = len(corners)
    among = np.einsum("mk,mkn->mn", weights, field[corners])
    covariance = modes.T @ modes
    blocks = covariance.reshape(M, 3, M, 3)
    for k in range(3):
        blocks[:, k, :, k] += 0.5 * (among + among.T)
    return np.asarray(covariance)
