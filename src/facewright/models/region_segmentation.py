"""Divide a mesh into regions by spectral clustering of an affinity, as many as stay compact (Tena et al. 2011, 4.2)."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import eigh

from facewright.errors import DegenerateError, ValueRangeError
from facewright.mesh.connectivity import unique_edges
from facewright.numeric.check import check_finite, check_indices, check_shape

Progress = Callable[[str, int, int], None]

RESTARTS = 20
MAX_REGIONS = 40
#: Share of a cluster's vertices that may lie in no triangle of it, as ragged borders leave them; they join neighbours.
RAGGED_SHARE = 0.2
_ROUNDS = 10


@dataclass(frozen=True, eq=False)
class Clustering:
    """One clustering of N vertices.

    Parameters
    ----------
    labels : ndarray of shape (N,), int32
        Cluster of each vertex, from 0; clusters are numbered from the top of the mesh to its bottom.
    scatter : float
        Sum of squared distances of the embedded vertices from their cluster's centre.
    moved : ndarray of shape (L,), int32
        Vertices in no triangle of their cluster that joined a neighbouring one.
    loose : ndarray of shape (K,), int32
        Clusters of which more vertices than tolerated lie in no triangle; the clustering is compact if there are none.
    """

    labels: NDArray[np.int32]
    scatter: float
    moved: NDArray[np.int32]
    loose: NDArray[np.int32]

    @property
    def n_clusters(self) -> int:
        """Number of clusters k."""
        return int(self.labels.max()) + 1

    @property
    def compact(self) -> bool:
        """Whether every cluster is compact."""
        return len(self.loose) == 0


@dataclass(frozen=True, eq=False)
class Segmentation:
    """What `segment_regions` found.

    Parameters
    ----------
    chosen : Clustering
        The last one before the first that is not compact.
    refused : Clustering or None
        The first that is not compact; None if k was given or the limit was reached.
    """

    chosen: Clustering
    refused: Clustering | None


def segment_regions(
    affinity: NDArray[np.floating[Any]],
    vertices: NDArray[np.floating[Any]],
    faces: NDArray[np.integer[Any]],
    rng: np.random.Generator,
    *,
    n_regions: int | None = None,
    restarts: int = RESTARTS,
    max_regions: int = MAX_REGIONS,
    ragged_share: float = RAGGED_SHARE,
    progress: Progress | None = None,
) -> Segmentation:
    """Raise k from 2 until a cluster is not compact, and keep k - 1 clusters.

    "A cluster is defined as non-compact if some of its vertices do not form triangles on the template mesh." Taken by
    the letter, one vertex at a ragged border ends the search; here such vertices join a neighbouring cluster, unless
    they are more than `ragged_share` of theirs. With a share of zero the letter holds.

    Parameters
    ----------
    affinity : ndarray of shape (N, N), float64
        A of eq. (12), symmetric, not negative.
    vertices : ndarray of shape (N, 3), millimetres
        The template at rest; orders the clusters.
    faces : ndarray of shape (F, 3), int
        Its triangles.
    rng : numpy.random.Generator
        Seeds of k-means.
    n_regions : int, optional
        Exactly so many clusters, compact or not.
    restarts : int
        Runs of k-means for each k, of which the one of least scatter counts.
    max_regions : int
        Where to stop at the latest.
    ragged_share : float in [0, 1)
        Share of a cluster's vertices that may be without a triangle of it.
    progress : callable, optional
        Called with stage, done, total.

    Raises
    ------
    ShapeError, ValueRangeError
        If shapes do not match, values are negative or not finite, or there are more clusters than vertices.
    DegenerateError
        If already two clusters are not compact.
    """
    N = check_shape("affinity", affinity, "N", "N")["N"]
    check_shape("vertices", vertices, N, 3)
    check_indices("faces", faces, N)
    largest = max_regions if n_regions is None else n_regions
    if n_regions is not None and not 1 <= n_regions <= N:
        raise ValueRangeError(f"n_regions must lie between 1 and the number of vertices, {N}, got {n_regions}.")
    if restarts < 1 or largest < 1:
        raise ValueRangeError(f"restarts and max_regions must be at least 1, got {restarts} and {max_regions}.")
    if not 0.0 <= ragged_share < 1.0:
        raise ValueRangeError(f"ragged_share must lie in [0, 1), got {ragged_share}.")
    largest = min(largest, N)
    eigenvectors = normalised_eigenvectors(affinity, largest)
    seed = int(rng.integers(2**30))  # k clusters are the same whether they were asked for or come up in the search
    if n_regions is not None:
        return Segmentation(
            _cluster(eigenvectors[:, :n_regions], vertices, faces, seed + n_regions, restarts, ragged_share), None
        )
    chosen: Clustering | None = None
    for k in range(2, largest + 1):
        if progress is not None:
            progress("clustering", k, largest)
        clustering = _cluster(eigenvectors[:, :k], vertices, faces, seed + k, restarts, ragged_share)
        if not clustering.compact:
            if chosen is None:
                raise DegenerateError(
                    "two clusters are already not compact, some of their vertices have no triangle in them: give more "
                    "frames, a lower threshold, or the number of regions."
                )
            return Segmentation(chosen, clustering)
        chosen = clustering
    if chosen is None:
        raise ValueRangeError(f"max_regions must be at least 2 and the mesh have as many vertices, got {largest}.")
    return Segmentation(chosen, None)


def normalised_eigenvectors(affinity: NDArray[np.floating[Any]], count: int) -> NDArray[np.float64]:
    """Return the largest eigenvectors (N, count) of D^-1/2 A D^-1/2, most first, the diagonal of A zero.

    Ng, Jordan, Weiss, On Spectral Clustering, 2001, steps 1 to 3; D is the diagonal of A's row sums.

    Raises
    ------
    ShapeError, ValueRangeError
        If `affinity` is not square and symmetric, not finite, negative, or a vertex has affinity to no other.
    """
    N = check_shape("affinity", affinity, "N", "N")["N"]
    check_finite("affinity", affinity)
    A = np.array(affinity, dtype=np.float64)
    if (A < 0).any() or np.abs(A - A.T).max() > 1e-9 * max(float(A.max()), 1e-300):
        raise ValueRangeError("affinity must be symmetric and not negative.")
    np.fill_diagonal(A, 0.0)
    degree = A.sum(axis=1)
    if (degree <= 0).any():
        raise ValueRangeError(
            f"every vertex must have affinity to another, got {int((degree <= 0).sum())} of {N} that have none: "
            "lower the threshold of the correlation, or let distance count."
        )
    scale = 1.0 / np.sqrt(degree)
    L = scale[:, None] * A * scale
    vectors = eigh(L, subset_by_index=(N - count, N - 1))[1]
    return np.ascontiguousarray(vectors[:, ::-1])


def lonely_vertices(labels: NDArray[np.integer[Any]], faces: NDArray[np.integer[Any]]) -> NDArray[np.int32]:
    """Return the vertices without a triangle whose corners are all of their cluster, increasing, int32.

    "A cluster is defined as non-compact if some of its vertices do not form triangles on the template mesh."
    """
    of_corner = np.asarray(labels)[faces]
    within = (of_corner == of_corner[:, :1]).all(axis=1)
    joined = np.zeros(len(labels), dtype=bool)
    joined[np.asarray(faces)[within]] = True
    return np.flatnonzero(~joined).astype(np.int32)


def cluster_pieces(labels: NDArray[np.integer[Any]], faces: NDArray[np.integer[Any]]) -> NDArray[np.int32]:
    """Return of how many pieces, joined by edges, each cluster (k,) consists; compact ones may have several."""
    from scipy import sparse
    from scipy.sparse.csgraph import connected_components

    labels = np.asarray(labels)
    edges = unique_edges(faces)
    edges = edges[labels[edges[:, 0]] == labels[edges[:, 1]]]
    graph = sparse.coo_matrix((np.ones(len(edges)), edges.T), shape=(len(labels), len(labels)))
    _, piece = connected_components(graph, directed=False)
    k = int(labels.max()) + 1
    return np.array([len(np.unique(piece[labels == cluster])) for cluster in range(k)], dtype=np.int32)


def settle_lonely(
    labels: NDArray[np.integer[Any]], faces: NDArray[np.integer[Any]], ragged_share: float
) -> tuple[NDArray[np.int32], NDArray[np.int32]]:
    """Let lonely vertices join a neighbouring cluster (one at a corner of the mesh may find no triangle in any).

    Parameters
    ----------
    labels : ndarray of shape (N,), int
        Clusters 0 to k - 1.
    faces : ndarray of shape (F, 3), int
    ragged_share : float in [0, 1)
        Clusters that would lose more of their vertices keep them, and are loose.

    Returns
    -------
    labels : ndarray of shape (N,), int32
    loose : ndarray of shape (K,), int32
        Clusters that are not compact.
    """
    given = np.asarray(labels, dtype=np.int32)
    sizes = np.bincount(given)
    settled = given.copy()
    keeps = np.zeros(len(sizes), dtype=bool)
    for _ in range(_ROUNDS):
        lonely = lonely_vertices(settled, faces)
        lost = np.bincount(given[np.union1d(lonely, np.flatnonzero(settled != given))], minlength=len(sizes))
        newly = (lost > ragged_share * sizes) & ~keeps
        if newly.any():  # begin again, without touching those
            keeps |= newly
            settled = given.copy()
            continue
        lonely = lonely[~keeps[settled[lonely]]]
        if not len(lonely):
            break
        for vertex in lonely:
            settled[vertex] = _neighbouring_cluster(int(vertex), settled, faces)
    return settled, np.flatnonzero(keeps).astype(np.int32)


def _neighbouring_cluster(vertex: int, labels: NDArray[np.int32], faces: NDArray[np.integer[Any]]) -> int:
    """Return the cluster that most of a vertex's triangles would lie in with it; else that of most neighbours."""
    around = np.asarray(faces)[(np.asarray(faces) == vertex).any(axis=1)]
    others = labels[around[around != vertex].reshape(-1, 2)]
    whole = others[others[:, 0] == others[:, 1], 0]
    return int(np.bincount(whole if len(whole) else others.ravel()).argmax()) if len(others) else int(labels[vertex])


def _cluster(
    eigenvectors: NDArray[np.float64],
    vertices: NDArray[np.floating[Any]],
    faces: NDArray[np.integer[Any]],
    seed: int,
    restarts: int,
    ragged_share: float,
) -> Clustering:
    """Run k-means on the rows of k eigenvectors (N, k), each row scaled to unit length (steps 4 to 6)."""
    from sklearn.cluster import KMeans
    from threadpoolctl import threadpool_limits

    rows = eigenvectors / np.maximum(np.linalg.norm(eigenvectors, axis=1, keepdims=True), 1e-300)
    with threadpool_limits(1):  # hundreds of points: threads only wait for each other
        means = KMeans(rows.shape[1], n_init=restarts, init="k-means++", random_state=seed).fit(rows)
    found = _from_top(means.labels_, vertices)
    labels, loose = settle_lonely(found, faces, ragged_share)
    return Clustering(labels, float(means.inertia_), np.flatnonzero(labels != found).astype(np.int32), loose)


def _from_top(labels: NDArray[np.integer[Any]], vertices: NDArray[np.floating[Any]]) -> NDArray[np.int32]:
    """Number clusters by the height of their middle, and of nearly equal heights from the subject's right."""
    found, compact = np.unique(labels, return_inverse=True)
    centres = np.array([np.asarray(vertices)[compact == c].mean(axis=0) for c in range(len(found))])
    order = np.lexsort((centres[:, 0], -np.round(centres[:, 1] / 5.0)))
    number = np.empty(len(found), dtype=np.int32)
    number[order] = np.arange(len(found))
    return number[compact]
