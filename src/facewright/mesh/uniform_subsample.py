"""A coarse mesh of some of a mesh's vertices, evenly spread along the surface: geodesic Voronoi cells, their dual."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy import sparse
from scipy.sparse.csgraph import dijkstra

from facewright.errors import TopologyError, ValueRangeError
from facewright.mesh.areas import face_areas, vertex_areas
from facewright.mesh.connectivity import boundary_edges, boundary_loops, half_edges, unique_edges, vertex_components
from facewright.mesh.geodesics import path_graph
from facewright.numeric.check import check_finite, check_indices, check_shape

_ROUNDS = 25
_BORDER_DENSITIES = (1.0, 0.9, 1.1, 0.8, 1.25, 0.7, 1.5)  # tried in turn: spacing on borders
_BESIDE = 0.55  # least distance of other vertices from a border, in spacings
_OPENING = 0.75  # spacing round openings, where shape matters most, relative to the rest
_CORNER_DEGREES = 50.0
#: Within so many spacings a border is straightened before its corners are sought.
_CORNER_REACH = 0.6


class Subsample(NamedTuple):
    """A coarse mesh: the fine mesh's vertices it keeps, (n,) int32, increasing; triangles among them, (F, 3) int32."""

    vertex_ids: NDArray[np.int32]
    faces: NDArray[np.int32]


def subsample_mesh(
    vertices: NDArray[np.floating[Any]],
    faces: NDArray[np.integer[Any]],
    n: int = 397,
    *,
    within: NDArray[np.bool_] | None = None,
    mirror: NDArray[np.integer[Any]] | None = None,
    avoid: NDArray[np.bool_] | None = None,
) -> Subsample:
    """Choose `n` vertices spread evenly along a surface and join them to a mesh with the same openings.

    Borders (of the mouth, the eyes, the outline) are divided evenly and keep their corners; the rest starts as farthest
    points and is moved to the centres of its geodesic Voronoi cells (Lloyd). Three cells that meet give a triangle, so
    that the mesh never bridges an opening. With `mirror` one half is treated, the middle line as a border, and
    mirrored: vertices and triangles are then symmetric.

    Parameters
    ----------
    vertices : ndarray of shape (V, 3), millimetres
        The fine mesh.
    faces : ndarray of shape (F, 3), int
        Its triangles.
    n : int
        How many vertices to keep.
    within : ndarray of shape (V,), bool, optional
        Only triangles whose corners all lie here.
    mirror : ndarray of shape (V,), int, optional
        Mirror image of each vertex across x = 0; ignored where triangles cross the middle or `within` is not
        symmetric.
    avoid : ndarray of shape (V,), bool, optional
        Vertices that are part of the surface but not to be kept (insides of nostrils).

    Returns
    -------
    Subsample
        Vertex numbers and triangles.

    Raises
    ------
    ShapeError, ValueRangeError
        If arrays do not match, or `n` is not within what borders need and vertices there are.
    TopologyError
        If the surface is not one connected piece.
    """
    points, triangles, ids = _surface(vertices, faces, within)
    skip = np.zeros(len(ids), dtype=bool) if avoid is None else np.asarray(avoid, dtype=bool)[ids]
    if not 4 <= n <= len(ids):
        raise ValueRangeError(f"n must lie in [4, {len(ids)}], the surface's vertices, got {n}.")
    opening = _openings(points, triangles)
    across = _local_mirror(ids, mirror, len(vertices))
    side = None if across is None else _half(points, triangles, across)
    if side is None or across is None:
        chosen, coarse = _sample(points, triangles, n, skip, opening)
    else:
        chosen, coarse = _sample_half(points, triangles, n, skip, opening, across, side)
    order = np.argsort(ids[chosen])
    rank = np.argsort(order)
    return Subsample(ids[chosen][order].astype(np.int32), rank[coarse].astype(np.int32))


def subsample_mirror(
    vertex_ids: NDArray[np.integer[Any]], mirror: NDArray[np.integer[Any]] | None
) -> NDArray[np.int32] | None:
    """Return which kept vertex each kept vertex has as its mirror image, (n,), or None where one is not kept."""
    if mirror is None:
        return None
    place = np.full(len(mirror), -1, dtype=np.int32)
    place[vertex_ids] = np.arange(len(vertex_ids))
    found = place[mirror[vertex_ids]]
    return None if (found < 0).any() else found


def _surface(
    vertices: NDArray[Any], faces: NDArray[Any], within: NDArray[np.bool_] | None
) -> tuple[NDArray[np.float64], NDArray[np.int64], NDArray[np.int64]]:
    """Return the vertices and triangles within, renumbered, and the vertices' numbers in the whole mesh."""
    V = check_shape("vertices", vertices, "V", 3)["V"]
    check_shape("faces", faces, "F", 3)
    check_indices("faces", faces, V)
    check_finite("vertices", vertices)
    kept = np.asarray(faces, dtype=np.int64)
    if within is not None:
        check_shape("within", within, V)
        kept = kept[np.asarray(within, dtype=bool)[kept].all(axis=1)]
    ids = np.unique(kept)
    place = np.zeros(V, dtype=np.int64)
    place[ids] = np.arange(len(ids))
    triangles = place[kept]
    pieces = int(vertex_components(triangles, len(ids)).max(initial=-1)) + 1
    if pieces != 1:
        raise TopologyError(f"the surface must be one connected piece, got {pieces}; give one piece in `within`.")
    return np.asarray(vertices, dtype=np.float64)[ids], triangles, ids


def _openings(points: NDArray[np.float64], triangles: NDArray[np.int64]) -> NDArray[np.bool_]:
    """Return the vertices of all borders but the longest, the outline."""
    found = np.zeros(len(points), dtype=bool)
    loops = sorted(boundary_loops(triangles), key=lambda loop: _length(points, np.append(loop, loop[0])))
    for loop in loops[:-1]:
        found[loop] = True
    return found


def _local_mirror(ids: NDArray[np.int64], mirror: NDArray[Any] | None, V: int) -> NDArray[np.int64] | None:
    if mirror is None:
        return None
    check_shape("mirror", mirror, V)
    place = np.full(V, -1, dtype=np.int64)
    place[ids] = np.arange(len(ids))
    across = place[np.asarray(mirror)[ids]]
    return None if (across < 0).any() else across


def _half(
    points: NDArray[np.float64], triangles: NDArray[np.int64], across: NDArray[np.int64]
) -> NDArray[np.int8] | None:
    """Return the side of each vertex: 0 in the middle, 1 left (+x), -1 right; None where the halves do not part."""
    side = np.sign(points[:, 0]).astype(np.int8)
    side[across == np.arange(len(across))] = 0
    corners = side[triangles]
    crossing = (corners.max(axis=1) > 0) & (corners.min(axis=1) < 0)
    flat = (corners == 0).all(axis=1)
    paired = (side[across] == -side).all() and (side == 1).sum() == (side == -1).sum()
    return None if crossing.any() or flat.any() or not paired or not (side == 0).any() else side


def _sample_half(
    points: NDArray[np.float64],
    triangles: NDArray[np.int64],
    n: int,
    skip: NDArray[np.bool_],
    opening: NDArray[np.bool_],
    across: NDArray[np.int64],
    side: NDArray[np.int8],
) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Sample the left half and mirror it."""
    half = np.flatnonzero(side >= 0)
    place = np.full(len(points), -1, dtype=np.int64)
    place[half] = np.arange(len(half))
    inside = triangles[(side[triangles] >= 0).all(axis=1)]
    chosen, coarse = _sample(points[half], place[inside], n, skip[half], opening[half], middle=side[half] == 0)
    chosen = half[chosen]
    off = side[chosen] > 0
    both = np.concatenate([chosen, across[chosen[off]]])
    image = np.arange(len(chosen))
    image[off] = len(chosen) + np.arange(int(off.sum()))
    return both, np.concatenate([coarse, image[coarse][:, ::-1]])


def _sample(
    points: NDArray[np.float64],
    triangles: NDArray[np.int64],
    n: int,
    skip: NDArray[np.bool_],
    opening: NDArray[np.bool_],
    middle: NDArray[np.bool_] | None = None,
) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Return n vertices and triangles among them; those of the `middle` count once, all others twice, where given."""
    twice = middle is not None
    is_middle = np.zeros(len(points), dtype=bool) if middle is None else middle
    area = float(face_areas(points, triangles).sum()) * (2.0 if twice else 1.0)
    spacing = float(np.sqrt(2.0 / np.sqrt(3.0) * area / n))
    loops = boundary_loops(triangles)
    graph = path_graph(points, triangles)
    areas = vertex_areas(points, triangles)
    on_border = np.zeros(len(points), dtype=bool)
    for loop in loops:
        on_border[loop] = True
    # nearer ones would break into the border between two of its vertices
    beside = np.full(len(points), np.inf)
    if on_border.any():
        beside = dijkstra(graph, directed=False, indices=np.flatnonzero(on_border), min_only=True)
    for density in _BORDER_DENSITIES:
        border = _border_samples(points, loops, is_middle, opening, density * spacing, n if twice else None)
        count = int(is_middle[border].sum())
        free = (n - 2 * len(border) + count) // 2 if twice else n - len(border)
        allowed = ~(skip | (beside < _BESIDE * density * spacing))
        if not 0 <= free <= int(allowed.sum()) or (twice and (n - count) % 2):
            continue
        chosen = _farthest(graph, border, free, allowed)
        chosen = _relax(points, areas, graph, chosen, len(border), allowed)
        coarse = _dual(points, triangles, _cells(graph, chosen), len(chosen))
        if coarse is not None:
            return chosen, coarse
    raise ValueRangeError(
        f"n must be enough for the borders and far below the number of vertices, got {n} of {len(points)}."
    )


def _border_samples(
    points: NDArray[np.float64],
    loops: list[NDArray[np.int64]],
    middle: NDArray[np.bool_],
    opening: NDArray[np.bool_],
    spacing: float,
    like: int | None,
) -> NDArray[np.int64]:
    """Divide all borders evenly; the middle line's count is even or odd as `like` is, where given."""
    if not loops:
        return np.empty(0, dtype=np.int64)
    points = _smooth_borders(points, loops, spacing)
    stretches = [stretch for loop in loops for stretch in _stretches(points, loop, middle, spacing)]
    fine = [_OPENING if opening[stretch].all() else 1.0 for stretch in stretches]
    wanted = [_length(points, s) / (f * spacing) for s, f in zip(stretches, fine, strict=True)]
    counts = [max(1, round(w)) for w in wanted]

    def samples() -> NDArray[np.int64]:
        return np.unique(np.concatenate([_divide(points, s, c) for s, c in zip(stretches, counts, strict=True)]))

    chosen = samples()
    inner = [k for k, stretch in enumerate(stretches) if middle[stretch].all()]
    if like is not None and inner and (int(middle[chosen].sum()) - like) % 2:
        counts[max(inner, key=lambda k: wanted[k] - counts[k])] += 1
        chosen = samples()
    return chosen


def _smooth_borders(points: NDArray[np.float64], loops: list[NDArray[np.int64]], spacing: float) -> NDArray[np.float64]:
    """Return the vertices with zigzag borders smoothed over half a spacing, so that their length means something."""
    smooth = points.copy()
    for loop in loops:
        curve = points[loop]
        step = float(np.linalg.norm(np.roll(curve, -1, axis=0) - curve, axis=1).mean())
        reach = max(1, round(0.3 * spacing / max(step, 1e-9)))
        smooth[loop] = sum(np.roll(curve, k, axis=0) for k in range(-reach, reach + 1)) / (2 * reach + 1)
    return smooth


def _stretches(
    points: NDArray[np.float64], loop: NDArray[np.int64], middle: NDArray[np.bool_], spacing: float
) -> list[NDArray[np.int64]]:
    """Cut a closed border where it turns sharply and where it meets the middle line; ends are in both stretches."""
    before, after = np.roll(loop, 1), np.roll(loop, -1)
    cut = middle[loop] & ~(middle[before] & middle[after])
    cut |= _corners(points[loop], spacing) & ~middle[loop]
    at = np.flatnonzero(cut)
    if not len(at):
        at = np.array([0])
    if len(at) == 1:  # a closed curve needs two ends
        at = np.sort(np.array([at[0], (at[0] + len(loop) // 2) % len(loop)]))
    ends = np.append(at[1:], at[0] + len(loop))
    return [np.take(loop, np.arange(a, b + 1), mode="wrap") for a, b in zip(at, ends, strict=True)]


def _corners(curve: NDArray[np.float64], spacing: float) -> NDArray[np.bool_]:
    """Return where a closed curve turns by more than `_CORNER_DEGREES` over about a spacing, sharpest only."""
    steps = np.linalg.norm(np.roll(curve, -1, axis=0) - curve, axis=1)
    along = np.concatenate([[0.0], np.cumsum(steps)[:-1]])
    total, reach = float(steps.sum()), _CORNER_REACH * spacing

    def at(s: NDArray[np.float64]) -> NDArray[np.float64]:
        return np.stack([np.interp(s, along, curve[:, k], period=total) for k in range(3)], axis=1)

    back, ahead = curve - at(along - reach), at(along + reach) - curve
    cosine = (back * ahead).sum(axis=1) / np.maximum(
        np.linalg.norm(back, axis=1) * np.linalg.norm(ahead, axis=1), 1e-12
    )
    turn = np.degrees(np.arccos(np.clip(cosine, -1.0, 1.0)))
    gap = np.abs(along[:, None] - along[None])
    near = np.minimum(gap, total - gap) < 1.5 * reach
    order = turn - 1e-9 * np.arange(len(turn))
    sharpest = order >= np.where(near, order[None], -np.inf).max(axis=1)
    return np.asarray((turn > _CORNER_DEGREES) & sharpest & (total > 6 * reach))


def _length(points: NDArray[np.float64], path: NDArray[np.int64]) -> float:
    return float(np.linalg.norm(np.diff(points[path], axis=0), axis=1).sum())


def _divide(points: NDArray[np.float64], path: NDArray[np.int64], count: int) -> NDArray[np.int64]:
    """Return the path's vertices nearest to `count` equal parts, ends included."""
    along = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(points[path], axis=0), axis=1))])
    wanted = np.linspace(0.0, along[-1], count + 1)
    return np.asarray(path[np.abs(along[:, None] - wanted).argmin(axis=0)])


def _farthest(
    graph: sparse.csr_matrix, start: NDArray[np.int64], free: int, allowed: NDArray[np.bool_]
) -> NDArray[np.int64]:
    """Add the vertex farthest from all chosen ones, again and again; the order of the start is kept."""
    chosen = [int(i) for i in start]
    if not chosen:
        chosen, free = [int(np.flatnonzero(allowed)[0])], free - 1
    distance = dijkstra(graph, directed=False, indices=chosen, min_only=True)
    for _ in range(free):
        following = int(np.where(allowed, distance, -1.0).argmax())
        chosen.append(following)
        near = dijkstra(graph, directed=False, indices=following, limit=float(distance[following]) + 1e-9)
        distance = np.minimum(distance, near)
    return np.array(chosen, dtype=np.int64)


def _cells(graph: sparse.csr_matrix, chosen: NDArray[np.int64]) -> NDArray[np.int64]:
    """Return which chosen vertex is nearest to each vertex along the surface, (V,)."""
    sources = dijkstra(graph, directed=False, indices=chosen, min_only=True, return_predecessors=True)[2]
    place = np.zeros(graph.shape[0], dtype=np.int64)
    place[chosen] = np.arange(len(chosen))
    return np.asarray(place[sources])


def _relax(
    points: NDArray[np.float64],
    areas: NDArray[np.float64],
    graph: sparse.csr_matrix,
    chosen: NDArray[np.int64],
    n_fixed: int,
    allowed: NDArray[np.bool_],
) -> NDArray[np.int64]:
    """Move all but the first `n_fixed` vertices to the centres of their cells."""
    for _ in range(_ROUNDS):
        labels = _cells(graph, chosen)
        weight = np.bincount(labels, areas, minlength=len(chosen))
        centre = np.stack([np.bincount(labels, areas * points[:, k], minlength=len(chosen)) for k in range(3)], axis=1)
        centre = centre / np.maximum(weight, 1e-12)[:, None]
        off = np.linalg.norm(points - centre[labels], axis=1)
        candidates = np.flatnonzero(allowed & (labels >= n_fixed))
        order = candidates[np.lexsort((off[candidates], labels[candidates]))]
        cells, first = np.unique(labels[order], return_index=True)
        moved = chosen.copy()
        moved[cells] = order[first]
        if np.array_equal(moved, chosen):
            break
        chosen = moved
    return chosen


def _dual(
    points: NDArray[np.float64], triangles: NDArray[np.int64], labels: NDArray[np.int64], size: int
) -> NDArray[np.int64] | None:
    """Return one triangle for every three cells that meet, or None if that leaves a vertex out or changes openings."""
    corners = labels[triangles]
    meet = (corners[:, 0] != corners[:, 1]) & (corners[:, 1] != corners[:, 2]) & (corners[:, 2] != corners[:, 0])
    corners = corners[meet]
    turn = np.argmin(corners, axis=1)
    found = np.unique(np.take_along_axis(corners, (turn[:, None] + np.arange(3)) % 3, axis=1), axis=0)
    directed = half_edges(found)
    manifold = len(np.unique(directed[:, 0] * size + directed[:, 1])) == len(directed)
    border = boundary_edges(found)
    manifold &= len(np.unique(border[:, 0])) == len(border)
    good = manifold and len(np.unique(found)) == size and _euler(found, size) == _euler(triangles, len(points))
    return found if good else None


def _euler(faces: NDArray[np.int64], n_vertices: int) -> int:
    """Return vertices - edges + triangles, which tells a surface's openings."""
    return n_vertices - len(unique_edges(faces)) + len(faces)
