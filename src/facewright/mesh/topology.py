"""What all meshes of one kind share: triangles, texture coordinates, parts, masks, landmarks, mirror map."""

from __future__ import annotations

import hashlib
from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cached_property
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from facewright.errors import ValueRangeError
from facewright.numeric.check import check_indices, check_shape


@dataclass(frozen=True, eq=False)
class Topology:
    """Connectivity and annotation of a family of meshes; positions live elsewhere.

    Parameters
    ----------
    name : str
        Short name of the family, for example ``"builtin"`` or ``"ict"``.
    n_vertices : int
        Number of vertices V.
    faces : ndarray of shape (F, 3), int32
        Triangles, counter-clockwise seen from outside.
    quads : ndarray of shape (Q, 4), int32, or None
        The polygons that `faces` triangulates, -1 pads a triangle; for subdivision and export.
    uv : ndarray of shape (U, 2), float32, or None
        Texture coordinates, v upwards.
    uv_faces : ndarray of shape (F, 3), int32, or None
        Indices into `uv`, one triangle per row of `faces`.
    parts : mapping of str to (start, stop)
        Half-open vertex ranges that tile [0, V), in order.
    masks : mapping of str to ndarray of int32
        Named vertex sets, such as ``"face"``, ``"lips"``, ``"left"``: sorted and unique, but for the ``*_contact_*``
        masks, whose entries are paired by position (vertices that meet when lips or lids close).
    landmarks : mapping of str to ndarray of int32
        Vertex of each point of a landmark scheme; -1 where the scheme's point has no fixed vertex.
    mirror : ndarray of shape (V,), int32, or None
        Vertex that each vertex has as its mirror image across x = 0 (an involution).
    """

    name: str
    n_vertices: int
    faces: NDArray[np.int32]
    quads: NDArray[np.int32] | None = None
    uv: NDArray[np.float32] | None = None
    uv_faces: NDArray[np.int32] | None = None
    parts: Mapping[str, tuple[int, int]] = field(default_factory=dict)
    masks: Mapping[str, NDArray[np.int32]] = field(default_factory=dict)
    landmarks: Mapping[str, NDArray[np.int32]] = field(default_factory=dict)
    mirror: NDArray[np.int32] | None = None

    def __post_init__(self) -> None:
        check_shape("faces", self.faces, "F", 3)
        check_indices("faces", self.faces, self.n_vertices)
        for key, ids in self.masks.items():
            check_indices(f"mask {key!r}", ids, self.n_vertices)
        if self.mirror is not None:
            check_shape("mirror", self.mirror, self.n_vertices)

    @cached_property
    def fingerprint(self) -> str:
        """First 16 hex digits of SHA-256 over vertex count and triangles: equal means same topology."""
        digest = hashlib.sha256(np.int64(self.n_vertices).tobytes())
        digest.update(np.ascontiguousarray(self.faces, dtype="<i4").tobytes())
        return digest.hexdigest()[:16]

    def part_slice(self, *names: str) -> slice:
        """Return the vertex slice covering adjacent parts `names`.

        Raises
        ------
        ValueRangeError
            If a part is unknown or the parts are not adjacent.
        """
        for name in names:
            if name not in self.parts:
                raise ValueRangeError(f"part must be one of {', '.join(self.parts)}, got {name!r}.")
        ranges = sorted(self.parts[name] for name in names)
        for (_, stop), (start, _) in pairwise(ranges):
            if stop != start:
                raise ValueRangeError(f"parts {', '.join(names)} must be adjacent vertex ranges.")
        return slice(ranges[0][0], ranges[-1][1])

    def submesh(self, stop: int, name: str | None = None) -> Topology:
        """Return the topology of the first `stop` vertices (triangles that lie wholly within them).

        Parts order skin first, so that ``submesh(topology.part_slice("face", "head_and_neck").stop)`` is the skin.
        """
        inside = (self.faces < stop).all(axis=1)
        quads = None if self.quads is None else self.quads[(self.quads < stop).all(axis=1)]
        mirror = None if self.mirror is None else self.mirror[:stop]
        if mirror is not None and stop and mirror.max() >= stop:
            mirror = None
        return Topology(
            name=name or self.name,
            n_vertices=stop,
            faces=self.faces[inside],
            quads=quads,
            uv=self.uv,
            uv_faces=None if self.uv_faces is None else self.uv_faces[inside],
            parts={k: r for k, r in self.parts.items() if r[1] <= stop},
            masks={k: m[m < stop] for k, m in self.masks.items()},
            landmarks={k: np.where(ids < stop, ids, -1).astype(np.int32) for k, ids in self.landmarks.items()},
            mirror=mirror,
        )
