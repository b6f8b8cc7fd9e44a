"""A dense character driven by a coarse region-based model (Tena et al. 2011, section 6 and Fig. 1)."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy import sparse

from facewright.errors import ShapeError
from facewright.models._drive_kernels import clear_eyeballs, follow, follow_jaw, seal
from facewright.models.character_contact import LidClearance, Seals
from facewright.models.region_blend import Blend, RegionBlend
from facewright.models.region_model import RegionModel
from facewright.numeric.check import check_finite, check_indices, check_shape


@dataclass(frozen=True, eq=False)
class JawFollowers:
    """What goes with the jaw: teeth, and a share of tongue, gums and mouth cavity.

    Parameters
    ----------
    points : ndarray of shape (K,), int
        Points of the coarse mesh that tell how the jaw stands.
    matrix : ndarray of shape (6, 3 K), float64
        Rotation vector (radians) and translation (mm) of the jaw from their displacements.
    centre : ndarray of shape (3,), millimetres
        What the rotation is about.
    shares : ndarray of shape (V,), float64
        1 for what is fixed to the jaw, 0 for what is not.
    skin_ids : ndarray of shape (A,), int
        Skin (under the jaw, inside the lips) that the points' displacements alone do not explain.
    skin_lean : ndarray of shape (A, 3, 6), float64
        What the jaw's rotation and translation add there, mm.
    """

    points: NDArray[np.intp]
    matrix: NDArray[np.float64]
    centre: NDArray[np.float64]
    shares: NDArray[np.float64]
    skin_ids: NDArray[np.intp]
    skin_lean: NDArray[np.float64]

    @classmethod
    def none(cls, n_vertices: int) -> JawFollowers:
        """Return what a character without jaw has."""
        ids = np.zeros(0, np.intp)
        return cls(ids, np.zeros((6, 0)), np.zeros(3), np.zeros(n_vertices), ids, np.zeros((0, 3, 6)))


@dataclass(frozen=True, eq=False)
class CharacterWeights:
    """How the V vertices of a character follow the N vertices of a model; see `facewright.faces.drive_character`.

    Parameters
    ----------
    rest : ndarray of shape (V, 3), float32, millimetres
        The character's neutral.
    follow : scipy.sparse.csr_matrix of shape (V, N)
        Weights of the points' displacements.
    turns : ndarray of shape (N, 3, 3), float64
        Carry a displacement of the model's face to the character's: local rotation and size.
    jaw : JawFollowers
    seals : Seals
        Lips and lids that meet.
    lids : LidClearance
        Lids that stay outside the eyeballs.

    Raises
    ------
    ShapeError, ValueRangeError
        If arrays do not match or a value is not finite.
    """

    rest: NDArray[np.float32]
    follow: sparse.csr_matrix
    turns: NDArray[np.float64]
    jaw: JawFollowers
    seals: Seals = field(default_factory=Seals.none)
    lids: LidClearance = field(default_factory=LidClearance.none)

    def __post_init__(self) -> None:
        V, N = self.follow.shape
        check_shape("rest", self.rest, V, 3)
        check_shape("turns", self.turns, N, 3, 3)
        K = check_shape("jaw.points", self.jaw.points, "K")["K"]
        check_indices("jaw.points", self.jaw.points, N)
        check_shape("jaw.matrix", self.jaw.matrix, 6, 3 * K)
        check_shape("jaw.shares", self.jaw.shares, V)
        for name, values in (("rest", self.rest), ("turns", self.turns), ("follow", self.follow.data)):
            check_finite(name, values)


class DenseDriver:
    """Move a character's vertices with a region-based model, straight into the caller's buffer.

    Parameters
    ----------
    model : RegionModel
    weights : CharacterWeights
        Of the same N points.
    blend : {"average", "gradient"}
        How the model's boundaries are made one, see `RegionBlend`.

    Raises
    ------
    ShapeError
        If the weights are of another number of points.
    """

    def __init__(self, model: RegionModel, weights: CharacterWeights, blend: Blend = "average") -> None:
        N = weights.follow.shape[1]
        if model.n_vertices != N:
            raise ShapeError(f"weights must follow the model's {model.n_vertices} vertices, got {N}.")
        self.weights = weights
        self._blend = RegionBlend(model, blend)
        rows = weights.follow.tocsr()
        self._starts, self._columns = rows.indptr.astype(np.uint32), rows.indices.astype(np.uint32)
        self._values = rows.data.astype(np.float32)
        self._rest = np.ascontiguousarray(weights.rest, dtype=np.float32)
        self._turns = np.ascontiguousarray(weights.turns, dtype=np.float64)
        self._carried = np.empty((N, 3), dtype=np.float32)
        jaw = weights.jaw
        ids = np.flatnonzero(jaw.shares).astype(np.int32)
        self._jaw = (
            jaw.points.astype(np.int64),
            np.ascontiguousarray(jaw.matrix, dtype=np.float64),
            np.ascontiguousarray(jaw.centre, dtype=np.float64),
            ids,
            jaw.shares[ids].astype(np.float32),
            jaw.skin_ids.astype(np.int32),
            np.ascontiguousarray(jaw.skin_lean, dtype=np.float32),
        )
        seals, lids = weights.seals, weights.lids
        self._seals = (
            seals.upper.astype(np.int32),
            seals.lower.astype(np.int32),
            seals.floors.astype(np.float32),
            seals.reaches.astype(np.float32),
            seals.moved.astype(np.int32),
            np.ascontiguousarray(seals.spread, dtype=np.float32),
        )
        self._lids = (
            lids.ids.astype(np.int32),
            lids.eye.astype(np.int32),
            lids.margins.astype(np.float32),
            lids.centres.astype(np.float32),
            lids.radii.astype(np.float32),
        )
        self.drive(np.zeros((N, 3)))  # compiles

    @property
    def n_vertices(self) -> int:
        """Number of the character's vertices V."""
        return len(self._rest)

    def positions(self, zeta: NDArray[np.float64], out: NDArray[np.float32] | None = None) -> NDArray[np.float32]:
        """Return the character (V, 3), mm, at coefficients zeta (P,), in `out` (float32, C order) where given.

        Raises
        ------
        ShapeError
            If `zeta` is not (P,) or `out` not (V, 3).
        """
        return self.drive(self._blend.displacements(zeta), out)

    def drive(self, moved: NDArray[np.floating[Any]], out: NDArray[np.float32] | None = None) -> NDArray[np.float32]:
        """Return the character (V, 3), mm, where the model's vertices are displaced by `moved` (N, 3), mm.

        Raises
        ------
        ShapeError
            If `moved` is not (N, 3) or `out` not (V, 3).
        """
        if out is None:
            out = np.empty_like(self._rest)
        elif out.shape != self._rest.shape:
            raise ShapeError(f"out must have shape {self._rest.shape}, got {out.shape}.")
        values = np.ascontiguousarray(moved, dtype=np.float64)
        if values.shape != self._carried.shape:
            raise ShapeError(f"moved must have shape {self._carried.shape}, got {values.shape}.")
        follow(values, self._turns, self._carried, self._starts, self._columns, self._values, self._rest, out)
        follow_jaw(self._carried, *self._jaw, self._rest, out)
        seal(*self._seals, out)
        clear_eyeballs(*self._lids, out)
        return out
