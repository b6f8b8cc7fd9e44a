"""Eq. 5-7 against the same equations written out, and their limits."""

import importlib.util
from dataclasses import replace
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest

from facewright.errors import ShapeError, ValueRangeError
from facewright.models.region_blend import RegionBlend
from facewright.models.region_fit import RegionFitter, reconstruction_rms
from facewright.models.region_pca import fit_region_pca
from facewright.models.regions import Regions

_spec = importlib.util.spec_from_file_location("reference_regions", Path(__file__).with_name("reference_regions.py"))
reference = importlib.util.module_from_spec(_spec)
_spec.loader.exec_module(reference)


def _apart(model, rng):
    """A model whose regions disagree about the mean at shared vertices."""
    return replace(model, means=tuple(mean + rng.normal(size=mean.shape) for mean in model.means))


@pytest.mark.parametrize("beta", [0.0, 0.5, 30.0])
@pytest.mark.parametrize("centred", [False, True])
def test_fit_is_eq_6_solved_row_by_row(rng, beta, centred):
    model = reference.small_model(rng, centred=centred)
    model = _apart(model, rng) if centred else model
    moves = reference.smooth_motion(rng, 4) + rng.normal(size=(4, reference.N, 3))
    expected = [reference.naive_fit(model, each, beta) for each in moves]
    np.testing.assert_allclose(RegionFitter(model, beta).fit(moves), expected, atol=1e-9)


def test_fit_is_eq_7_as_a_block_system(rng):
    model = reference.small_model(rng)
    moves = reference.smooth_motion(rng, 2) + rng.normal(size=(2, reference.N, 3))
    expected = [reference.naive_gradient(model, each, 0.5) for each in moves]
    np.testing.assert_allclose(RegionFitter(model, 0.5).fit(moves), expected, atol=1e-9)


def test_without_boundaries_regions_are_independent_models(rng):
    model = reference.small_model(rng)
    moves = rng.normal(size=(3, reference.N, 3))
    zeta = RegionFitter(model, 0.0).fit(moves)
    for i, ids in enumerate(model.regions.members):
        c = moves[:, ids].reshape(3, -1) @ reference.matrix(model, i)  # Eq. (4), orthonormal
        np.testing.assert_allclose(zeta[:, model.offsets[i] : model.offsets[i + 1]], c, atol=1e-9)


def test_one_region_is_eq_4_for_any_beta(rng):
    model = reference.small_model(rng, regions=Regions.holistic(reference.N))
    moves = rng.normal(size=(3, reference.N, 3))
    expected = moves.reshape(3, -1) @ reference.matrix(model, 0)
    np.testing.assert_allclose(RegionFitter(model, 7.0).fit(moves), expected, atol=1e-9)


def test_boundaries_close_as_beta_grows(rng):
    model = reference.small_model(rng)
    moves = rng.normal(size=(1, reference.N, 3))
    blend = RegionBlend(model)
    gaps = [blend.gaps(RegionFitter(model, beta).fit(moves)[0]).mean_mm for beta in (0.0, 0.1, 1.0, 10.0, 1e3, 1e7)]
    assert all(later < earlier for earlier, later in pairwise(gaps))
    assert gaps[0] > 0.1 and gaps[-1] < 1e-5


@pytest.mark.parametrize("every_frame_its_own", [False, True])
def test_partial_data_count_only_where_they_are(rng, every_frame_its_own):
    model = reference.small_model(rng, 4)
    moves = reference.smooth_motion(rng, 5)
    present = rng.random((5, reference.N)) < 0.7
    present[3] = present[0]
    if not every_frame_its_own:
        present = np.repeat(present[:1], 5, axis=0)
    holes = np.where(present[:, :, None], moves, np.nan)
    zeta = RegionFitter(model, 0.5).fit(holes, present if every_frame_its_own else present[0])
    expected = [reference.naive_fit(model, each, 0.5, seen) for each, seen in zip(moves, present, strict=True)]
    np.testing.assert_allclose(zeta, expected, atol=1e-7)


def test_a_region_that_is_not_seen_follows_its_boundaries(rng):
    model = reference.small_model(rng, 3)
    present = np.ones(reference.N, dtype=bool)
    present[model.regions.members[2]] = False
    moves = RegionFitter(model).reconstruct(rng.normal(size=(1, model.n_coefficients)))
    zeta = RegionFitter(model, 1.0, gamma=1e-6).fit(moves, present)
    assert np.isfinite(zeta).all()
    nothing = RegionFitter(model, 0.0).fit(moves, present)
    np.testing.assert_allclose(nothing[0, model.offsets[2] :], 0.0, atol=1e-12)


def test_bounded_bases_stay_within_bounds(rng):
    model = reference.small_model(rng)
    bounded = replace(
        model, lower=tuple(np.full(5, -0.3) for _ in range(3)), upper=tuple(np.full(5, 0.4) for _ in range(3))
    )
    moves = reference.smooth_motion(rng, 6)
    zeta = RegionFitter(bounded, 0.5).fit(moves)
    assert zeta.min() >= -0.3 and zeta.max() <= 0.4
    assert ((zeta == -0.3) | (zeta == 0.4)).any()
    free = RegionFitter(model, 0.5).fit(0.01 * moves)
    np.testing.assert_allclose(RegionFitter(bounded, 0.5).fit(0.01 * moves), free, atol=1e-6)


def test_error_is_eq_13(rng):
    a, b = rng.normal(size=(2, 7, 5, 3))
    expected = np.sqrt(np.mean([np.sum((x - y) ** 2) / 5 for x, y in zip(a, b, strict=True)]))
    assert reconstruction_rms(a, b) == pytest.approx(expected, rel=1e-12)
    assert reconstruction_rms(a, a) == 0.0
    with pytest.raises(ShapeError):
        reconstruction_rms(a, b[:3])
    with pytest.raises(ShapeError, match="at least one"):
        reconstruction_rms(a[:0], b[:0])


def test_all_components_give_the_data_back(rng):
    moves = reference.smooth_motion(rng, 30)
    model = fit_region_pca(moves, reference.grid_faces(), reference.grid_neutral(), reference.grid_regions(), 200)
    fitter = RegionFitter(model, 0.5)
    assert reconstruction_rms(moves, fitter.reconstruct(fitter.fit(moves))) < 1e-3


def test_bad_input_is_refused(rng):
    model = reference.small_model(rng)
    with pytest.raises(ValueRangeError, match="beta must be"):
        RegionFitter(model, -0.1)
    with pytest.raises(ValueRangeError, match="gamma must be"):
        RegionFitter(model, 0.1, np.nan)
    fitter = RegionFitter(model)
    with pytest.raises(ShapeError):
        fitter.fit(np.zeros((2, reference.N - 1, 3)))
    with pytest.raises(ShapeError):
        fitter.fit(np.zeros((2, reference.N, 3)), np.ones((3, reference.N), bool))
    holes = np.zeros((2, reference.N, 3))
    holes[1, 4] = np.nan
    with pytest.raises(ValueRangeError, match="finite"):
        fitter.fit(holes)


def test_no_frames_have_no_coefficients(rng):
    model = reference.small_model(rng)
    fitter = RegionFitter(model)
    assert fitter.fit(np.zeros((0, reference.N, 3))).shape == (0, 15)
    assert fitter.reconstruct(np.zeros((0, 15))).shape == (0, reference.N, 3)
