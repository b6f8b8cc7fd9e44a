"""How symmetric a division of a face is, left against right."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from facewright.mesh.connectivity import vertex_adjacency
from facewright.models.regions import Regions
from facewright.numeric.check import check_finite, check_shape


def nearest_mirror(vertices: NDArray[np.floating[Any]], faces: NDArray[np.integer[Any]]) -> NDArray[np.int32]:
    """Return for each vertex (N,) the one nearest to its mirror image about x = 0.

    For meshes sampled without a mirror map; of vertices (N, 3), millimetres, and triangles (F, 3). Neighbours count
    too: closed lips lie on each other.
    """
    N = check_shape("vertices", vertices, "N", 3)["N"]
    check_finite("vertices", vertices)
    points = np.asarray(vertices, dtype=np.float64)
    adjacency = vertex_adjacency(faces, N)
    count = np.maximum(np.asarray(adjacency.sum(axis=1)).ravel(), 1.0)[:, None]
    features = np.concatenate([points, adjacency @ points / count], axis=1)
    return np.asarray(cKDTree(features).query(features * np.tile([-1.0, 1.0, 1.0], 2))[1], dtype=np.int32)


def cluster_symmetry(labels: NDArray[np.integer[Any]], mirror: NDArray[np.integer[Any]]) -> float:
    """Return how well clusters and their mirror images agree: the adjusted Rand index, 1 if they are the same.

    Of labels (N,) and a mirror map (N,); zero is what chance gives (Hubert and Arabie, 1985).
    """
    from sklearn.metrics import adjusted_rand_score

    N = check_shape("labels", labels, "N")["N"]
    check_shape("mirror", mirror, N)
    return float(adjusted_rand_score(labels, np.asarray(labels)[mirror]))


def mirrored_clusters(
    labels: NDArray[np.integer[Any]], mirror: NDArray[np.integer[Any]], x: NDArray[np.floating[Any]]
) -> NDArray[np.int32]:
    """Return nearly symmetric clusters made exactly so: the left side (x > 0) takes the mirror image of the right one.

    Of labels (N,), a mirror map (N,) and coordinates (N,), millimetres. Clusters of which the mirror images do not pair
    up stay as they are. On the middle line each vertex keeps its cluster.
    """
    N = check_shape("labels", labels, "N")["N"]
    check_shape("mirror", mirror, N)
    check_shape("x", x, N)
    given = np.asarray(labels, dtype=np.int32)
    partner = _partners(given, mirror)
    result = given.copy()
    if partner is not None:
        left = (np.asarray(x) > 0) & (np.asarray(mirror) != np.arange(N))
        result[left] = partner[given[mirror[left]]]
    return result


def mirrored_regions(regions: Regions, labels: NDArray[np.integer[Any]], mirror: NDArray[np.integer[Any]]) -> Regions:
    """Return regions of symmetric clusters (N,) that also share the mirror images of what they share."""
    partner = _partners(np.asarray(labels), mirror)
    if partner is None:
        return regions
    members = tuple(
        np.union1d(ids, np.asarray(mirror)[regions.members[partner[i]]]).astype(np.int32)
        for i, ids in enumerate(regions.members)
    )
    return Regions(regions.n_vertices, members, regions.names)


def _partners(labels: NDArray[np.integer[Any]], mirror: NDArray[np.integer[Any]]) -> NDArray[np.intp] | None:
    """Return the cluster that each cluster's mirror image is most like, (k,), or None where they do not pair up."""
    k = int(labels.max()) + 1
    shared = np.zeros((k, k), dtype=np.int64)
    np.add.at(shared, (labels, labels[mirror]), 1)
    partner = shared.argmax(axis=1)
    return partner if np.array_equal(partner[partner], np.arange(k)) else None
