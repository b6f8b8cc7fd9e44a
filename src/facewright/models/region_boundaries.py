"""Which vertices regions share: those of triangles that lie across their borders."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from facewright.errors import ValueRangeError
from facewright.models.regions import Regions
from facewright.numeric.check import check_indices, check_shape


def share_boundaries(
    labels: NDArray[np.integer[Any]], faces: NDArray[np.integer[Any]], names: Sequence[str] | None = None
) -> Regions:
    """Return regions that overlap: every corner of a triangle that spans clusters belongs to all of that triangle's.

    The paper chooses the shared vertices by hand (end of its section 4.2); a file of regions may be edited likewise.

    Parameters
    ----------
    labels : ndarray of shape (N,), int
        Cluster of each vertex, from 0, each number used.
    faces : ndarray of shape (F, 3), int
        Triangles.
    names : sequence of str, optional
        Names of the clusters; ``region_01``, ``region_02``, ... where absent.

    Raises
    ------
    ShapeError, ValueRangeError
        If shapes are wrong, a number is not used, names do not match, or a cluster touches no other.
    """
    N = check_shape("labels", labels, "N")["N"]
    check_shape("faces", faces, "F", 3)
    check_indices("faces", faces, N)
    labels = np.asarray(labels)
    k = int(labels.max()) + 1
    if labels.min() < 0 or len(np.unique(labels)) != k:
        raise ValueRangeError(f"labels must be 0 to k - 1, each used, got {np.unique(labels)[:10].tolist()}.")
    names = tuple(names) if names is not None else tuple(f"region_{i + 1:02d}" for i in range(k))
    if len(names) != k:
        raise ValueRangeError(f"names must be one for each of {k} clusters, got {len(names)}.")
    belongs = np.zeros((k, N), dtype=bool)
    belongs[labels, np.arange(N)] = True
    for corner in range(3):
        for other in range(3):
            belongs[labels[faces[:, corner]], faces[:, other]] = True
    members = tuple(np.flatnonzero(row).astype(np.int32) for row in belongs)
    return Regions(N, members, names)


def home_regions(regions: Regions) -> NDArray[np.int32]:
    """Return one region for each vertex (N,): the first that holds it; only boundary vertices have a choice."""
    home = np.full(regions.n_vertices, -1, dtype=np.int32)
    for i in range(len(regions.members) - 1, -1, -1):
        home[regions.members[i]] = i
    return home
