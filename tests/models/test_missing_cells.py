import numpy as np
import pytest

from facewright.errors import ConvergenceWarning, DegenerateError, ShapeError, ValueRangeError
from facewright.models.missing_cells import _fill_by_addition, fill_missing_cells


@pytest.fixture(scope="module")
def bilinear_population():
    """People of an exact bilinear model of 4 x 3 components plus 0.05 mm of noise."""
    rng = np.random.default_rng(11)
    core = rng.normal(size=(4, 3, 150, 3)) * np.outer([30, 2, 1.5, 1], [1, 0.6, 0.4])[:, :, None, None]
    people = np.c_[1 + 0.01 * rng.normal(size=24), rng.normal(size=(24, 3))]
    shapes = np.c_[np.ones(8), rng.normal(size=(8, 2))]
    tensor = np.einsum("ni,se,ievc->nsvc", people, shapes, core)
    return (tensor + 0.05 * rng.normal(size=tensor.shape)).astype(np.float32)


def rms(a, b, mask):
    return float(np.sqrt(((a - b)[mask] ** 2).mean()))


def random_mask(rng, share):
    present = rng.uniform(size=(24, 8)) > share
    present[np.arange(24), rng.integers(8, size=24)] = True
    present[rng.integers(24, size=8), np.arange(8)] = True
    return present


@pytest.mark.parametrize("share", [0.1, 0.3, 0.5])
def test_missing_cells_come_back(bilinear_population, share):
    present = random_mask(np.random.default_rng(3), share)
    given = bilinear_population.copy()
    given[~present] = np.nan
    result = fill_missing_cells(given, present, 4, 3, tolerance_mm=1e-3, max_iterations=200)
    start = np.nan_to_num(given)
    _fill_by_addition(start, present)
    error = rms(result.tensor, bilinear_population, ~present)
    assert error < 0.15 * rms(start, bilinear_population, ~present)  # far better than the additive guess
    assert error < 0.2
    assert result.noise_mm == pytest.approx(0.05, rel=0.3)
    np.testing.assert_array_equal(result.tensor[present], bilinear_population[present])
    assert np.isnan(given[~present]).all()  # the argument is not modified


def test_person_with_only_a_neutral(bilinear_population):
    present = np.ones((24, 8), dtype=bool)
    present[5, 1:] = False
    result = fill_missing_cells(bilinear_population, present, 4, 3)
    spread = bilinear_population[:, 1:].std(axis=0).mean()
    assert rms(result.tensor, bilinear_population, ~present) < 0.5 * spread


def test_complete_tensor_is_returned(bilinear_population):
    result = fill_missing_cells(bilinear_population, np.ones((24, 8), dtype=bool), 4, 3)
    assert result.iterations == 0
    np.testing.assert_array_equal(result.tensor, bilinear_population)


def test_iterations_reduce_the_movement_and_report(bilinear_population):
    present = random_mask(np.random.default_rng(4), 0.4)
    calls = []
    with pytest.warns(ConvergenceWarning, match="after 2 iterations"):
        two = fill_missing_cells(
            bilinear_population,
            present,
            4,
            3,
            max_iterations=2,
            tolerance_mm=1e-9,
            progress=lambda *c: calls.append(c),
        )
    assert calls == [("missing cells", 1, 2), ("missing cells", 2, 2)]
    many = fill_missing_cells(bilinear_population, present, 4, 3, tolerance_mm=1e-3, max_iterations=200)
    assert many.last_change_mm < two.last_change_mm


def test_one_component_each(bilinear_population):
    present = random_mask(np.random.default_rng(5), 0.2)
    result = fill_missing_cells(bilinear_population, present, 1, 1)
    assert np.isfinite(result.tensor).all()


def test_guards(bilinear_population):
    full = np.ones((24, 8), dtype=bool)
    no_person, no_shape = full.copy(), full.copy()
    no_person[3] = False
    no_shape[:, 2] = False
    with pytest.raises(DegenerateError, match="every person must have a present cell, got none for person 3"):
        fill_missing_cells(bilinear_population, no_person, 2, 2)
    with pytest.raises(DegenerateError, match=r"every expression .* got none for expression 2"):
        fill_missing_cells(bilinear_population, no_shape, 2, 2)
    with pytest.raises(ShapeError, match="present must be bool"):
        fill_missing_cells(bilinear_population, full[:, :7], 2, 2)
    with pytest.raises(ShapeError, match="present must be bool"):
        fill_missing_cells(bilinear_population, full.astype(float), 2, 2)
    with pytest.raises(ShapeError, match="tensor"):
        fill_missing_cells(bilinear_population[0], full, 2, 2)
    broken = bilinear_population.copy()
    broken[4, 1, 0] = np.nan
    with pytest.raises(ValueRangeError, match="person 4"):
        fill_missing_cells(broken, full, 2, 2)
