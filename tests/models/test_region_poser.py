"""Eq. 8-10 against the same equations written out, and their limits."""

import importlib.util
from dataclasses import replace
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from facewright.errors import ShapeError, ValueRangeError
from facewright.models.region_blend import RegionBlend
from facewright.models.region_pca import fit_region_pca
from facewright.models.region_poser import RegionPoser
from facewright.models.regions import Regions

_spec = importlib.util.spec_from_file_location("reference_regions", Path(__file__).with_name("reference_regions.py"))
reference = importlib.util.module_from_spec(_spec)
_spec.loader.exec_module(reference)


def _posed(model, vertices, targets, rest, beta, gamma, weights=None):
    poser = RegionPoser(model, beta, gamma)
    poser.set_constraints(vertices, weights)
    return poser.solve(np.asarray(targets), rest)


@pytest.mark.parametrize(("beta", "gamma"), [(0.5, 0.025), (0.0, 0.1), (10.0, 1e-3), (0.5, 5.0)])
@pytest.mark.parametrize("vertices", [[0], [21], [0, 22, 40], list(range(reference.N))])
def test_pose_is_eq_9_solved_row_by_row(rng, beta, gamma, vertices):
    """Vertex 21 lies in all three regions; all vertices are more rows than coefficients."""
    model = reference.small_model(rng)
    model = replace(model, means=tuple(mean + rng.normal(size=mean.shape) for mean in model.means))
    rest = rng.normal(size=model.n_coefficients)
    targets = model.neutral[vertices] + rng.normal(size=(len(vertices), 3))
    weights = rng.uniform(0.5, 2.0, len(vertices))
    for w in (None, weights):
        expected = reference.naive_pose(model, vertices, targets, rest, beta, gamma, w)
        np.testing.assert_allclose(_posed(model, vertices, targets, rest, beta, gamma, w), expected, atol=1e-9)


def test_pose_fulfils_eq_10(rng):
    """The gradient, assembled as printed, vanishes at the solution."""
    model, beta, gamma = reference.small_model(rng), 0.5, 0.025
    rest, vertex = rng.normal(size=model.n_coefficients), 20
    target = model.neutral[vertex] + rng.normal(size=3)
    zeta = _posed(model, [vertex], [target], rest, beta, gamma)
    c = [zeta[model.offsets[i] : model.offsets[i + 1]] for i in range(3)]
    for i, ids in enumerate(model.regions.members):
        gradient = gamma * (c[i] - rest[model.offsets[i] : model.offsets[i + 1]])
        if vertex in ids:
            B = model.bases[i][:, ids.tolist().index(vertex)].T
            gradient += B.T @ (B @ c[i]) - B.T @ (target - model.neutral[vertex])
        for j in range(3):
            if j != i:
                own, other, _ = reference.pair_rows(model, i, j)
                gradient += beta * (own.T @ own @ c[i] - own.T @ other @ c[j])
        np.testing.assert_allclose(gradient, 0.0, atol=1e-9)


def test_one_region_is_eq_8(rng):
    model = reference.small_model(rng, 8, regions=Regions.holistic(reference.N))
    rest = rng.normal(size=8)
    target = model.neutral[[7, 30]] + rng.normal(size=(2, 3))
    B = model.bases[0][:, [7, 30]].reshape(8, -1).T
    expected = np.linalg.solve(
        B.T @ B + 0.025 * np.eye(8), B.T @ (target - model.neutral[[7, 30]]).ravel() + 0.025 * rest
    )
    np.testing.assert_allclose(_posed(model, [7, 30], target, rest, 0.5, 0.025), expected, atol=1e-9)


def test_beta_and_gamma_zero_with_all_vertices_are_independent_models(rng):
    model = reference.small_model(rng)
    moves = rng.normal(size=(reference.N, 3))
    zeta = _posed(model, range(reference.N), model.neutral + moves, np.zeros(model.n_coefficients), 0.0, 0.0)
    for i, ids in enumerate(model.regions.members):
        expected = reference.matrix(model, i).T @ moves[ids].ravel()  # Eq. (4)
        np.testing.assert_allclose(zeta[model.offsets[i] : model.offsets[i + 1]], expected, atol=1e-9)


def test_gamma_zero_with_few_constraints_leaves_the_rest_where_it_was(rng):
    model = reference.small_model(rng)
    rest = rng.normal(size=model.n_coefficients)
    zeta = _posed(model, [0], model.neutral[[0]] + 2.0, rest, 0.0, 0.0)
    np.testing.assert_allclose(zeta[5:], rest[5:], atol=1e-5)
    np.testing.assert_allclose(RegionBlend(model).positions(zeta)[0], model.neutral[0] + 2.0, atol=1e-3)


def test_large_gamma_changes_nothing(rng):
    model = reference.small_model(rng)
    rest = rng.normal(size=model.n_coefficients)
    zeta = _posed(model, [3], model.neutral[[3]] + 9.0, rest, 0.5, 1e9)
    np.testing.assert_allclose(zeta, rest, atol=1e-6)


def test_large_beta_closes_the_boundaries(rng):
    model = reference.small_model(rng)
    gaps = [
        RegionBlend(model).gaps(_posed(model, [3], model.neutral[[3]] + 9.0, np.zeros(15), beta, 0.025)).max_mm
        for beta in (0.0, 0.5, 10.0, 1e4, 1e8)
    ]
    assert all(later < earlier for earlier, later in pairwise(gaps[1:]))
    assert gaps[0] > 0.1 and gaps[-1] < 1e-5


def test_a_drag_stays_in_its_region_and_a_holistic_one_does_not(rng):
    model = reference.small_model(rng)
    far = np.flatnonzero(np.isin(np.arange(reference.N) % reference.COLUMNS, [6, 7, 8]))
    moved = []
    for one in (model, reference.small_model(rng, regions=Regions.holistic(reference.N))):
        poser = RegionPoser(one)
        poser.set_constraints([0])
        zeta = poser.solve(one.neutral[[0]] + [0.0, 5.0, 0.0], np.zeros(one.n_coefficients))
        motion = np.linalg.norm(poser.positions(zeta) - one.neutral, axis=1) ** 2
        moved.append(motion[far].sum() / motion.sum())
    assert moved[0] < 0.5 * moved[1]


@settings(max_examples=25, deadline=None)
@given(seed=st.integers(0, 2**32 - 1), beta=st.floats(0.0, 20.0), gamma=st.floats(1e-4, 10.0))
def test_no_other_pose_has_less_energy(seed, beta, gamma):
    rng = np.random.default_rng(seed)
    model = reference.small_model(np.random.default_rng(0), 3)
    rest, vertex = rng.normal(size=9), int(rng.integers(reference.N))
    target = model.neutral[vertex] + rng.normal(size=3)
    zeta = _posed(model, [vertex], [target], rest, beta, gamma)

    def energy(z):
        rows, right = reference.boundary_block_rows(model, beta)
        total = ((rows @ z - right) ** 2).sum() + gamma * ((z - rest) ** 2).sum()
        for i, ids in enumerate(model.regions.members):
            if vertex in ids:
                B = model.bases[i][:, ids.tolist().index(vertex)].T
                miss = target - model.neutral[vertex] - B @ z[model.offsets[i] : model.offsets[i + 1]]
                total += (miss**2).sum()
        return total

    best = energy(zeta)
    assert all(energy(zeta + 1e-2 * rng.normal(size=9)) >= best - 1e-12 for _ in range(10))


@pytest.mark.parametrize("dtype", [np.float32, np.float64])
def test_positions_land_in_the_callers_buffer(rng, dtype):
    model = reference.small_model(rng)
    poser = RegionPoser(model)
    poser.set_constraints([4])
    out = np.zeros((reference.N, 3), dtype)
    zeta = poser.solve(model.neutral[[4]] + 1.0, np.zeros(15), out)
    np.testing.assert_allclose(out, model.neutral + reference.naive_average(model, zeta), rtol=1e-6, atol=1e-5)


def test_weights_change_while_constraints_stay(rng):
    model = reference.small_model(rng)
    poser = RegionPoser(model, 0.5, 0.025)
    poser.set_constraints([4, 20])
    target, rest = model.neutral[[4, 20]] + 1.0, rng.normal(size=15)
    poser.solve(target, rest)
    poser.set_weights(beta=3.0)
    poser.set_weights(gamma=0.2)
    np.testing.assert_allclose(poser.solve(target, rest), _posed(model, [4, 20], target, rest, 3.0, 0.2), atol=1e-12)
    rest += 1.0  # the caller's array, changed in place
    np.testing.assert_allclose(poser.solve(target, rest), _posed(model, [4, 20], target, rest, 3.0, 0.2), atol=1e-12)


def test_without_constraints_only_the_boundaries_pull(rng):
    model = reference.small_model(rng)
    rest = rng.normal(size=15)
    zeta = RegionPoser(model, 0.5, 0.025).solve(np.zeros((0, 3)), rest)
    assert RegionBlend(model).gaps(zeta).mean_mm < RegionBlend(model).gaps(rest).mean_mm
    np.testing.assert_allclose(RegionPoser(model, 0.0, 0.025).solve(np.zeros((0, 3)), rest), rest, atol=1e-12)


def test_bounded_bases_stay_within_bounds_and_are_the_best_there(rng):
    model = reference.small_model(rng)
    model = replace(model, lower=tuple(np.zeros(5) for _ in range(3)), upper=tuple(np.ones(5) for _ in range(3)))
    rest, target = np.full(15, 0.5), model.neutral[[2]] + [3.0, -2.0, 1.0]
    zeta = _posed(model, [2], target, rest, 0.5, 0.025)
    assert zeta.min() >= 0.0 and zeta.max() <= 1.0
    assert ((zeta == 0.0) | (zeta == 1.0)).any()
    H = np.zeros((15, 15))
    rows, _ = reference.boundary_block_rows(model, 0.5)
    B = np.zeros((3, 15))
    B[:, :5] = model.bases[0][:, 2].T
    H = B.T @ B + rows.T @ rows + 0.025 * np.eye(15)
    gradient = H @ zeta - B.T @ (target[0] - model.neutral[2]) - 0.025 * rest
    assert (gradient[zeta == 0.0] >= -1e-8).all() and (gradient[zeta == 1.0] <= 1e-8).all()
    np.testing.assert_allclose(gradient[(zeta > 0) & (zeta < 1)], 0.0, atol=1e-8)


def test_bad_input_is_refused(rng):
    model = reference.small_model(rng)
    for name, arguments in (
        ("beta", (-1.0, 0.1)),
        ("gamma", (0.5, -0.1)),
        ("beta", (np.inf, 0.1)),
        ("gamma", (0.5, np.nan)),
    ):
        with pytest.raises(ValueRangeError, match=f"{name} must be finite and not negative"):
            RegionPoser(model, *arguments)
    poser = RegionPoser(model)
    with pytest.raises(ValueRangeError, match="not negative"):
        poser.set_weights(gamma=-1.0)
    assert (poser.beta, poser.gamma) == (0.5, 0.025)
    with pytest.raises(ValueRangeError, match=r"\[0, 45\)"):
        poser.set_constraints([45])
    with pytest.raises(ValueRangeError, match="twice"):
        poser.set_constraints([3, 3])
    with pytest.raises(ValueRangeError, match="positive"):
        poser.set_constraints([3], [0.0])
    with pytest.raises(ShapeError):
        poser.set_constraints([[3]])
    poser.set_constraints([3])
    with pytest.raises(ShapeError, match="targets"):
        poser.solve(np.zeros((2, 3)), np.zeros(15))
    with pytest.raises(ShapeError, match="rest"):
        poser.solve(np.zeros((1, 3)), np.zeros(14))
    with pytest.raises(ShapeError, match="out"):
        poser.solve(np.zeros((1, 3)), np.zeros(15), np.zeros((4, 3)))
    with pytest.raises(ValueRangeError, match="blend"):
        RegionPoser(model, blend="none")


def test_a_model_that_never_moves_stays(rng):
    moves = np.zeros((4, reference.N, 3))
    model = fit_region_pca(moves, reference.grid_faces(), reference.grid_neutral(), reference.grid_regions(), 3)
    poser = RegionPoser(model)
    poser.set_constraints([4])
    out = np.zeros((reference.N, 3))
    assert poser.solve(model.neutral[[4]] + 1.0, np.zeros(0), out).shape == (0,)
    np.testing.assert_array_equal(out, model.neutral)


@pytest.mark.parametrize("bounded", [False, True])
def test_kept_boundaries_move_nothing_that_is_not_dragged(rng, bounded):
    """A point that is held where it is leaves an earlier pose as it is; by eq. 9 its gaps would close."""
    model = reference.small_model(rng)
    if bounded:
        lower = tuple(np.full(len(basis), -5.0) for basis in model.bases)
        model = replace(model, lower=lower, upper=tuple(-low for low in lower))
    rest = rng.normal(size=model.n_coefficients)
    vertices = [0, 21]
    moved = {}
    for boundaries in ("keep", "meet"):
        poser = RegionPoser(model, 0.5, 0.025, boundaries=boundaries)
        seen = poser.positions(rest, np.empty((model.n_vertices, 3)))
        np.testing.assert_allclose(poser.solve(np.zeros((0, 3)), rest), rest, atol=1e-9 if boundaries == "keep" else 9)
        poser.set_constraints(vertices)
        out = np.empty((model.n_vertices, 3))
        poser.solve(seen[vertices], rest, out)
        moved[boundaries] = np.abs(out - seen).max()
    assert moved["keep"] < 1e-6 < 0.01 < moved["meet"]


def test_kept_boundaries_are_eq_9_of_the_change(rng):
    model = reference.small_model(rng)
    rest = rng.normal(size=model.n_coefficients)
    poser = RegionPoser(model, 0.5, 0.025, boundaries="keep")
    seen = poser.positions(rest, np.empty((model.n_vertices, 3)))
    vertices, pull = [0, 21, 40], rng.normal(size=(3, 3))
    poser.set_constraints(vertices)
    change = reference.naive_pose(
        model, vertices, model.neutral[vertices] + pull, np.zeros(model.n_coefficients), 0.5, 0.025, None
    )
    np.testing.assert_allclose(poser.solve(seen[vertices] + pull, rest), rest + change, atol=1e-9)


def test_kept_and_met_boundaries_are_the_same_from_the_neutral(rng):
    model = reference.small_model(rng)
    start, poses = np.zeros(model.n_coefficients), []
    for boundaries in ("keep", "meet"):
        poser = RegionPoser(model, 0.5, 0.025, boundaries=boundaries)
        poser.set_constraints([3])
        poses.append(poser.solve(model.neutral[[3]] + 1.0, start))
    np.testing.assert_allclose(poses[0], poses[1], atol=1e-10)
    with pytest.raises(ValueRangeError, match="boundaries"):
        RegionPoser(model, boundaries="close")
