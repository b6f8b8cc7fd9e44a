"""What a performer did, registered: clips of one mesh without the head's motion."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from facewright.errors import ValueRangeError
from facewright.mesh.mesh_sequence import MeshSequence
from facewright.numeric.check import check_finite, check_indices, check_shape


@dataclass(frozen=True, eq=False)
class PerformerClip:
    """T registered frames of one recording, the head held still.

    The recorded face of frame t is ``rotations[t] @ x + translations[t]`` of each vertex x.

    Parameters
    ----------
    name : str
        Name of the clip, by custom the recording's file name.
    times : ndarray of shape (T,), float64, seconds
        Strictly increasing.
    vertices : ndarray of shape (T, N, 3), float32, millimetres
        Meshes aligned to the performer's neutral (rigid motion removed), y up, face towards +z.
    rotations : ndarray of shape (T, 3, 3), float64
        Head rotation, recorded_from_model.
    translations : ndarray of shape (T, 3), float64, millimetres
        Head position, recorded_from_model.

    Raises
    ------
    ShapeError, ValueRangeError
        If arrays do not match, a value is not finite or times do not increase.
    """

    name: str
    times: NDArray[np.float64]
    vertices: NDArray[np.float32]
    rotations: NDArray[np.float64]
    translations: NDArray[np.float64]

    def __post_init__(self) -> None:
        sizes = check_shape("times", self.times, "T")
        check_shape("vertices", self.vertices, "T", "N", 3, **sizes)
        check_shape("rotations", self.rotations, "T", 3, 3, **sizes)
        check_shape("translations", self.translations, "T", 3, **sizes)
        for name in ("times", "vertices", "rotations", "translations"):
            check_finite(name, getattr(self, name))
        if (np.diff(self.times) <= 0).any():
            raise ValueRangeError(f"times of clip {self.name!r} must increase from frame to frame.")

    @property
    def n_frames(self) -> int:
        """Number of frames T."""
        return len(self.times)

    def recorded(self) -> NDArray[np.float64]:
        """Return the meshes where they were recorded, with head motion, (T, N, 3), mm."""
        turned = self.vertices.astype(np.float64) @ self.rotations.transpose(0, 2, 1)
        return np.asarray(turned + self.translations[:, None])


@dataclass(frozen=True, eq=False)
class PerformerData:
    """A performer's registered clips on one coarse mesh of N vertices.

    Two performers with equal `faces` and `vertex_ids` of the same `template` are in dense correspondence.

    Parameters
    ----------
    name : str
        Of the performer.
    faces : ndarray of shape (F, 3), int32
        Triangles, counter-clockwise seen from outside.
    neutral : ndarray of shape (N, 3), float32, millimetres
        The performer at rest, aligned to `reference` by ordinary Procrustes (rotation and translation).
    reference : ndarray of shape (N, 3), float32, millimetres
        The generic template's N vertices: y up, face towards +z.
    clips : tuple of PerformerClip
        Names are unique.
    template : str
        Name of the dense template's topology (``"ict"``, ``"builtin"``), or of the mesh itself where it was not fitted.
    vertex_ids : ndarray of shape (N,), int32
        Vertices of the dense template that were kept; 0 to N - 1 where nothing was subsampled.
    mirror : ndarray of shape (N,), int32, or None
        Vertex that each vertex has as its mirror image across x = 0.
    statistics : mapping of str to JSON values
        What was done to markers and how well they are met; see `facewright.apps.import_mocap`.

    Raises
    ------
    ShapeError, ValueRangeError
        If arrays do not match, an index is out of range, a name repeats or a value is not finite.
    """

    name: str
    faces: NDArray[np.int32]
    neutral: NDArray[np.float32]
    reference: NDArray[np.float32]
    clips: tuple[PerformerClip, ...]
    template: str
    vertex_ids: NDArray[np.int32]
    mirror: NDArray[np.int32] | None = None
    statistics: Mapping[str, Any] = field(default_factory=dict)

    def __post_init__(self) -> None:
        sizes = check_shape("neutral", self.neutral, "N", 3)
        check_shape("reference", self.reference, "N", 3, **sizes)
        check_shape("vertex_ids", self.vertex_ids, "N", **sizes)
        check_shape("faces", self.faces, "F", 3)
        check_indices("faces", self.faces, sizes["N"])
        check_finite("neutral", self.neutral)
        check_finite("reference", self.reference)
        if self.mirror is not None:
            check_shape("mirror", self.mirror, "N", **sizes)
            check_indices("mirror", self.mirror, sizes["N"])
        for clip in self.clips:
            check_shape(f"vertices of clip {clip.name!r}", clip.vertices, "T", sizes["N"], 3)
        names = [clip.name for clip in self.clips]
        if len(set(names)) != len(names):
            raise ValueRangeError(f"clips of {self.name} must have different names, got {', '.join(names)}.")

    @property
    def n_vertices(self) -> int:
        """Number of vertices N."""
        return len(self.neutral)

    @property
    def clip_names(self) -> tuple[str, ...]:
        """Names of the clips, in order."""
        return tuple(clip.name for clip in self.clips)

    def clip(self, name: str) -> PerformerClip:
        """Return the clip of that name.

        Raises
        ------
        ValueRangeError
            If there is none.
        """
        for clip in self.clips:
            if clip.name == name:
                return clip
        raise ValueRangeError(f"clip must be one of {', '.join(self.clip_names)}, got {name!r}.")

    def frames(self, *names: str) -> NDArray[np.float32]:
        """Return all frames of these clips (of all clips without names), (T, N, 3), mm."""
        clips = [self.clip(name) for name in names] if names else list(self.clips)
        empty = np.empty((0, self.n_vertices, 3), dtype=np.float32)
        return np.concatenate([empty, *(clip.vertices for clip in clips)])

    def displacements(self, *names: str) -> NDArray[np.float32]:
        """Return all frames of these clips less the neutral, (T, N, 3), mm."""
        return self.frames(*names) - self.neutral

    def sequence(self, name: str) -> MeshSequence:
        """Return a clip as a mesh sequence, the head held still."""
        clip = self.clip(name)
        return MeshSequence(clip.times, clip.vertices, self.faces)
