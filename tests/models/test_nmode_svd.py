import importlib.util
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from facewright.errors import ShapeError, ValueRangeError
from facewright.models.nmode_svd import SINGLE_NOISE_FLOOR, gram_matrix, nmode_svd

_spec = importlib.util.spec_from_file_location("reference_bilinear", Path(__file__).with_name("reference_bilinear.py"))
reference = importlib.util.module_from_spec(_spec)
_spec.loader.exec_module(reference)


def reconstruct(svd):
    return np.einsum(
        "ievc,ni,se->nsvc", svd.core.astype(float), svd.identity_factors, svd.expression_factors, optimize=True
    )


class Blocks:
    """A tensor that can only be walked, in blocks of vertices."""

    def __init__(self, tensor, size):
        self.tensor, self.size = tensor, size

    def __iter__(self):
        for start in range(0, self.tensor.shape[2], self.size):
            yield self.tensor[:, :, start : start + self.size]


@pytest.mark.parametrize("order", ["identity", "expression"])
def test_full_decomposition_is_exact(population, order):
    svd = nmode_svd(population, 16, 9, order=order)
    assert np.abs(reconstruct(svd) - population).max() < 2e-4  # float32 of coordinates up to 200 mm


@pytest.mark.parametrize("order", ["identity", "expression"])
def test_factors_and_singular_values_equal_those_of_the_unfoldings(population, order):
    core, u_id, u_exp, s_id, s_exp = reference.nmode_svd_full(population, 6, 5)
    svd = nmode_svd(population, 6, 5, order=order)
    first = svd.identity_factors if order == "identity" else svd.expression_factors
    expected = u_id if order == "identity" else u_exp
    np.testing.assert_allclose(np.abs(np.sum(first * expected, axis=0)), 1, atol=1e-6)
    first_values = svd.identity_singular_values if order == "identity" else svd.expression_singular_values
    values = s_id if order == "identity" else s_exp
    # A float32 Gram matrix has rounding noise of about 1e-8 of its largest eigenvalue.
    np.testing.assert_allclose(first_values**2, values**2, rtol=1e-4, atol=3e-8 * values[0] ** 2)
    # The second mode sees a truncated tensor: same subspace up to what truncation removed, error never much larger.
    full = np.einsum("ievc,ni,se->nsvc", core, u_id, u_exp)
    error, error_full = (np.linalg.norm(x - population) for x in (reconstruct(svd), full))
    assert error <= 1.02 * error_full


def test_truncation_obeys_the_error_bound(population):
    """Squared error is at most the sum of the discarded squared singular values of both modes."""
    _, _, _, s_id, s_exp = reference.nmode_svd_full(population, 6, 5)
    for order in ("identity", "expression"):
        error = np.sum((reconstruct(nmode_svd(population, 6, 5, order=order)) - population) ** 2)
        assert error <= (s_id[6:] ** 2).sum() + (s_exp[5:] ** 2).sum()


def test_factors_are_orthonormal_and_core_slices_orthogonal(population):
    svd = nmode_svd(population, 6, 5)
    np.testing.assert_allclose(svd.identity_factors.T @ svd.identity_factors, np.eye(6), atol=1e-12)
    np.testing.assert_allclose(svd.expression_factors.T @ svd.expression_factors, np.eye(5), atol=1e-12)
    slices = svd.core.swapaxes(0, 1).reshape(5, -1).astype(float)
    gram = slices @ slices.T
    np.testing.assert_allclose(np.sqrt(np.diag(gram)), svd.expression_singular_values[:5], rtol=3e-4)
    assert np.abs(gram - np.diag(np.diag(gram))).max() < 1e-5 * gram[0, 0]


@pytest.mark.parametrize("order", ["identity", "expression"])
def test_every_kind_of_source_gives_the_same(population, tmp_path, order):
    expected = nmode_svd(population, 6, 5, order=order)
    np.save(tmp_path / "t.npy", population)
    strided = np.concatenate([population, population], axis=2)[:, :, : population.shape[2]]
    sources = {
        "memmap": np.load(tmp_path / "t.npy", mmap_mode="r"),
        "float64": population.astype(np.float64),
        "strided": strided,
        "reversed": population[:, :, ::-1][:, :, ::-1],
        "fortran": np.asfortranarray(population),
        "list": list(Blocks(population, 50)),
        "walked": Blocks(population, 7),
    }
    for name, source in sources.items():
        svd = nmode_svd(source, 6, 5, order=order, block_mb=0.02)
        np.testing.assert_allclose(svd.core, expected.core, atol=2e-2, err_msg=name)
        np.testing.assert_allclose(svd.identity_factors, expected.identity_factors, atol=2e-4, err_msg=name)
        error = np.abs(reconstruct(svd) - reconstruct(expected)).max()
        assert error < 1e-2, name


def test_input_is_not_modified(population):
    before = population.copy()
    nmode_svd(population, 3, 3)
    np.testing.assert_array_equal(population, before)


def test_double_is_used_where_single_precision_hides_the_spectrum():
    """A component 1e-5 of the mean's size: invisible in a float32 Gram matrix, found in double."""
    rng = np.random.default_rng(1)
    mean = rng.normal(size=3 * 4000) * 1000
    detail = rng.normal(size=3 * 4000) * 0.01
    w = np.linalg.qr(np.c_[np.ones(12), rng.normal(size=12)])[0][:, 1]
    tensor = (mean + w[:, None, None] * detail).repeat(4, axis=1).reshape(12, 4, -1, 3).astype(np.float64)
    auto = nmode_svd(tensor, 2, 1)
    single = nmode_svd(tensor, 2, 1, precision="single")
    assert abs(auto.identity_factors[:, 1] @ w) > 0.9999
    assert abs(single.identity_factors[:, 1] @ w) < 0.99


def test_signs_repeat(population):
    a, b = nmode_svd(population, 5, 4), nmode_svd(population.copy(), 5, 4)
    np.testing.assert_array_equal(a.identity_factors, b.identity_factors)
    assert (np.take_along_axis(a.identity_factors, np.abs(a.identity_factors).argmax(0)[None], 0) > 0).all()


@pytest.mark.parametrize("mode", [0, 1])
def test_single_precision_noise_stays_below_the_stated_floor(tensor_maker, mode):
    tensor = tensor_maker(np.random.default_rng(0), n_people=20, n_shapes=12, n_vertices=15_000)
    double = gram_matrix(tensor, mode, precision="double")
    noise = np.linalg.norm(gram_matrix(tensor, mode) - double, 2) / np.linalg.norm(double, 2)
    assert 0 < noise < SINGLE_NOISE_FLOOR


@pytest.mark.parametrize("mode", [0, 1])
@pytest.mark.parametrize("precision", ["single", "double"])
def test_gram_matrix(population, mode, precision):
    unfolding = np.moveaxis(population, mode, 0).reshape(population.shape[mode], -1).astype(float)
    expected = unfolding @ unfolding.T
    gram = gram_matrix(population, mode, precision=precision)
    np.testing.assert_allclose(gram, expected, rtol=1e-6 if precision == "single" else 1e-12)


@settings(max_examples=20, deadline=None)
@given(st.integers(1, 5), st.integers(1, 5), st.integers(1, 40), st.integers(0, 1000))
def test_any_small_tensor_is_reproduced(n, s, v, seed):
    tensor = np.random.default_rng(seed).normal(size=(n, s, v, 3))
    for order in ("identity", "expression"):
        svd = nmode_svd(tensor, n, s, order=order, block_mb=1e-4)
        np.testing.assert_allclose(reconstruct(svd), tensor, atol=1e-4)


def test_progress_names_stages(population):
    calls = []
    nmode_svd(Blocks(population, 60), 3, 3, progress=lambda *call: calls.append(call))
    stages = list(dict.fromkeys(stage for stage, _, _ in calls))
    assert stages == ["identity modes", "core tensor", "expression modes"]
    assert all(0 < done <= total for _, done, total in calls)


@pytest.mark.parametrize(
    ("change", "error", "message"),
    [
        ({"tensor": np.zeros((3, 4, 5))}, ShapeError, "people, expressions"),
        ({"tensor": np.zeros((3, 4, 5, 2))}, ShapeError, "people, expressions"),
        ({"tensor": np.zeros((3, 0, 5, 3))}, ShapeError, "people, expressions"),
        ({"tensor": []}, ShapeError, "empty iterable"),
        ({"tensor": iter([np.zeros((16, 9, 5, 3))])}, ValueRangeError, "more than once"),
        ({"tensor": [np.zeros((16, 9, 5, 3)), np.zeros((15, 9, 5, 3))]}, ShapeError, "block 1"),
        ({"tensor": np.full((16, 9, 5, 3), np.nan)}, ValueRangeError, "finite"),
        ({"n_identity": 17}, ValueRangeError, r"n_identity must be in \[1, 16\]"),
        ({"n_identity": 0}, ValueRangeError, "n_identity"),
        ({"n_expression": 10}, ValueRangeError, "n_expression"),
        ({"order": "vertices"}, ValueRangeError, "order"),
        ({"precision": "half"}, ValueRangeError, "precision"),
        ({"block_mb": 0}, ValueRangeError, "block_mb"),
    ],
)
def test_bad_arguments_are_refused(population, change, error, message):
    arguments = {"tensor": population, "n_identity": 3, "n_expression": 3, **change}
    with pytest.raises(error, match=message):
        nmode_svd(**arguments)


def test_a_source_that_changes_between_passes_is_refused():
    class Shrinking:
        size = 8

        def __iter__(self):
            self.size -= 1
            return iter([np.ones((3, 2, self.size, 3))])

    with pytest.raises(ShapeError, match="each pass"):
        nmode_svd(Shrinking(), 2, 2)
