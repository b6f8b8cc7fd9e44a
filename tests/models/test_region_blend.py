"""Boundaries made one."""

import importlib.util
from pathlib import Path

import numpy as np
import pytest

from facewright.errors import ShapeError
from facewright.models.region_blend import RegionBlend, blended_sequence
from facewright.models.regions import Regions

_spec = importlib.util.spec_from_file_location("reference_regions", Path(__file__).with_name("reference_regions.py"))
reference = importlib.util.module_from_spec(_spec)
_spec.loader.exec_module(reference)


def test_average_is_the_mean_of_the_copies(rng):
    model = reference.small_model(rng, centred=True)
    zeta = rng.normal(size=15)
    np.testing.assert_allclose(RegionBlend(model).displacements(zeta), reference.naive_average(model, zeta), atol=1e-12)


def test_gradient_keeps_the_averages_and_smooths_what_lies_beside(rng):
    model = reference.small_model(rng)
    zeta = rng.normal(size=15) * 3
    average = RegionBlend(model).displacements(zeta)
    gradient = RegionBlend(model, "gradient").displacements(zeta)
    shared = model.regions.count > 1
    np.testing.assert_allclose(gradient[shared], average[shared], atol=1e-12)
    assert np.abs(gradient - average)[~shared].max() > 0.05
    # Laplacian coordinates of each region, umbrella weights, are nearer to the region's own
    rough = [_bending(model, i, blended, zeta) for i in range(3) for blended in (average, gradient)]
    assert sum(rough[1::2]) < 0.5 * sum(rough[0::2])


def _bending(model, i, blended, zeta):
    """Squared change of the Laplacian coordinates inside a region by blending."""
    ids = model.regions.members[i].tolist()
    c = zeta[model.offsets[i] : model.offsets[i + 1]]
    change = blended[ids] - (model.means[i] + np.tensordot(c, model.bases[i], 1))
    total = 0.0
    for k, v in enumerate(ids):
        inside = model.faces[np.isin(model.faces, ids).all(axis=1)]
        near = sorted(set(inside[(inside == v).any(axis=1)].ravel().tolist()) - {v})
        total += ((change[k] - np.mean([change[ids.index(n)] for n in near], axis=0)) ** 2).sum() if near else 0.0
    return total


@pytest.mark.parametrize("method", ["average", "gradient"])
def test_where_copies_agree_blending_changes_nothing(rng, method):
    regions = reference.grid_regions()
    model = reference.small_model(rng, regions=Regions.holistic(reference.N))
    cut = reference.small_model(rng, regions=regions)
    cut = type(cut)(**{**cut.__dict__, "bases": tuple(model.bases[0][:, ids] for ids in regions.members)})
    zeta = np.tile(rng.normal(size=5), 3)
    np.testing.assert_allclose(
        RegionBlend(cut, method).displacements(zeta), RegionBlend(model).displacements(zeta[:5]), atol=1e-9
    )
    assert RegionBlend(cut).gaps(zeta).max_mm < 1e-9


def test_gaps_are_distances_of_copies(rng):
    model = reference.small_model(rng)
    zeta = rng.normal(size=15)
    lengths = []
    for v in range(reference.N):
        copies = []
        for i, ids in enumerate(model.regions.members):
            if v in ids:
                c = zeta[model.offsets[i] : model.offsets[i + 1]]
                copies.append(np.tensordot(c, model.bases[i][:, ids.tolist().index(v)], 1))
        lengths += [np.linalg.norm(a - b) for k, a in enumerate(copies) for b in copies[k + 1 :]]
    gaps = RegionBlend(model).gaps(zeta)
    assert gaps.mean_mm == pytest.approx(np.mean(lengths)) and gaps.max_mm == pytest.approx(max(lengths))


@pytest.mark.parametrize("method", ["average", "gradient"])
def test_the_linear_map_is_what_blending_does(rng, method):
    model = reference.small_model(rng, centred=True)
    blend = RegionBlend(model, method)
    mean, basis = blend.linear_map()
    zeta = rng.normal(size=(4, 15))
    expected = [blend.positions(row).copy() for row in zeta]
    np.testing.assert_allclose(model.neutral + mean + np.tensordot(zeta, basis, 1), expected, atol=1e-10)
    np.testing.assert_allclose(blended_sequence(model, zeta, method), expected, atol=1e-10)


def test_wrong_shapes_are_refused(rng):
    blend = RegionBlend(reference.small_model(rng))
    with pytest.raises(ShapeError, match="zeta"):
        blend.displacements(np.zeros(14))
    with pytest.raises(ShapeError, match="out"):
        blend.positions(np.zeros(15), np.zeros((2, 3)))
