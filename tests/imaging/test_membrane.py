"""The membrane: its energy's minimum, what it keeps, what it refuses."""

import numpy as np
import pytest
from scipy import sparse
from scipy.sparse.linalg import spsolve

from facewright.errors import ShapeError
from facewright.imaging._membrane_kernels import coarsen, refine
from facewright.imaging.membrane import stretch_membrane


def _dense(weight, moment, stiffness, fixed):
    """The same minimum by a sparse solver, component by component."""
    rows, cols = fixed.shape
    number = np.arange(rows * cols).reshape(rows, cols)
    pairs = [(number[:, :-1], number[:, 1:]), (number[:-1], number[1:])]
    first, second = (np.concatenate([p[k].ravel() for p in pairs]) for k in range(2))
    c = stiffness.ravel()
    edge = 0.5 * (c[first] + c[second])
    B = sparse.coo_matrix(
        (np.r_[np.ones(len(first)), -np.ones(len(first))], (np.tile(np.arange(len(first)), 2), np.r_[first, second])),
        (len(first), rows * cols),
    ).tocsr()
    laplace = B.T @ sparse.diags(edge) @ B
    free = ~fixed.ravel()
    out = np.zeros((2, rows * cols))
    for k in range(2):
        A = (laplace + sparse.diags(weight[k].ravel())).tocsr()[free][:, free]
        out[k, free] = spsolve(A.tocsc(), moment[k].ravel()[free])
    return out.reshape(2, rows, cols)


def _problem(rng, rows=46, cols=61):
    weight = np.zeros((2, rows, cols))
    weight[:, 14:30, 20:40] = 4.0 * rng.random((16, 20))
    field = np.stack([np.full((rows, cols), 7.0), np.linspace(-3, 3, cols)[None].repeat(rows, 0)])
    fixed = np.ones((rows, cols), bool)
    fixed[3:-3, 3:-3] = False
    return weight, weight * field, 0.2 + rng.random((rows, cols)), fixed


def test_it_is_near_the_minimum(rng):
    problem = _problem(rng)
    exact = _dense(*problem)
    found = stretch_membrane(*problem)
    assert np.abs(found - exact).max() < 0.03 * np.abs(exact).max()


def test_fixed_cells_stay_at_zero_and_nothing_overshoots(rng):
    weight, moment, stiffness, fixed = _problem(rng)
    found = stretch_membrane(weight, moment, stiffness, fixed)
    assert (found[:, fixed] == 0).all()
    assert found[0].min() >= -1e-4 and found[0].max() <= 7.0 + 1e-4  # the maximum principle


def test_a_constant_is_kept_where_nothing_is_fixed(rng):
    shape = (2, 37, 22)
    weight = np.zeros(shape)
    weight[:, 10:12, 5:9] = 1.0
    found = stretch_membrane(weight, 3.5 * weight, np.ones(shape[1:]), np.zeros(shape[1:], bool))
    np.testing.assert_allclose(found, 3.5, atol=0.02)


@pytest.mark.parametrize("shape", [(1, 1), (1, 9), (5, 2), (33, 17)])
def test_any_size_of_grid(shape):
    weight = np.ones((2, *shape))
    found = stretch_membrane(weight, 2 * weight, np.ones(shape), np.zeros(shape, bool))
    np.testing.assert_allclose(found, 2.0, atol=1e-3)


def test_coarsening_keeps_all_data(rng):
    weight, moment, stiffness, fixed = (a.astype(np.float32) if a.dtype != bool else a for a in _problem(rng, 31, 44))
    w, m, s, f = coarsen(weight, moment, stiffness, fixed)
    np.testing.assert_allclose(w.sum(axis=(1, 2)), weight.sum(axis=(1, 2)), rtol=1e-5)
    np.testing.assert_allclose(m.sum(axis=(1, 2)), moment.sum(axis=(1, 2)), rtol=1e-4, atol=1e-3)
    assert s.min() >= stiffness.min() - 1e-6 and s.max() <= stiffness.max() + 1e-6
    assert f[0, 0] and not f[8, 10]


def test_refining_keeps_linear_fields():
    i, j = np.mgrid[:12, :16].astype(np.float32)
    fine = refine(np.stack([i, 2 * j]), np.zeros((24, 32), bool))
    i2, j2 = (np.mgrid[:24, :32] - 0.5) / 2
    np.testing.assert_allclose(fine[0, 2:-2, 2:-2], i2[2:-2, 2:-2], atol=1e-5)
    np.testing.assert_allclose(fine[1, 2:-2, 2:-2], 2 * j2[2:-2, 2:-2], atol=1e-5)


def test_shapes_must_match(rng):
    weight, moment, stiffness, fixed = _problem(rng)
    with pytest.raises(ShapeError):
        stretch_membrane(weight, moment[:, :-1], stiffness, fixed)
    with pytest.raises(ShapeError):
        stretch_membrane(weight, moment, stiffness[:-1], fixed)
    with pytest.raises(ShapeError):
        stretch_membrane(weight[0], moment, stiffness, fixed)
