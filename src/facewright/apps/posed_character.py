"""What a pose is shown on: the model's own mesh, or a dense character that it drives."""

from __future__ import annotations

from typing import TYPE_CHECKING, Protocol

import numpy as np
from numpy.typing import NDArray

from facewright.errors import ValueRangeError
from facewright.mesh.topology import Topology

if TYPE_CHECKING:
    from collections.abc import Mapping

    from facewright.models.region_model import RegionModel

#: Names that `load_character` knows.
CHARACTERS = ("builtin", "ict", "none")


class PosedCharacter(Protocol):
    """A face of V vertices that follows a model of N."""

    name: str
    topology: Topology
    #: The character at rest, (V, 3) float32, mm.
    neutral: NDArray[np.float32]
    #: sRGB colours (V, 3) uint8, or None.
    colors: NDArray[np.uint8] | None
    #: sRGB picture of the skin (H, W, 3) uint8, laid out by the topology's uv, or None.
    texture: NDArray[np.uint8] | None
    #: The character's vertex at each vertex of the model, (N,) int32.
    handles: NDArray[np.int32]
    #: Licence line of its geometry.
    licence: str

    def pose(self, kind: str, zeta: NDArray[np.float64], out: NDArray[np.float32]) -> None:
        """Write the posed vertices (V, 3), mm, of a kind of model into `out`."""

    def twin(self) -> PosedCharacter:
        """Return the same character with buffers of its own, for another thread."""

    def to_model(self, vertex: int, point: NDArray[np.floating]) -> NDArray[np.float64]:
        """Return where the model's vertex shall be so that the character's comes to `point` (3,), mm."""

    def from_model(self, vertex: int, point: NDArray[np.floating]) -> NDArray[np.float64]:
        """Return where on the character a place (3,), mm, of the model's vertex is."""


class ModelMesh:
    """The model's own mesh as a character.

    Parameters
    ----------
    models : mapping of str to RegionModel
        As `PoseSession.models`.
    """

    def __init__(self, models: Mapping[str, RegionModel]) -> None:
        from facewright.models.region_blend import RegionBlend

        model = models["region"]
        self._models = models
        self.name = "none"
        self.topology = Topology("region model", model.n_vertices, model.faces)
        self.neutral = model.neutral.astype(np.float32)
        self.colors: NDArray[np.uint8] | None = None
        self.texture: NDArray[np.uint8] | None = None
        self.handles = np.arange(model.n_vertices, dtype=np.int32)
        self.licence = ""
        self._blends = {kind: RegionBlend(one) for kind, one in models.items()}

    def pose(self, kind: str, zeta: NDArray[np.float64], out: NDArray[np.float32]) -> None:
        """Write the posed vertices (V, 3), mm, of a kind of model into `out`."""
        self._blends[kind].positions(zeta, out)

    def twin(self) -> ModelMesh:
        """Return the same character with buffers of its own, for another thread."""
        return ModelMesh(self._models)

    def to_model(self, vertex: int, point: NDArray[np.floating]) -> NDArray[np.float64]:
        """Return `point`: the spaces are one."""
        return np.asarray(point, dtype=np.float64)

    def from_model(self, vertex: int, point: NDArray[np.floating]) -> NDArray[np.float64]:
        """Return `point`: the spaces are one."""
        return np.asarray(point, dtype=np.float64)


def load_character(name: str, models: Mapping[str, RegionModel]) -> PosedCharacter:
    """Return the character of a name: a face that is installed, or ``"none"`` for the model's own mesh.

    Raises
    ------
    ValueRangeError
        If the name is unknown.
    MissingFaceError
        If the face is not installed.
    """
    if name == "none":
        return ModelMesh(models)
    if name not in CHARACTERS and not name.endswith(".npz"):
        raise ValueRangeError(f"character must be one of {', '.join(CHARACTERS)}, got {name!r}.")
    from facewright.apps.dense_character import DenseCharacter
    from facewright.faces import load_face

    return DenseCharacter(load_face(name), models)
