"""How a simulated performer's skin follows acting: personal blendshapes, and what is not linear in real faces."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from facewright.faces.acting_timing import SHAPE_INDEX, columns_of
from facewright.faces.contact import face_contacts
from facewright.faces.face import Face
from facewright.faces.pieces import face_pieces
from facewright.faces.rigid_motion import RigidMotion
from facewright.faces.simulate import SimulatedPerson
from facewright.mesh.geodesics import path_distances
from facewright.mesh.random_field import smooth_random_field

#: Shapes whose sum is not what two muscles do together.
_PAIRS: tuple[tuple[str, str], ...] = (
    ("jawOpen", "mouthSmile"),
    ("jawOpen", "mouthStretch"),
    ("jawOpen", "mouthFunnel"),
    ("jawOpen", "mouthPucker"),
    ("jawOpen", "mouthUpperUp"),
    ("mouthSmile", "mouthUpperUp"),
    ("mouthSmile", "cheekSquint"),
    ("mouthSmile", "mouthPress"),
    ("mouthSmile", "mouthDimple"),
    ("mouthFrown", "mouthShrugLower"),
    ("mouthFrown", "mouthStretch"),
    ("mouthFunnel", "mouthPucker"),
    ("noseSneer", "mouthUpperUp"),
    ("noseSneer", "cheekSquint"),
    ("browDown", "browInnerUp"),
    ("browDown", "noseSneer"),
    ("browOuterUp", "browInnerUp"),
    ("eyeSquint", "cheekSquint"),
    ("mouthLowerDown", "mouthStretch"),
)
_OVERSHOOT, _TOGETHER = 0.25, 0.35  # what two shapes lose where both move, and how they differ otherwise
_BEND, _BENT_MM = 0.17, 20.0  # RMS of short ways off their straight line, relative to their length; long ones bend less
_TOUCH_MM = 0.25  # lips that would cross by more than about this are kept from it
_SEALED_AT = 0.93  # lips meet where mouthClose takes back this share of jawOpen
_STICKY_MM = 0.5  # lips parted by less stay together
#: Soft tissue as a damped spring: eigenfrequency, damping, and its softest places.
_WOBBLE_HZ, _WOBBLE_DAMPING = 5.5, 0.35
_CORRELATION_MM = 18.0


class ActingSkin:
    """Positions of a performer's vertices from coefficients and head motion.

    Beyond the 46 personal blendshapes: each shape's vertices go on curved ways; the jaw turns about its hinge; shapes
    that act together do not simply add up; lips that meet press on each other and do not cross; cheeks and chin swing
    after the head. All but the lips' contact is linear in features of the coefficients, one matrix product for a clip.

    Parameters
    ----------
    face : Face
        Topology, masks, generic shapes.
    person : SimulatedPerson
        The performer.
    rng : numpy.random.Generator
        Draws what is personal in all this.
    """

    def __init__(self, face: Face, person: SimulatedPerson, rng: np.random.Generator) -> None:
        self.neutral = person.neutral.astype(np.float64)
        self._deltas = person.deltas.astype(np.float64)
        pieces = face_pieces(face)
        self._soft = np.zeros(len(self.neutral))
        self._soft[pieces.surface] = 1.0
        self._pairs = _side_by_side(_PAIRS)
        self._jaw_angle = 0.0
        jaw = [motion for motion, kind in zip(pieces.rigid, face.rigid_parts.values()) if kind == "jaw"]
        softness = self._softness(face, rng)
        self._basis = np.concatenate(
            [
                self._deltas,
                self._bends(rng),
                self._together(rng),
                self._hinge(jaw[0]) if jaw else np.zeros((2, *self.neutral.shape)),
                softness[None, :, None] * np.eye(3)[:, None, :],
            ]
        ).astype(np.float32)
        self._upper = face.topology.masks.get("lip_contact_upper", np.empty(0, np.int32))
        self._lower = face.topology.masks.get("lip_contact_lower", np.empty(0, np.int32))
        self._spread, self._spread_ids = self._lip_spread(face, pieces.surface_faces)
        self._rest_gap = self.neutral[self._upper] - self.neutral[self._lower]

    def positions(
        self,
        weights: NDArray[np.float64],
        swing: NDArray[np.float64] | None = None,
        vertices: NDArray[np.integer[Any]] | slice | None = None,
    ) -> NDArray[np.float32]:
        """Return positions (T, N, 3) of the chosen vertices (all where None), millimetres, head at rest.

        Parameters
        ----------
        weights : ndarray of shape (T, 46)
            Coefficients.
        swing : ndarray of shape (T, 3), millimetres, optional
            How far soft tissue lags behind, see `swing_of`; none where absent.
        vertices : ndarray of shape (N,) or slice, optional
            Which vertices.
        """
        ids = np.arange(len(self.neutral)) if vertices is None else np.arange(len(self.neutral))[vertices]
        features = self._features(np.asarray(weights, dtype=np.float64), swing)
        change = self._lip_change(features, np.asarray(weights, dtype=np.float64))
        basis = self._basis[:, ids].reshape(len(self._basis), -1)
        result = (features.astype(np.float32) @ basis).reshape(len(features), len(ids), 3)
        result += self.neutral[ids].astype(np.float32)
        if change is not None:
            number = np.full(len(self.neutral), -1)
            number[ids] = np.arange(len(ids))
            rows = np.flatnonzero(number[self._spread_ids] >= 0)
            moved = np.einsum("rk,tkc->trc", self._spread[rows], change, optimize=True)
            result[:, number[self._spread_ids[rows]]] += moved.astype(np.float32)
        return result

    def _features(self, w: NDArray[np.float64], swing: NDArray[np.float64] | None) -> NDArray[np.float64]:
        """Return (T, K): what the basis is multiplied with."""
        bend = 4.0 * w * (1.0 - w)
        both = np.stack([w[:, a] * w[:, b] for a, b in self._pairs], axis=1)
        jaw, angle = w[:, SHAPE_INDEX["jawOpen"]], self._jaw_angle
        turn = np.stack(
            [np.sin(jaw * angle) - jaw * np.sin(angle), (1 - np.cos(jaw * angle)) - jaw * (1 - np.cos(angle))], axis=1
        )
        lag = np.zeros((len(w), 3)) if swing is None else swing
        return np.concatenate([w, bend, both, turn, lag], axis=1)

    def _bends(self, rng: np.random.Generator) -> NDArray[np.float64]:
        """Return (46, V, 3): how far half-way positions lie off the straight line of each shape."""
        size = np.linalg.norm(self._deltas, axis=2)
        return _BEND * self._fields(size / (1.0 + size / _BENT_MM), rng)

    def _together(self, rng: np.random.Generator) -> NDArray[np.float64]:
        """Return (P, V, 3): what two shapes at full weight do beyond their sum."""
        first, second = (self._deltas[list(ids)] for ids in zip(*self._pairs))
        sizes = np.linalg.norm(first, axis=2), np.linalg.norm(second, axis=2)
        overlap = 2.0 * sizes[0] * sizes[1] / np.maximum(sizes[0] + sizes[1], 1e-9)
        total = first + second
        along = total / np.maximum(np.linalg.norm(total, axis=2, keepdims=True), 1e-6)
        loss = _OVERSHOOT * rng.uniform(0.5, 1.5, len(total))[:, None] * overlap * self._soft
        return self._fields(_TOGETHER * overlap, rng) - loss[:, :, None] * along

    def _fields(self, sizes: NDArray[np.float64], rng: np.random.Generator) -> NDArray[np.float64]:
        """Return (N, V, 3) smooth random fields of local RMS lengths `sizes` (N, V), on the soft surface."""
        fields = smooth_random_field(self.neutral, _CORRELATION_MM, 1.0, rng, n_fields=len(sizes))
        return fields * (sizes * self._soft)[:, :, None]

    def _hinge(self, jaw: RigidMotion) -> NDArray[np.float64]:
        """Return (2, V, 3): sine and versine parts of a turn about the jaw's hinge, as far as skin follows the jaw."""
        i = SHAPE_INDEX["jawOpen"]
        vector = jaw.rotations[i]
        self._jaw_angle = float(np.linalg.norm(vector))
        if self._jaw_angle < 1e-3:
            return np.zeros((2, *self.neutral.shape))
        axis = vector / self._jaw_angle
        centre = self.neutral[jaw.vertices].mean(axis=0)
        shift = self._deltas[i][jaw.vertices].mean(axis=0)
        shift = shift - axis * (shift @ axis)
        # the point that the turn and the shift of the jaw's centre leave where it is
        hinge = centre + 0.5 * shift + np.cross(axis, shift) / (2.0 * np.tan(0.5 * self._jaw_angle))
        arms = self.neutral - hinge
        rigid = Rotation.from_rotvec(vector).apply(arms) - arms
        moved = (self._deltas[i] * rigid).sum(axis=1) / np.maximum((rigid**2).sum(axis=1), 1e-9)
        follows = np.clip(moved, 0.0, 1.0)[:, None]
        sine = np.cross(axis, arms)
        return np.stack([follows * sine, follows * np.cross(axis, sine)])

    def _softness(self, face: Face, rng: np.random.Generator) -> NDArray[np.float64]:
        """Return (V,) in [0, 1.2]: cheeks, jowls and chin swing, forehead and nose hardly do."""
        masks, n = face.topology.masks, face.n_skin
        result = np.zeros(len(self.neutral))
        faces = face.topology.submesh(n).faces
        for name, size in (("cheeks_left", 1.0), ("cheeks_right", 1.0), ("chin", 0.6)):
            ids = masks.get(name, np.empty(0, np.int32))
            if len(ids):
                heart = ids[np.argmin(np.linalg.norm(self.neutral[ids] - self.neutral[ids].mean(axis=0), axis=1))]
                far = path_distances(self.neutral[:n], faces, np.array([heart]), limit_mm=90.0)[0]
                reach = np.exp(-0.5 * (np.minimum(far, 200.0) / 24.0) ** 2)
                result[:n] = np.maximum(result[:n], size * rng.uniform(0.8, 1.2) * reach)
        return result

    def _lip_spread(self, face: Face, surface_faces: NDArray[np.int32]) -> tuple[NDArray[np.float64], NDArray[np.intp]]:
        """Return how vertices (rows) follow wanted changes of the lips' offsets (columns), and which vertices."""
        lips = face_contacts(self.neutral, face.topology, surface_faces).get("lips")
        if lips is None:
            return np.zeros((0, 0)), np.zeros(0, np.intp)
        K = len(self._upper)
        unit = np.zeros((K, len(self.neutral), 3))
        lips.change(unit, np.eye(K)[:, :, None] * [1.0, 0.0, 0.0])
        spread = unit[:, :, 0].T
        ids = np.flatnonzero(np.abs(spread).max(axis=1) > 1e-4)
        return spread[ids], ids

    def _lip_change(self, features: NDArray[np.float64], w: NDArray[np.float64]) -> NDArray[np.float64] | None:
        """Return wanted changes (T, K, 3) of the offsets of upper and lower lip: sealed lips meet, none cross."""
        if not len(self._upper):
            return None
        opened = self._basis[:, self._upper] - self._basis[:, self._lower]
        offset = np.einsum("tk,kpc->tpc", features, opened, optimize=True)  # beyond the rest's
        jaw, close = w[:, SHAPE_INDEX["jawOpen"]], w[:, SHAPE_INDEX["mouthClose"]]
        share = np.clip(close / (_SEALED_AT * np.maximum(jaw, 0.03)), 0.0, 1.0)[:, None, None]
        parted = offset - close[:, None, None] * opened[SHAPE_INDEX["mouthClose"]]  # if nothing closed them
        wanted = (1.0 - share) * parted
        rolled = np.clip(w[:, columns_of("mouthRollLower") + columns_of("mouthRollUpper")].max(axis=1), 0.0, 1.0)
        change, height = wanted - offset, wanted[..., 1]
        # soft contact: a crossing of h mm ends as about -_TOUCH_MM, lips rolled in may pass each other a little
        touching = _TOUCH_MM * (1.0 + 4.0 * rolled)[:, None]
        stuck = height * height**2 / (height**2 + _STICKY_MM**2)
        held = np.where(height < 0.0, -touching * np.tanh(-height / touching), stuck)
        change[..., 1] += held - height
        return change


def swing_of(rotations: NDArray[np.float64], places: NDArray[np.float64], dt: float) -> NDArray[np.float64]:
    """Return how far soft tissue lags behind a moving head, (T, 3), millimetres, in the head's axes.

    Parameters
    ----------
    rotations : ndarray of shape (T, 3, 3)
        world_from_head.
    places : ndarray of shape (T, 3), millimetres
        Where the middle of the face is in the world.
    dt : float
        Time between frames, seconds.
    """
    if len(places) < 3:
        return np.zeros((len(places), 3))
    acceleration = np.zeros_like(places)
    acceleration[1:-1] = np.diff(places, 2, axis=0) / dt**2
    drive = -np.einsum("tji,tj->ti", rotations, acceleration)
    omega, damping = 2.0 * np.pi * _WOBBLE_HZ, _WOBBLE_DAMPING
    lag = np.zeros_like(places)
    at, speed = np.zeros(3), np.zeros(3)
    for t in range(1, len(places)):  # semi-implicit Euler, stable at 60 frames a second and more
        speed = speed + dt * (drive[t] - omega**2 * at - 2.0 * damping * omega * speed)
        at = at + dt * speed
        lag[t] = at
    return np.clip(lag, -3.0, 3.0)


def _side_by_side(pairs: tuple[tuple[str, str], ...]) -> list[tuple[int, int]]:
    """Return column pairs; shapes of two sides pair with the same side, those of one with both."""
    result = []
    for a, b in pairs:
        left, right = columns_of(a), columns_of(b)
        if len(left) == len(right):
            result += list(zip(left, right))
        else:
            result += [(i, k) for i in left for k in right]
    return result
