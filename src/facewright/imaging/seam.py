"""The least visible seam between two aligned pictures: a minimal cut through the band where it may run."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import binary_dilation, gaussian_filter
from scipy.sparse import coo_array
from scipy.sparse.csgraph import breadth_first_order, maximum_flow

from facewright.errors import DegenerateError, ValueRangeError
from facewright.imaging.poisson import mask_box
from facewright.numeric.check import check_shape

#: Pixels of the band that are cut at once; larger bands are cut at half the size and refined round the cut.
_MAX_NODES = 12_000
#: Pixels on either side of the coarser cut among which a finer one is sought.
_REFINE = 3
#: Capacity of an edge across which the pictures differ by one level; capacities are integers.
_PER_LEVEL = 16


def find_seam(
    a: NDArray[Any],
    b: NDArray[Any],
    inner: NDArray[np.bool_],
    outer: NDArray[np.bool_],
    *,
    level_free: bool = True,
    length_cost: float = 0.5,
) -> NDArray[np.bool_]:
    """Find the region that contains `inner`, stays within `outer`, and ends where two pictures agree best.

    Parameters
    ----------
    a, b : ndarray of shape (H, W, 3), uint8 or floats on the same scale 0 to 255
        Aligned pictures: one is seen inside the region, the other outside.
    inner, outer : ndarray of shape (H, W), bool
        Pixels that must be inside, and pixels that may be; the band between them holds the seam.
    level_free : bool
        Do not count what the pictures differ by on average along the band: blending of gradients takes it away.
    length_cost : float
        Cost of each pixel of the seam's length, in levels of difference.

    Returns
    -------
    ndarray of shape (H, W), bool
        The region.

    Raises
    ------
    ShapeError
        If shapes do not match.
    ValueRangeError
        If a pixel of `inner` is not in `outer`.
    DegenerateError
        If `inner` is empty.

    Notes
    -----
    The cut's cost is the sum, over neighbours p and q on either side, of both pixels' differences, [1]_ eq. (1). Bands
    of more than 12,000 pixels are cut at half the size first, and again among the pixels near that cut [2]_.

    References
    ----------
    .. [1] Kwatra, Schoedl, Essa, Turk, Bobick, Graphcut textures, SIGGRAPH 2003, doi:10.1145/882262.882264.
    .. [2] Lombaert, Sun, Grady, Xu, A multilevel banded graph cuts method, ICCV 2005, doi:10.1109/ICCV.2005.13.
    """
    sizes = check_shape("a", a, "H", "W", 3)
    check_shape("b", b, "H", "W", 3, **sizes)
    inside, allowed = np.asarray(inner, dtype=np.bool_), np.asarray(outer, dtype=np.bool_)
    check_shape("inner", inside, "H", "W", **sizes)
    check_shape("outer", allowed, "H", "W", **sizes)
    if not inside.any():
        raise DegenerateError("inner must hold at least one pixel, got none.")
    if (inside & ~allowed).any():
        raise ValueRangeError(f"inner must lie within outer, got {int((inside & ~allowed).sum())} pixels that do not.")
    region = np.zeros_like(inside)
    box = mask_box(allowed)
    difference = a[box].astype(np.float32) - b[box].astype(np.float32)
    band = allowed[box] & ~inside[box]
    if level_free and band.any():
        difference -= np.median(difference[band], axis=0)
    # single pixels of noise are no reason for a detour
    cost = gaussian_filter(np.abs(difference).mean(axis=2), 0.7) + length_cost / 2
    region[box] = _cut_by_levels(cost, inside[box], allowed[box])
    return region


def _cut_by_levels(cost: NDArray[np.float32], inner: NDArray[np.bool_], outer: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Cut the band at once if it is small, else at half the size and then near that cut."""
    if int((outer & ~inner).sum()) <= _MAX_NODES:
        return _cut(cost, inner, outer)
    height, width = cost.shape
    odd = [(0, height % 2), (0, width % 2)]
    fours = ((height + 1) // 2, 2, (width + 1) // 2, 2)
    coarse_inner = np.pad(inner, odd).reshape(fours).any(axis=(1, 3))
    coarse_outer = np.pad(outer, odd).reshape(fours).any(axis=(1, 3))
    coarse_cost = np.pad(cost, odd, mode="edge").reshape(fours).mean(axis=(1, 3))
    coarse = _cut_by_levels(coarse_cost, coarse_inner, coarse_outer)
    guess = np.kron(coarse, np.ones((2, 2), np.bool_))[:height, :width]
    near = binary_dilation(guess, iterations=_REFINE) & binary_dilation(~guess, iterations=_REFINE)
    return _cut(cost, inner | (outer & guess & ~near), inner | (outer & (guess | near)))


def _cut(cost: NDArray[np.float32], inner: NDArray[np.bool_], outer: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Minimal cut between `inner` and what is not in `outer`."""
    band = outer & ~inner
    n = int(band.sum())
    node = np.full(band.shape, n + 1)  # the sink: all that is outside
    node[band] = np.arange(n)
    node[inner] = n  # the source
    tails, heads, capacities = [], [], []
    for first, second in (
        ((slice(None), slice(None, -1)), (slice(None), slice(1, None))),
        ((slice(None, -1), slice(None)), (slice(1, None), slice(None))),
    ):
        p, q = node[first].ravel(), node[second].ravel()
        capacity = np.rint(_PER_LEVEL * (cost[first] + cost[second])).astype(np.int32).ravel()
        joined = (p != q) & ((p < n) | (q < n))
        tails += [p[joined], q[joined]]
        heads += [q[joined], p[joined]]
        capacities += [capacity[joined]] * 2
    graph = coo_array(
        (np.concatenate(capacities), (np.concatenate(tails), np.concatenate(heads))), shape=(n + 2, n + 2)
    ).tocsr()
    graph.sum_duplicates()
    graph = graph.astype(np.int32)
    flow = maximum_flow(graph, n, n + 1).flow
    left = (graph - flow).tocsr()
    left.data[left.data < 0] = 0
    left.eliminate_zeros()
    reached = np.zeros(n + 2, np.bool_)
    reached[breadth_first_order(left, n, return_predecessors=False)] = True
    reached[n + 1] = False
    return np.asarray(reached[node])
