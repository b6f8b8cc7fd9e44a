import numpy as np
import pytest
from scipy import sparse

from facewright.fitting.scan_stage2 import LaplacianDeformer, Pulls, _conjugate_gradients, unfold
from facewright.mesh.connectivity import vertex_adjacency
from facewright.mesh.normals import face_area_vectors
from facewright.numeric.sparse_solve import SymmetricSolver


@pytest.fixture(scope="module")
def bump():
    """A bumpy sheet, 25 x 25 vertices, 4 mm apart."""
    n = 25
    y, x = np.mgrid[:n, :n] * 4.0
    z = 6.0 * np.exp(-((x - 48) ** 2 + (y - 48) ** 2) / 500.0) + 0.5 * np.sin(x / 6.0)
    i = np.arange(n * n).reshape(n, n)
    a, b, c, d = i[:-1, :-1].ravel(), i[1:, :-1].ravel(), i[1:, 1:].ravel(), i[:-1, 1:].ravel()
    faces = np.concatenate([np.stack([a, b, c], 1), np.stack([a, c, d], 1)]).astype(np.int32)
    return np.stack([x.ravel(), y.ravel(), z.ravel()], axis=1), faces


def hold(ids, goals, weight, n):
    diagonal, rhs = np.full(n, 1e-9), np.zeros((n, 3))
    diagonal[ids] = weight
    rhs[ids] = weight * goals
    return lambda x, step: Pulls(diagonal, rhs)


def test_a_turned_mesh_is_no_deformation(bump):
    """Only lengths of Laplacian coordinates count (eq. 6): a start that is turned by 60 degrees stays as it is."""
    x, faces = bump
    angle = np.deg2rad(60.0)
    turn = np.array([[1, 0, 0], [0, np.cos(angle), -np.sin(angle)], [0, np.sin(angle), np.cos(angle)]])
    ids = np.flatnonzero((x[:, 1] < 1) | (x[:, 1] > 95))
    turned = x @ turn.T
    found = LaplacianDeformer(faces, x).deform(turned, hold(ids, turned[ids], 10.0, len(x)), 5)
    np.testing.assert_allclose(found, turned, atol=1e-3)


def test_lengths_of_laplacian_coordinates_are_kept(bump):
    """Handles that move apart stretch a sheet, but what is not held keeps the size of its detail."""
    x, faces = bump
    ids = np.flatnonzero((x[:, 1] < 1) | (x[:, 1] > 95))
    goals = x[ids] + np.where(x[ids, 1:2] > 50, [0, 0, 6.0], 0.0)
    deformer = LaplacianDeformer(faces, x)
    found = deformer.deform(x, hold(ids, goals, 10.0, len(x)), 10)
    free = np.setdiff1d(np.arange(len(x)), ids)
    before, after = (np.linalg.norm(deformer.L @ v, axis=1)[free] for v in (x, found))
    assert np.abs(after - before).mean() < 0.1 * before.mean()
    np.testing.assert_allclose(found[ids], goals, atol=0.5)


def test_no_pull_leaves_the_mesh_alone(bump):
    x, faces = bump
    found = LaplacianDeformer(faces, x).deform(x, hold(np.arange(3), x[:3], 1.0, len(x)), 3)
    np.testing.assert_allclose(found, x, atol=1e-2)


def test_one_pulled_vertex_makes_no_spike(bump):
    """A landmark 5 mm off moves its surroundings smoothly: no flipped triangle, no long edge."""
    x, faces = bump
    goal = x.copy()
    weight = np.full(len(x), 1.0)
    goal[312] += [0, 0, 5.0]
    weight[312] = 1.5
    found = LaplacianDeformer(faces, x).deform(x, lambda v, step: Pulls(weight, weight[:, None] * goal), 3)
    before, after = face_area_vectors(x, faces), face_area_vectors(found, faces)
    assert (np.einsum("fc,fc->f", before, after) > 0).all()
    edges = np.linalg.norm(found[faces[:, 0]] - found[faces[:, 1]], axis=1)
    assert edges.max() < 1.3 * np.linalg.norm(x[faces[:, 0]] - x[faces[:, 1]], axis=1).max()


def test_conjugate_gradients_reach_the_direct_solution(bump, rng):
    x, faces = bump
    deformer = LaplacianDeformer(faces, x)
    first = (deformer.LtL + sparse.diags(rng.uniform(0.5, 1.0, len(x)))).tocsr()
    second = (deformer.LtL + sparse.diags(rng.uniform(0.3, 1.2, len(x)))).tocsr()
    rhs = second @ rng.normal(size=(len(x), 3)) * 10
    found, used = _conjugate_gradients(second, rhs, np.zeros((len(x), 3)), SymmetricSolver(first))
    exact = SymmetricSolver(second).solve(rhs)
    assert np.linalg.norm(found - exact) < 2e-3 * np.linalg.norm(exact)
    assert 0 < used < 15


def test_later_steps_use_the_first_factor(bump):
    x, faces = bump
    deformer = LaplacianDeformer(faces, x)
    pulls = hold(np.arange(0, len(x), 2), x[::2] + [0, 0, 1.0], 1.0, len(x))
    for _ in range(3):
        deformer.deform(x, pulls, 3)
    assert deformer.factorisations == 1


def test_folds_are_smoothed_away_and_the_rest_stays(bump):
    x, faces = bump
    after = x + [0.0, 0.0, 3.0]
    after[312] += [9.0, 0.0, 0.0]  # past its neighbour
    assert (np.einsum("fc,fc->f", face_area_vectors(x, faces), face_area_vectors(after, faces)) < 0).any()
    found = unfold(x, after, faces, vertex_adjacency(faces, len(x)))
    assert (np.einsum("fc,fc->f", face_area_vectors(x, faces), face_area_vectors(found, faces)) > 0).all()
    far = np.linalg.norm(x[:, :2] - x[312, :2], axis=1) > 20.0
    np.testing.assert_array_equal(found[far], after[far])
    np.testing.assert_allclose(found[312], x[312] + [0, 0, 3.0], atol=1.0)
