"""A face source: one topology with its mean, identity modes and generic blendshapes."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from facewright.mesh.topology import Topology
from facewright.numeric.check import check_shape


@dataclass(frozen=True, eq=False)
class Face:
    """Geometry of a generic person and how people and expressions vary around it.

    Parameters
    ----------
    name : str
        ``"builtin"``, ``"ict"`` or the name of a face of the user's own.
    topology : Topology
        Skin parts first, then mouth cavity, eyes, teeth and so on.
    mean_shape : ndarray of shape (V, 3), float32, millimetres
        The generic neutral.
    identity_basis : ndarray of shape (I, V, 3), float32, millimetres
        Displacement of each identity mode at one standard deviation.
    blendshape_names : tuple of str
        The B = 46 FACS shapes, in the project's order (`facewright.faces.blendshape_names`).
    blendshape_deltas : ndarray of shape (B, V, 3), float32, millimetres
        Displacement of each generic blendshape at weight one.
    rigid_parts : mapping of str to str
        Parts that move rigidly: part name -> ``"skull"``, ``"jaw"`` or ``"eye"``.
    licence : str
        One line: licence and attribution of the geometry.
    """

    name: str
    topology: Topology
    mean_shape: NDArray[np.float32]
    identity_basis: NDArray[np.float32]
    blendshape_names: tuple[str, ...]
    blendshape_deltas: NDArray[np.float32]
    rigid_parts: Mapping[str, str] = field(default_factory=dict)
    licence: str = ""

    def __post_init__(self) -> None:
        sizes = check_shape("mean_shape", self.mean_shape, self.topology.n_vertices, 3)
        V = self.topology.n_vertices
        check_shape("identity_basis", self.identity_basis, "I", V, 3, **sizes)
        check_shape("blendshape_deltas", self.blendshape_deltas, len(self.blendshape_names), V, 3)

    @property
    def n_skin(self) -> int:
        """Number of skin vertices (parts ``face`` and ``head_and_neck``), which come first."""
        return self.topology.part_slice("face", "head_and_neck").stop

    def skin(self) -> Face:
        """Return the face restricted to its skin; for ICT-FaceKit this is the 11,248-vertex mesh."""
        n = self.n_skin
        return replace(
            self,
            topology=self.topology.submesh(n, name=f"{self.topology.name}-skin"),
            mean_shape=self.mean_shape[:n],
            identity_basis=self.identity_basis[:, :n],
            blendshape_deltas=self.blendshape_deltas[:, :n],
            rigid_parts={},
        )
