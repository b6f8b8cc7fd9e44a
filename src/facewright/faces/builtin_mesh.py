"""From the control cage of the built-in face to its dense mesh: fine where people look, coarser behind."""

from __future__ import annotations

import itertools
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy import sparse

from facewright.mesh.subdivide import subdivide_catmull_clark

SKIN_PARTS = ("face", "head_and_neck", "mouth_cavity")


class ControlMesh(NamedTuple):
    """The dense skin and mouth cavity as a linear function of the cage.

    Parameters
    ----------
    matrix : scipy.sparse.csr_matrix of shape (V, C)
        Dense vertices = matrix @ cage vertices; rows sum to one.
    quads : ndarray of shape (Q, 4), int32
        Quads, and triangles (padded by -1) where fine and coarse faces meet.
    mirror : ndarray of shape (V,), int32
        Mirror image of each vertex.
    parts : dict of str to (start, stop)
        Vertex ranges of ``face``, ``head_and_neck`` and ``mouth_cavity``.
    fine_index : ndarray of shape (V,), int32
        Index of each vertex in the twice subdivided cage.
    """

    matrix: sparse.csr_matrix
    quads: NDArray[np.int32]
    mirror: NDArray[np.int32]
    parts: dict[str, tuple[int, int]]
    fine_index: NDArray[np.int32]


def build_control_mesh(
    cage_faces: NDArray, n_cage: int, is_fine: NDArray[np.bool_], part: NDArray, cage_mirror: NDArray
) -> ControlMesh:
    """Subdivide the cage twice; keep both levels where `is_fine`, the first level elsewhere.

    Parameters
    ----------
    cage_faces : ndarray of shape (F, 4), int
        Quads, -1 pads a triangle.
    n_cage : int
        Number of cage vertices C.
    is_fine : ndarray of shape (F,), bool
        Faces that keep sixteen quads each; the others keep four, taken at the same positions, so nothing cracks.
    part : ndarray of shape (F,), int
        Index into `SKIN_PARTS`; a vertex belongs to the first part that uses it.
    cage_mirror : ndarray of shape (C,), int
        Mirror image of each cage vertex.

    Returns
    -------
    ControlMesh
        Vertices ordered by part.
    """
    first = subdivide_catmull_clark(cage_faces, n_cage)
    n_first = first.matrix.shape[0]
    second = subdivide_catmull_clark(first.faces, n_first)
    matrix = (second.matrix @ first.matrix).tocsr()
    fine_of_first = is_fine[first.parents]

    fine = second.faces[fine_of_first[second.parents]]
    dense_mirror = _dense_mirror(first.edges, second.edges, first.faces, cage_faces, cage_mirror)
    key = np.minimum(np.arange(len(dense_mirror)), dense_mirror)  # what mirror images share
    coarse, coarse_parent = _stitch(first.faces, fine_of_first, second.edges, n_first, key)
    parents = np.concatenate([first.parents[second.parents[fine_of_first[second.parents]]],
                              first.parents[coarse_parent]])  # fmt: skip
    quads = np.concatenate([fine, coarse])

    owner = np.full(matrix.shape[0], len(SKIN_PARTS))
    for k in range(4):
        used = quads[:, k] >= 0
        np.minimum.at(owner, quads[used, k], part[parents[used]])
    order = np.argsort(owner, kind="stable")[: int((owner < len(SKIN_PARTS)).sum())]
    new_index = np.full(matrix.shape[0] + 1, -1)  # the last entry keeps the padding
    new_index[order] = np.arange(len(order))
    stops = np.searchsorted(owner[order], np.arange(len(SKIN_PARTS)), side="right")
    starts = np.concatenate([[0], stops[:-1]])
    mirror = new_index[dense_mirror[order]]
    return ControlMesh(
        matrix[order],
        new_index[quads].astype(np.int32),
        mirror.astype(np.int32),
        {name: (int(a), int(b)) for name, a, b in zip(SKIN_PARTS, starts, stops)},
        order.astype(np.int32),
    )


def _stitch(
    faces: NDArray[np.int32], is_fine: NDArray[np.bool_], edges: NDArray[np.int32], n: int, key: NDArray[np.int64]
) -> tuple[NDArray[np.int32], NDArray[np.int64]]:
    """Return the faces not subdivided further, with triangles where a side carries a point of a finer neighbour."""
    split = np.zeros(len(edges), bool)
    side_edge = edge_ids(faces, edges, n)
    split[side_edge[is_fine].ravel()] = True
    keep = np.flatnonzero(~is_fine)
    touched = split[side_edge[keep]].any(axis=1)
    out, parent = [faces[keep[~touched]]], [keep[~touched]]
    for f in keep[touched]:  # a few hundred faces along the border
        polygon: list[int] = []
        extra: list[int] = []
        for k in range(4):
            polygon.append(int(faces[f, k]))
            if split[side_edge[f, k]]:
                extra.append(n + int(side_edge[f, k]))
                polygon.append(extra[-1])
        start = polygon.index(min(extra, key=lambda v: key[v]))  # the same one on both halves of the face
        ring = polygon[start:] + polygon[:start]
        fan = [[ring[0], a, b, -1] for a, b in itertools.pairwise(ring[1:])]
        out.append(np.array(fan, np.int32))
        parent.append(np.full(len(fan), f))
    return np.concatenate(out).astype(np.int32), np.concatenate(parent)


def edge_ids(faces: NDArray, edges: NDArray[np.int32], n: int) -> NDArray[np.int64]:
    """Return for each side k of each quad the row of `edges` (sorted) joining corners k and k + 1."""
    ends = np.sort(np.stack([faces, np.roll(faces, -1, axis=1)], axis=-1).astype(np.int64), axis=-1)
    return np.searchsorted(edges.astype(np.int64) @ [n, 1], ends @ [n, 1])


def _dense_mirror(
    edges_1: NDArray[np.int32], edges_2: NDArray[np.int32], faces_1: NDArray, cage_faces: NDArray, mirror: NDArray
) -> NDArray[np.int64]:
    """Carry the cage's mirror map to the twice subdivided vertices."""
    level_1 = _mirror_step(np.asarray(cage_faces), edges_1, np.asarray(mirror, dtype=np.int64))
    return _mirror_step(np.asarray(faces_1), edges_2, level_1)


def _mirror_step(faces: NDArray, edges: NDArray[np.int32], mirror: NDArray[np.int64]) -> NDArray[np.int64]:
    n = len(mirror)
    codes = edges.astype(np.int64) @ [n, 1]
    edge_mirror = np.searchsorted(codes, np.sort(mirror[edges], axis=1) @ [n, 1])
    image = np.where(faces >= 0, mirror[faces], -1)
    rows = {tuple(r): k for k, r in enumerate(np.sort(faces, axis=1).tolist())}
    face_mirror = np.array([rows[tuple(r)] for r in np.sort(image, axis=1).tolist()], dtype=np.int64)
    return np.concatenate([mirror, n + edge_mirror, n + len(edges) + face_mirror])
