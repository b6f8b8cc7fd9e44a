"""Simulated people: neutrals and personal blendshapes deliberately outside what fitting knows."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from facewright.deform.deformation_transfer import DeformationTransfer
from facewright.errors import ValueRangeError
from facewright.faces.blendshape_names import mirrored_name
from facewright.faces.contact import Contact, face_contacts
from facewright.faces.face import Face
from facewright.faces.lids import Lids
from facewright.faces.pieces import Followers, face_pieces
from facewright.mesh.random_field import smooth_random_field
from facewright.numeric.check import check_shape

Progress = Callable[[str, int, int], None]

CORRELATION_MM = (15.0, 40.0)
NEUTRAL_FIELD_RMS_MM = 0.5
AMPLITUDE = (0.7, 1.2)
LEFT_RIGHT_DIFFERENCE = 0.15
PERTURBATION = 0.15

_SEALED_MM = 2.0  # lips whose offset a shape changes by less than about this stay as they are
_FIELD_BATCH = 8  # neutrals whose random fields share their waves


@dataclass(frozen=True, eq=False)
class SimulatedPerson:
    """One made-up person.

    Parameters
    ----------
    neutral : ndarray of shape (V, 3), float32, millimetres
        The face at rest.
    deltas : ndarray of shape (46, V, 3), float32, millimetres
        Personal blendshapes, displacements from `neutral` at weight one.
    amplitudes : ndarray of shape (46,), float64
        How far the person goes with each shape, relative to the generic face.
    """

    neutral: NDArray[np.float32]
    deltas: NDArray[np.float32]
    amplitudes: NDArray[np.float64]

    def pose(self, weights: NDArray[np.floating]) -> NDArray[np.float32]:
        """Return the person with blendshape weights (46,) or (T, 46): vertices (V, 3) or (T, V, 3).

        Raises
        ------
        ShapeError
            If `weights` is not (46,) or (T, 46).
        """
        n_shapes = len(self.deltas)
        if np.ndim(weights) == 1:
            check_shape("weights", weights, n_shapes)
        else:
            check_shape("weights", weights, "T", n_shapes)
        w = np.asarray(weights, dtype=np.float32).reshape(-1, n_shapes)
        posed = self.neutral + (w @ self.deltas.reshape(n_shapes, -1)).reshape(-1, *self.neutral.shape)
        return posed.reshape(np.shape(weights)[:-1] + self.neutral.shape)


def simulate_neutrals(face: Face, n: int, rng: np.random.Generator) -> NDArray[np.float32]:
    """Draw `n` neutral faces: mean + N(0, 1) on all identity modes + a smooth random field, lips sealed as in the mean.

    Parameters
    ----------
    face : Face
        Source of mean and modes; use ``face.skin()`` for the skin alone.
    n : int
        Number of people.
    rng : numpy.random.Generator
        Source of randomness.

    Returns
    -------
    ndarray of shape (n, V, 3), float32, millimetres
        Neutral faces.

    Raises
    ------
    ValueRangeError
        If `n` is negative.
    """
    if n < 0:
        raise ValueRangeError(f"n must not be negative, got {n}.")
    return _simulator(face).neutrals(n, rng)


def simulate_person(face: Face, rng: np.random.Generator) -> SimulatedPerson:
    """Draw one person with a neutral and 46 personal blendshapes.

    Personal blendshapes are the generic ones carried over by deformation transfer, times an amplitude of U(0.7, 1.2)
    each with left and right up to 15 % apart, plus a smooth perturbation of 15 % of the shape's own RMS size that lives
    where the shape moves. Lids close, lips that the generic shape keeps sealed stay sealed, mouthClose goes as far as
    jawOpen, teeth and eyeballs move rigidly.
    """
    simulator = _simulator(face)
    return simulator.person(simulator.neutrals(1, rng)[0], rng)


def simulate_expressions(face: Face, neutral: NDArray[np.floating], rng: np.random.Generator) -> SimulatedPerson:
    """Give a neutral (V, 3) 46 personal blendshapes as `simulate_person` does; equal `rng`, equal personality.

    Raises
    ------
    ShapeError
        If `neutral` is not of the face's topology.
    """
    check_shape("neutral", neutral, face.topology.n_vertices, 3)
    return _simulator(face).person(np.asarray(neutral, dtype=np.float32), rng)


def simulate_population(
    face: Face,
    n: int,
    rng: np.random.Generator,
    progress: Progress | None = None,
    *,
    out: NDArray[np.float32] | None = None,
) -> NDArray[np.float32]:
    """Draw `n` people as one tensor of shapes.

    Parameters
    ----------
    face : Face
        Source face; ``face.skin()`` for the 11K mesh.
    n : int
        Number of people.
    rng : numpy.random.Generator
        Source of randomness.
    progress : callable, optional
        Called as progress("simulating people", done, total).
    out : ndarray of shape (n, 47, V, 3), float32, optional
        Where to write, for example a memory-mapped file.

    Returns
    -------
    ndarray of shape (n, 47, V, 3), float32, millimetres
        Shape 0 is the neutral, shape i the neutral plus blendshape i.

    Raises
    ------
    ValueRangeError
        If `n` is negative.
    ShapeError
        If `out` is of another shape.
    """
    if n < 0:
        raise ValueRangeError(f"n must not be negative, got {n}.")
    shape = (n, 1 + len(face.blendshape_names), face.topology.n_vertices, 3)
    if out is None:
        out = np.zeros(shape, dtype=np.float32)
    check_shape("out", out, *shape)
    simulator = _simulator(face)
    for i, neutral in enumerate(simulator.neutrals(n, rng)):
        person = simulator.person(neutral, rng)
        out[i, 0] = person.neutral
        np.add(person.neutral, person.deltas, out=out[i, 1:])
        if progress is not None:
            progress("simulating people", i + 1, n)
    return out


class _Simulator:
    """What is computed once for a face: the surface that deforms, what follows it, what moves rigidly."""

    def __init__(self, face: Face) -> None:
        self.face = face
        pieces = face_pieces(face)
        self.skin = slice(0, face.n_skin)
        self.surface = pieces.surface
        self.mean = face.mean_shape.astype(np.float64)
        self.generic = face.blendshape_deltas.astype(np.float64)
        # The surface's triangles, numbered within the surface.
        self.surface_faces = _renumbered(pieces.surface_faces, pieces.surface, face.topology.n_vertices)
        self.contacts: dict[str, Contact] = face_contacts(self.mean, face.topology, pieces.surface_faces)
        self.lids = Lids(face, self.contacts)
        self.rigid = pieces.rigid
        self.loose = pieces.loose
        self.followers = Followers(self.mean[self.surface], self.mean[self.loose])
        self.source = self.mean[self.surface]
        self.source_poses = self.source + self.generic[:, self.surface]
        self.partner = np.array([face.blendshape_names.index(mirrored_name(n)) for n in face.blendshape_names])
        self.reach = self._reach()

    def _reach(self) -> NDArray[np.float64]:
        """Return (46, V): 1 where a shape moves by 30 % of its largest motion or more, down to 0 where it is still."""
        size = np.linalg.norm(self.generic, axis=2)
        largest = size[:, self.skin].max(axis=1, keepdims=True)
        return np.clip(size / np.maximum(0.3 * largest, 1e-9), 0.0, 1.0)

    def neutrals(self, n: int, rng: np.random.Generator) -> NDArray[np.float32]:
        """Return (n, V, 3) neutral faces."""
        face = self.face
        n_modes = len(face.identity_basis)
        result = np.zeros((n, face.topology.n_vertices, 3), dtype=np.float32)
        for start in range(0, n, _FIELD_BATCH):
            count = min(_FIELD_BATCH, n - start)
            c = rng.normal(size=(count, n_modes)).astype(np.float32)
            fields = self._skin_fields(count, rng) * NEUTRAL_FIELD_RMS_MM
            for motion in self.rigid:
                fields[:, motion.vertices] = fields[:, motion.vertices].mean(axis=1, keepdims=True)
            modes = (c @ face.identity_basis.reshape(n_modes, -1)).reshape(count, -1, 3)
            result[start : start + count] = self.mean + modes + fields
        if "lips" in self.contacts:
            lips = self.contacts["lips"]
            lips.change(result, lips.offsets(self.mean) - lips.offsets(result))
        return result

    def _skin_fields(self, count: int, rng: np.random.Generator) -> NDArray[np.float64]:
        """Return (count, V, 3) smooth random fields with an RMS length of 1 over the skin."""
        fields = smooth_random_field(self.mean, rng.uniform(*CORRELATION_MM), 1.0, rng, n_fields=count)
        fields /= _rms(fields[:, self.skin])[:, None, None]
        return fields

    def person(self, neutral: NDArray[np.float32], rng: np.random.Generator) -> SimulatedPerson:
        """Return the person with this neutral (V, 3)."""
        amplitudes = self._amplitudes(rng)
        scale = amplitudes[:, None, None]
        rest = neutral.astype(np.float64)
        transfer = DeformationTransfer(self.source, rest[self.surface], self.surface_faces)
        deltas = scale * self.generic
        deltas[:, self.surface] = scale * (transfer.transfer(self.source_poses) - rest[self.surface])
        offsets = {name: contact.offsets(deltas) for name, contact in self.contacts.items()}
        field = self._skin_fields(len(deltas), rng)
        field *= self.reach[:, :, None]
        size = PERTURBATION * _rms(deltas[:, self.skin]) / np.maximum(_rms(field[:, self.skin]), 1e-12)
        field *= size[:, None, None]
        deltas[:, self.surface] += field[:, self.surface]
        self._keep_contacts(rest, deltas, offsets)
        if len(self.loose):
            difference = deltas[:, self.surface] - scale * self.generic[:, self.surface]
            deltas[:, self.loose] += self.followers.follow(difference)
        for motion in self.rigid:
            deltas[:, motion.vertices] = motion.deltas(rest[motion.vertices], amplitudes)
        self.lids.clear(rest, deltas)
        return SimulatedPerson(neutral, deltas.astype(np.float32), amplitudes)

    def _amplitudes(self, rng: np.random.Generator) -> NDArray[np.float64]:
        """Draw (46,) amplitudes: U(0.7, 1.2) per pair, its sides up to 15 % apart; mouthClose as jawOpen."""
        names = self.face.blendshape_names
        amplitudes = rng.uniform(*AMPLITUDE, len(names))
        lean = rng.uniform(-0.5, 0.5, len(names)) * LEFT_RIGHT_DIFFERENCE
        for i, j in enumerate(self.partner):
            if i < j:
                amplitudes[j] = amplitudes[i] * (1.0 - lean[i])
                amplitudes[i] = amplitudes[i] * (1.0 + lean[i])
        if "mouthClose" in names and "jawOpen" in names:
            amplitudes[names.index("mouthClose")] = amplitudes[names.index("jawOpen")]
        return amplitudes

    def _keep_contacts(
        self, rest: NDArray[np.float64], deltas: NDArray[np.float64], before: dict[str, NDArray[np.float64]]
    ) -> None:
        """Undo what the perturbation did to sealed lips, and close the lids."""
        names = self.face.blendshape_names
        if "lips" in self.contacts:
            lips = self.contacts["lips"]
            opening = np.linalg.norm(before["lips"], axis=2, keepdims=True)
            sealed = np.exp(-0.5 * (opening / _SEALED_MM) ** 2)
            lips.change(deltas, sealed * (before["lips"] - lips.offsets(deltas)))
        for side in ("left", "right"):
            shape = f"eyeBlink_{side[0].upper()}"
            if shape in names:
                self.lids.close("upper", side, rest, deltas, names.index(shape))


def _renumbered(faces: NDArray[np.int32], kept: slice | NDArray[np.intp], n_vertices: int) -> NDArray[np.intp]:
    """Return triangles with their vertices numbered within those that are kept."""
    number = np.full(n_vertices, -1)
    number[kept] = np.arange(len(number[kept]))
    return number[faces]


def _rms(fields: NDArray[np.floating]) -> NDArray[np.float64]:
    """Return the RMS length of displacements (N, V, 3) per field, shape (N,)."""
    return np.sqrt(np.einsum("nvc,nvc->n", fields, fields) / max(fields.shape[1], 1))


@lru_cache(maxsize=4)
def _simulator(face: Face) -> _Simulator:
    return _Simulator(face)
