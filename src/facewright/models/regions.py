"""How a mesh divides into regions that share their boundary vertices."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from facewright.errors import ValueRangeError
from facewright.numeric.check import check_indices


@dataclass(frozen=True, eq=False)
class Regions:
    """M sets of vertices that cover a mesh of N vertices; boundary vertices belong to two or more.

    Region-based models, section 3.1: "The only requirement for defining the regions is that each shares at least one
    vertex with at least one other region." A single region of all vertices is the holistic case.

    Parameters
    ----------
    n_vertices : int
        N.
    members : tuple of ndarray of shape (N_i,), int32
        Vertices of each region, increasing.
    names : tuple of str
        A name for each, unique.

    Raises
    ------
    ValueRangeError
        If a region is empty or not increasing, a vertex is out of range or in no region, names do not match, or one of
        several regions shares no vertex with another.
    """

    n_vertices: int
    members: tuple[NDArray[np.int32], ...]
    names: tuple[str, ...]

    def __post_init__(self) -> None:
        if len(self.names) != len(self.members) or len(set(self.names)) != len(self.names):
            raise ValueRangeError(f"regions need one name each, got {len(self.members)} regions, names {self.names}.")
        for name, ids in zip(self.names, self.members, strict=True):
            if not len(ids) or (np.diff(ids) <= 0).any():
                raise ValueRangeError(f"region {name!r} must hold vertices in increasing order, at least one.")
            check_indices(f"region {name!r}", ids, self.n_vertices)
        count = self.count
        if (count == 0).any():
            raise ValueRangeError(
                f"every vertex must lie in a region, got {int((count == 0).sum())} of {self.n_vertices} that do not."
            )
        if len(self.members) > 1:
            for name, ids in zip(self.names, self.members, strict=True):
                if count[ids].max() < 2:
                    raise ValueRangeError(f"region {name!r} must share a vertex with another region, got none.")

    @property
    def count(self) -> NDArray[np.int32]:
        """How many regions each vertex lies in, (N,)."""
        return np.bincount(np.concatenate(self.members), minlength=self.n_vertices).astype(np.int32)

    @classmethod
    def holistic(cls, n_vertices: int) -> Regions:
        """Return the one region of all vertices."""
        return cls(n_vertices, (np.arange(n_vertices, dtype=np.int32),), ("face",))
