"""Smooth local weights on a dense surface."""

import numpy as np
import pytest

from facewright.errors import ShapeError, ValueRangeError
from facewright.models.dense_weights import SurfacePlaces, learned_weights, smooth_weights

SIDE = 31


def _plane(slit=False):
    """A square of 60 mm; with a slit along the middle row from column 8 to 22, whose sides touch."""
    y, x = np.mgrid[0:SIDE, 0:SIDE]
    grid = np.arange(SIDE * SIDE).reshape(SIDE, SIDE)
    vertices = np.stack([2.0 * x, 2.0 * y, 0.0 * x], -1).reshape(-1, 3)
    lower = grid.copy()
    if slit:
        lower[15, 9:22] = np.arange(13) + SIDE * SIDE
        vertices = np.concatenate([vertices, vertices[grid[15, 9:22]]])
    faces = []
    for row, one in ((slice(0, 15), grid), (slice(15, SIDE - 1), lower)):
        after = grid if one is grid else lower
        a, b = one[row, :-1].ravel(), one[row, 1:].ravel()
        d, c = after[row.start + 1 : row.stop + 1, :-1].ravel(), after[row.start + 1 : row.stop + 1, 1:].ravel()
        faces += [np.stack([a, b, c], 1), np.stack([a, c, d], 1)]
    return vertices, np.concatenate(faces)


def _points(step=5):
    grid = np.arange(SIDE * SIDE).reshape(SIDE, SIDE)
    return grid[::step, ::step].ravel()


def test_weights_reproduce_their_points_and_linear_motion():
    vertices, faces = _plane()
    ids = _points()
    W = smooth_weights(vertices, faces, SurfacePlaces.at_vertices(ids), np.zeros(0, np.intp))
    np.testing.assert_allclose(W[ids].toarray(), np.eye(len(ids)), atol=1e-2)
    np.testing.assert_allclose(np.asarray(W.sum(axis=1)).ravel(), 1.0, atol=5e-3)
    motion = vertices * [0.1, -0.05, 0.0] + [0.0, 0.0, 1.0]
    inner = (np.abs(vertices[:, :2] - 30) < 20).all(axis=1)
    np.testing.assert_allclose((W @ motion[ids])[inner], motion[inner], atol=0.06)


def test_weights_do_not_cross_an_opening():
    vertices, faces = _plane(slit=True)
    above, below = 14 * SIDE + 15, 16 * SIDE + 15  # 4 mm apart, the slit between them
    ids = _points()
    ids = np.unique(np.concatenate([ids[ids // SIDE != 15], [above, below]]))
    W = smooth_weights(vertices, faces, SurfacePlaces.at_vertices(ids), np.zeros(0, np.intp))
    motion = np.zeros((len(ids), 3))
    motion[ids == above, 1] = -5.0
    moved = W @ motion
    assert moved[15 * SIDE + 15, 1] < -2.0  # the slit's one side
    assert abs(moved[SIDE * SIDE + 6, 1]) < 1.0  # the other, at the same place


def test_still_vertices_stay_and_neighbours_differ_little():
    vertices, faces = _plane()
    ids = _points()[12:24]
    still = np.arange(SIDE)
    W = smooth_weights(vertices, faces, SurfacePlaces.at_vertices(ids), still)
    assert np.abs(W[still].toarray()).max() < 5e-3
    random = np.random.default_rng(0).normal(size=len(ids))
    field = (W @ random).reshape(SIDE, SIDE)
    step = np.abs(np.diff(field, axis=0)).max(), np.abs(np.diff(field, axis=1)).max()
    assert max(step) < 0.8  # ten times the spacing lies between points


def test_points_within_triangles_interpolate():
    vertices, faces = _plane()
    picked = faces[::40]
    share = np.random.default_rng(0).dirichlet(np.ones(3), len(picked))
    places = SurfacePlaces(picked.astype(np.intp), share)
    W = smooth_weights(vertices, faces, places, np.zeros(0, np.intp), support=20)
    values = places.of(vertices)
    found = places.of(W @ values)
    assert np.linalg.norm(found - values, axis=1).max() < 0.6
    assert np.linalg.norm(found - values, axis=1).mean() < 0.1


def test_learned_weights_come_nearer_to_the_shapes_and_stay_local(rng):
    vertices, faces = _plane()
    ids = _points()
    W = smooth_weights(vertices, faces, SurfacePlaces.at_vertices(ids), np.zeros(0, np.intp))
    centres = rng.uniform(10, 50, (8, 2))
    bumps = np.exp(-((vertices[None, :, :2] - centres[:, None]) ** 2).sum(-1) / (2 * 5.0**2))
    shapes = bumps[..., None] * rng.normal(size=(8, 1, 3)) * 10
    learned = learned_weights(W, shapes[:, ids], shapes)
    before, after = (
        np.sqrt(np.mean([((one @ shape[ids] - shape) ** 2).sum(axis=1) for shape in shapes])) for one in (W, learned)
    )
    assert after < 0.6 * before
    assert learned.nnz == W.nnz and np.abs(learned - W).max() < 0.5


def test_bad_input_is_refused():
    vertices, faces = _plane()
    places = SurfacePlaces.at_vertices(_points())
    with pytest.raises(ValueRangeError, match="support"):
        smooth_weights(vertices, faces, places, np.zeros(0, np.intp), support=0)
    with pytest.raises(ValueRangeError, match="still"):
        smooth_weights(vertices, faces, places, np.array([99999]))
    with pytest.raises(ValueRangeError, match="corners"):
        smooth_weights(vertices, faces, SurfacePlaces.at_vertices(np.array([99999])), np.zeros(0, np.intp))
    with pytest.raises(ShapeError):
        learned_weights(
            smooth_weights(vertices, faces, places, np.zeros(0, np.intp)), np.zeros((2, 3, 3)), np.zeros((2, 5, 3))
        )
