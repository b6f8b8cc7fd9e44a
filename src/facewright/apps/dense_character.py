"""A face that a region-based model drives, ready to be posed (Tena et al. 2011, Fig. 1 and 7)."""

from __future__ import annotations

import copy
from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

from facewright.apps.paint_person import person_colors
from facewright.apps.painted_skin import painted_skin
from facewright.faces.character_places import character_places
from facewright.faces.drive_character import bind_character
from facewright.faces.face import Face
from facewright.models.dense_drive import DenseDriver
from facewright.models.region_model import RegionModel


class DenseCharacter:
    """A face whose V vertices follow the N of a model; see `facewright.apps.posed_character.PosedCharacter`.

    Parameters
    ----------
    face : Face
    models : mapping of str to RegionModel
        As `PoseSession.models`: all of one mesh.

    Raises
    ------
    TopologyError
        If the model's mesh cannot be laid on the face.
    """

    def __init__(self, face: Face, models: Mapping[str, RegionModel]) -> None:
        model = models["region"]
        weights = bind_character(model, face, character_places(model, face))
        self.name = face.name
        self.topology = face.topology
        self.neutral = np.ascontiguousarray(weights.rest, dtype=np.float32)
        self.colors = person_colors(face)
        self.texture = painted_skin(face)
        self.handles = np.asarray(weights.follow.argmax(axis=0)).ravel().astype(np.int32)
        self.licence = face.licence
        self._models, self._weights = models, weights
        self._drivers = {kind: DenseDriver(model, weights) for kind, model in models.items()}
        self._rest = models["region"].neutral
        self._turns = weights.turns
        self._back = np.linalg.inv(weights.turns)

    def pose(self, kind: str, zeta: NDArray[np.float64], out: NDArray[np.float32]) -> None:
        """Write the posed vertices (V, 3), mm, of a kind of model into `out`."""
        self._drivers[kind].positions(zeta, out)

    def twin(self) -> DenseCharacter:
        """Return the same character with buffers of its own, for another thread."""
        other = copy.copy(self)
        other._drivers = {kind: DenseDriver(model, self._weights) for kind, model in self._models.items()}
        return other

    def to_model(self, vertex: int, point: NDArray[np.floating]) -> NDArray[np.float64]:
        """Return where the model's vertex shall be so that the character's comes to `point` (3,), mm."""
        return np.asarray(self._rest[vertex] + self._back[vertex] @ (point - self.neutral[self.handles[vertex]]))

    def from_model(self, vertex: int, point: NDArray[np.floating]) -> NDArray[np.float64]:
        """Return where on the character a place (3,), mm, of the model's vertex is."""
        return np.asarray(self.neutral[self.handles[vertex]] + self._turns[vertex] @ (point - self._rest[vertex]))
