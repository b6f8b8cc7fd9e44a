"""Coarse meshes: as many vertices as asked for, even, symmetric, with the openings of the fine one."""

import numpy as np
import pytest

from facewright.errors import TopologyError, ValueRangeError
from facewright.mesh.connectivity import boundary_loops, unique_edges, vertex_adjacency
from facewright.mesh.normals import face_area_vectors
from facewright.mesh.uniform_subsample import subsample_mesh, subsample_mirror


def _grid(n, hole=0.0, holes=((0.0, 0.0),)):
    """A square of 100 mm with n by n points and square holes, symmetric about x = 0."""
    line = np.linspace(-50.0, 50.0, n)
    x, y = np.meshgrid(line, line, indexing="ij")
    points = np.stack([x.ravel(), y.ravel(), 0.1 * np.cos(x.ravel() / 20.0)], axis=1)
    i = np.arange(n * n).reshape(n, n)
    a, b, c, d = (part.ravel() for part in (i[:-1, :-1], i[1:, :-1], i[1:, 1:], i[:-1, 1:]))
    faces = np.concatenate([np.stack([a, b, c], 1), np.stack([a, c, d], 1)])
    for at in holes:
        off = np.abs(points[faces].mean(axis=1)[:, :2] - at).max(axis=1)
        faces = faces[off > hole]
    mirror = i[::-1].ravel()
    return points, faces, mirror


def _openings(faces):
    return sorted(len(loop) for loop in boundary_loops(faces))


def test_even_symmetric_with_a_hole():
    points, faces, mirror = _grid(61, hole=15.0)
    ids, coarse = subsample_mesh(points, faces, 120, mirror=mirror)
    assert len(ids) == 120 and (np.diff(ids) > 0).all() and ids.dtype == coarse.dtype == np.int32
    assert len(_openings(coarse)) == 2
    edges = unique_edges(coarse)
    length = np.linalg.norm(points[ids][edges[:, 0]] - points[ids][edges[:, 1]], axis=1)
    assert length.std() / length.mean() < 0.25
    assert (face_area_vectors(points[ids], coarse)[:, 2] > 0).all()  # turned like the fine mesh
    partner = subsample_mirror(ids, mirror)
    assert np.array_equal(partner[partner], np.arange(120))
    assert np.allclose(points[ids][partner], points[ids] * [-1, 1, 1])
    image = {tuple(sorted(face)) for face in partner[coarse].tolist()}
    assert image == {tuple(sorted(face)) for face in coarse.tolist()}
    # nothing bridges the hole
    assert np.abs(points[ids][coarse].mean(axis=1)[:, :2]).max(axis=1).min() > 12.0


@pytest.mark.parametrize("n", [30, 31, 77, 200])
def test_any_number_without_mirror(n):
    points, faces, _ = _grid(41)
    ids, coarse = subsample_mesh(points, faces, n)
    assert len(ids) == n and len(np.unique(coarse)) == n
    assert n - len(unique_edges(coarse)) + len(coarse) == 1
    assert vertex_adjacency(coarse, n).sum(axis=1).min() >= 2


def test_corners_of_the_border_are_kept():
    points, faces, mirror = _grid(41)
    ids = subsample_mesh(points, faces, 80, mirror=mirror).vertex_ids
    corners = [0, 40, 41 * 40, 41 * 41 - 1]
    assert set(corners) <= set(ids.tolist())


def test_avoid_and_within():
    points, faces, _ = _grid(41)
    avoid = points[:, 0] > 10.0
    ids = subsample_mesh(points, faces, 60, avoid=avoid).vertex_ids
    inner = np.abs(points[ids]).max(axis=1) < 49.0
    assert not (avoid[ids] & inner).any()
    within = points[:, 1] <= 0.0
    ids = subsample_mesh(points, faces, 40, within=within).vertex_ids
    assert within[ids].all()


def test_closed_surface():
    rng = np.random.default_rng(0)
    points = rng.normal(size=(1500, 3))
    points *= 50.0 / np.linalg.norm(points, axis=1, keepdims=True)
    from scipy.spatial import ConvexHull

    hull = ConvexHull(points)
    faces = hull.simplices.copy()
    outward = np.einsum("fc,fc->f", face_area_vectors(points, faces), points[faces].mean(axis=1))
    faces[outward < 0] = faces[outward < 0][:, ::-1]
    ids, coarse = subsample_mesh(points, faces, 100)
    assert len(ids) == 100 and len(coarse) == 196  # 2 n - 4: a sphere


def test_refusals():
    points, faces, mirror = _grid(21)
    for n in (3, 442):
        with pytest.raises(ValueRangeError, match="n must"):
            subsample_mesh(points, faces, n)
    apart = np.concatenate([points, points + 500.0]), np.concatenate([faces, faces + len(points)])
    with pytest.raises(TopologyError, match="one connected piece, got 2"):
        subsample_mesh(*apart, 40)
    with pytest.raises(TopologyError, match="got 0"):
        subsample_mesh(points, faces, 40, within=np.zeros(len(points), bool))
    with pytest.raises(ValueRangeError):
        subsample_mesh(np.full_like(points, np.nan), faces, 40)
    with pytest.raises(ValueRangeError):
        subsample_mesh(points, faces + 1, 40)
    assert subsample_mirror(np.array([0, 5]), mirror) is None
    assert subsample_mirror(np.array([0]), None) is None
