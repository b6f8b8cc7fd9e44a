import importlib.util
from pathlib import Path

import numpy as np
import pytest

from facewright.errors import ShapeError, TopologyError, ValueRangeError
from facewright.mesh.subdivide import subdivide_catmull_clark

_spec = importlib.util.spec_from_file_location("reference_subdivide", Path(__file__).parent / "reference_subdivide.py")
reference = importlib.util.module_from_spec(_spec)
_spec.loader.exec_module(reference)

CUBE = [[0, 3, 2, 1], [4, 5, 6, 7], [0, 1, 5, 4], [1, 2, 6, 5], [2, 3, 7, 6], [3, 0, 4, 7]]
OPEN_MIX = [[0, 1, 2, 3], [1, 4, 5, 2], [4, 6, 5, -1], [3, 2, 5, 7]]


@pytest.mark.parametrize(("faces", "n"), [(CUBE, 8), (OPEN_MIX, 8), ([[0, 1, 2, 3]], 4), ([[0, 1, 2, -1]], 3)])
def test_one_step_equals_the_definition(faces, n, rng):
    points = rng.normal(size=(n, 3))
    step = subdivide_catmull_clark(faces, n)
    np.testing.assert_allclose(step.matrix @ points, reference.catmull_clark(points, faces), atol=1e-12)


def test_rows_sum_to_one_and_faces_keep_their_side(rng):
    step = subdivide_catmull_clark(CUBE, 8, levels=3)
    np.testing.assert_allclose(step.matrix.sum(axis=1), 1.0, atol=1e-12)
    assert len(step.faces) == 6 * 4**3 and (np.bincount(step.parents) == 4**3).all()
    directed = {(a, b) for q in step.faces.tolist() for a, b in zip(q, q[1:] + q[:1])}
    assert len(directed) == step.faces.size and all((b, a) in directed for a, b in directed)
    assert step.matrix.shape[0] - len(directed) // 2 + len(step.faces) == 2  # Euler, a sphere


def test_several_levels_are_single_steps_in_a_row(rng):
    points = rng.normal(size=(8, 3))
    first = subdivide_catmull_clark(OPEN_MIX, 8)
    second = subdivide_catmull_clark(first.faces, first.matrix.shape[0])
    both = subdivide_catmull_clark(OPEN_MIX, 8, levels=2)
    np.testing.assert_allclose(both.matrix @ points, second.matrix @ (first.matrix @ points), atol=1e-12)
    np.testing.assert_array_equal(both.faces, second.faces)


def test_affine_functions_are_kept_on_a_regular_grid(rng):
    n = 6
    grid = np.arange(n * n).reshape(n, n)
    quads = np.stack([grid[:-1, :-1], grid[:-1, 1:], grid[1:, 1:], grid[1:, :-1]], axis=-1).reshape(-1, 4)
    xy = np.stack(np.meshgrid(np.arange(n), np.arange(n)), axis=-1).reshape(-1, 2).astype(float)
    step = subdivide_catmull_clark(quads, n * n)
    inside = np.setdiff1d(np.arange(n * n), np.concatenate([grid[0], grid[-1], grid[:, 0], grid[:, -1]]))
    np.testing.assert_allclose((step.matrix @ xy)[inside], xy[inside], atol=1e-12)


def test_a_crease_makes_its_sides_independent(rng):
    quads = [[0, 1, 4, 3], [1, 2, 5, 4]]
    points = rng.normal(size=(6, 3))
    sharp = subdivide_catmull_clark(quads, 6, levels=2, creases=[[1, 4]])
    alone = subdivide_catmull_clark([[0, 1, 3, 2]], 4, levels=2)  # the left quad by itself, vertices 0 1 3 4
    left = sharp.parents == 0
    got = np.sort((sharp.matrix @ points)[np.unique(sharp.faces[left])], axis=0)
    # ends of the crease lie on the border with one crease edge more: they stay put in the pair, so compare the inside
    assert got.shape == np.unique(alone.faces).shape + (3,)
    far = points.copy()
    far[[2, 5]] += 10.0
    rows = np.setdiff1d(np.unique(sharp.faces[left]), np.unique(sharp.faces[~left]))
    np.testing.assert_allclose((sharp.matrix @ points)[rows], (sharp.matrix @ far)[rows], atol=1e-12)
    smooth = subdivide_catmull_clark(quads, 6, levels=2)
    assert np.abs((smooth.matrix @ points)[rows] - (smooth.matrix @ far)[rows]).max() > 0.01


def test_it_refuses_what_it_must():
    with pytest.raises(ValueRangeError, match="levels"):
        subdivide_catmull_clark(CUBE, 8, levels=0)
    with pytest.raises(ValueRangeError, match="faces"):
        subdivide_catmull_clark(CUBE, 7)
    with pytest.raises(ShapeError, match="faces"):
        subdivide_catmull_clark([[0, 1, 2]], 3)
    with pytest.raises(TopologyError, match="3 faces"):
        subdivide_catmull_clark([[0, 1, 2, -1], [1, 0, 3, -1], [0, 1, 4, -1]], 5)
    with pytest.raises(TopologyError, match="creases"):
        subdivide_catmull_clark(CUBE, 8, creases=[[0, 6]])
