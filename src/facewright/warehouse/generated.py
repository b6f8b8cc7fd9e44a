"""Made-up subjects in any number, for trying how databases and models scale: cheap, not meant to look like people."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from facewright.errors import ValueRangeError
from facewright.warehouse.subject import Subject

if TYPE_CHECKING:
    from facewright.faces.face import Face

_N_WAVES = 24
_WAVELENGTH_MM = (40.0, 160.0)
_FIELD_RMS_MM = 0.8  # what sets neutrals apart beyond the identity modes
_SHAPE_FIELD_SHARE = 0.15  # part of a blendshape that is the subject's own
_AMPLITUDE = (0.7, 1.2)
_AGES = (18, 80)


@dataclass(frozen=True, eq=False)
class GeneratedSubjects:
    """N subjects of a face with full-rank neutrals and personal blendshapes, each made in about 50 ms.

    Subject n's neutral is the mean, N(0, 1) on every identity mode and a sum of waves through space; each of its
    blendshapes is the generic one times an amplitude of U(0.7, 1.2) and, where the shape moves, times waves of its own.
    People of `faces.simulate`, on whom accuracy is measured, are more lifelike and take ten times longer.

    Parameters
    ----------
    face : Face
        Use ``face.skin()`` for the skin alone.
    count : int
        Number of subjects N.
    seed : int
        Subject n is drawn from ``default_rng([seed, n])``, and so the same in a larger population.

    Raises
    ------
    ValueRangeError
        If `count` is negative.
    """

    face: Face
    count: int
    seed: int = 0

    def __post_init__(self) -> None:
        if self.count < 0:
            raise ValueRangeError(f"count must not be negative, got {self.count}.")

    def __len__(self) -> int:
        return self.count

    def name(self, number: int) -> str:
        """Return the name of subject `number`."""
        return f"generated-{number:05d}"

    def subject(self, number: int) -> Subject:
        """Return subject `number`: the neutral mesh, blendshapes (47, V, 3) and attributes.

        Raises
        ------
        ValueRangeError
            If there is no such subject.
        """
        rng = self._rng(number)
        shapes = self._shapes(rng)
        return Subject(
            name=self.name(number),
            expressions=("neutral",),
            meshes=shapes[:1].copy(),
            blendshapes=shapes,
            attributes={"age": int(rng.integers(*_AGES)), "sex": "female" if rng.random() < 0.5 else "male"},
            provenance={"source": "generated", "face": self.face.name, "seed": self.seed, "number": number},
        )

    def shapes(self, number: int) -> NDArray[np.float32]:
        """Return the blendshapes (47, V, 3) of subject `number`, mm."""
        return self._shapes(self._rng(number))

    def _rng(self, number: int) -> np.random.Generator:
        if not 0 <= number < self.count:
            raise ValueRangeError(f"number must be in [0, {self.count - 1}], got {number}.")
        return np.random.default_rng([self.seed, number])

    def _shapes(self, rng: np.random.Generator) -> NDArray[np.float32]:
        """Return (47, V, 3): the neutral and the neutral plus each blendshape."""
        face = self.face
        modes = face.identity_basis.reshape(len(face.identity_basis), -1)
        weights = rng.normal(size=len(modes)).astype(np.float32)
        neutral = face.mean_shape + (weights @ modes).reshape(-1, 3)
        neutral += self._fields(1, rng)[0] * np.float32(_FIELD_RMS_MM)
        n_shapes = len(face.blendshape_deltas)
        amplitudes = rng.uniform(*_AMPLITUDE, n_shapes).astype(np.float32)
        shares = 1 + np.float32(_SHAPE_FIELD_SHARE) * self._fields(n_shapes, rng)
        shapes = np.empty((1 + n_shapes, *neutral.shape), dtype=np.float32)
        shapes[0] = neutral
        np.multiply(face.blendshape_deltas, amplitudes[:, None, None], out=shapes[1:])
        shapes[1:] *= shares
        shapes[1:] += neutral
        return shapes

    def _fields(self, n: int, rng: np.random.Generator) -> NDArray[np.float32]:
        """Return (n, V, 3) random mixtures of the waves, RMS 1 per coordinate on average."""
        mixtures = rng.normal(size=(n, 3, len(self._waves))).astype(np.float32)
        return (mixtures @ self._waves).swapaxes(1, 2)

    @cached_property
    def _waves(self) -> NDArray[np.float32]:
        """Waves through space, (W, V); the same for all subjects, so that the population has a spectrum that ends."""
        rng = np.random.default_rng(_N_WAVES)
        directions = rng.normal(size=(_N_WAVES, 3))
        directions /= np.linalg.norm(directions, axis=1, keepdims=True)
        numbers = 2 * np.pi / rng.uniform(*_WAVELENGTH_MM, _N_WAVES)
        phases = rng.uniform(0, 2 * np.pi, _N_WAVES)
        angles = (directions * numbers[:, None]) @ self.face.mean_shape.T.astype(np.float64) + phases[:, None]
        return (np.cos(angles) * np.sqrt(2 / _N_WAVES)).astype(np.float32)
