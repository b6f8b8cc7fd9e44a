"""PCA of regions, blendshapes and other bases."""

import importlib.util
from pathlib import Path

import numpy as np
import pytest

from facewright.errors import ShapeError, ValueRangeError
from facewright.models.blendshapes import BlendshapeRig
from facewright.models.region_fit import RegionFitter
from facewright.models.region_pca import fit_region_pca, linear_region_model, region_basis
from facewright.models.regions import Regions

_spec = importlib.util.spec_from_file_location("reference_regions", Path(__file__).with_name("reference_regions.py"))
reference = importlib.util.module_from_spec(_spec)
_spec.loader.exec_module(reference)


def _train(moves, components, regions=None, **options):
    return fit_region_pca(
        moves,
        reference.grid_faces(),
        reference.grid_neutral(),
        regions or reference.grid_regions(),
        components,
        **options,
    )


@pytest.mark.parametrize("centred", [False, True])
def test_bases_are_the_leading_singular_vectors_of_each_region(rng, centred):
    moves = reference.smooth_motion(rng, 40)
    model = _train(moves, 4, centred=centred)
    for i, ids in enumerate(model.regions.members):
        data = moves[:, ids].reshape(40, -1)
        data = data - data.mean(axis=0) if centred else data
        _, values, vectors = np.linalg.svd(data, full_matrices=False)
        B = reference.matrix(model, i)
        np.testing.assert_allclose(B.T @ B, np.eye(4), atol=1e-12)
        np.testing.assert_allclose(np.abs(vectors[:4] @ B), np.eye(4), atol=1e-7)
        np.testing.assert_allclose(model.deviations[i], values[:4] / np.sqrt(40), rtol=1e-9)
        assert (B[np.abs(B).argmax(axis=0), np.arange(4)] > 0).all()


def test_zero_coefficients_are_the_neutral_unless_centred(rng):
    moves = reference.smooth_motion(rng, 40) + 3.0
    assert all(not mean.any() for mean in _train(moves, 4).means)
    centred = _train(moves, 4, centred=True)
    np.testing.assert_allclose(centred.means[1], moves.mean(axis=0)[centred.regions.members[1]], atol=1e-12)


def test_one_region_is_the_holistic_model(rng):
    moves = reference.smooth_motion(rng, 40)
    model = _train(moves, 6, Regions.holistic(reference.N))
    values = np.linalg.svd(moves.reshape(40, -1), compute_uv=False)
    np.testing.assert_allclose(model.deviations[0], values[:6] / np.sqrt(40), rtol=1e-9)


def test_a_share_keeps_as_few_components_as_hold_it(rng):
    moves = reference.smooth_motion(rng, 40)
    model = _train(moves, 0.95)
    for i, ids in enumerate(model.regions.members):
        power = np.linalg.svd(moves[:, ids].reshape(40, -1), compute_uv=False) ** 2
        shares = np.cumsum(power) / power.sum()
        P = len(model.bases[i])
        assert shares[P - 1] >= 0.95 and (P == 1 or shares[P - 2] < 0.95)


def test_more_components_than_the_data_have_are_left_out(rng):
    moves = np.einsum("tk,knc->tnc", rng.normal(size=(30, 2)), reference.smooth_motion(rng, 2))
    assert [len(basis) for basis in _train(moves, 9).bases] == [2, 2, 2]


def test_a_region_that_never_moves_has_no_components(rng):
    moves = reference.smooth_motion(rng, 20)
    moves[:, reference.grid_regions().members[0]] = 0.0
    model = _train(moves, 3)
    assert [len(basis) for basis in model.bases] == [0, 3, 3]
    zeta = RegionFitter(model).fit(moves)
    assert np.isfinite(zeta).all() and zeta.shape == (20, 6)


@pytest.mark.parametrize(
    ("moves", "components", "error"),
    [
        (np.zeros((1, reference.N, 3)), 3, ValueRangeError),
        (np.zeros((5, reference.N - 1, 3)), 3, ShapeError),
        (np.full((5, reference.N, 3), np.nan), 3, ValueRangeError),
        (np.zeros((5, reference.N, 3)), 0, ValueRangeError),
        (np.zeros((5, reference.N, 3)), 2.5, ValueRangeError),
        (np.zeros((5, reference.N, 3)), -0.5, ValueRangeError),
    ],
)
def test_what_cannot_be_learned_from_is_refused(moves, components, error):
    with pytest.raises(error):
        _train(moves, components)


def test_blendshapes_belong_to_the_regions_that_they_move(rng):
    regions = reference.grid_regions()
    deltas = reference.smooth_motion(rng, 3).astype(np.float32)
    deltas[1, regions.members[0]] = 0.0
    rig = BlendshapeRig(reference.grid_neutral().astype(np.float32), ("a", "b", "c"), deltas)
    model = region_basis(rig, regions, reference.grid_faces())
    assert model.coefficient_names[0] == ("l_a", "l_c")
    assert [len(basis) for basis in model.bases] == [2, 3, 3]
    assert all((low == 0).all() and (high == 1).all() for low, high in zip(model.lower, model.upper, strict=True))
    np.testing.assert_allclose(model.units[1], np.linalg.norm(deltas[:, regions.members[1]].reshape(3, -1), axis=1))
    weights = np.array([0.25, 0.5, 1.0])
    zeta = RegionFitter(model, 0.5).fit((rig.pose(weights) - rig.neutral)[None])[0]
    np.testing.assert_allclose(zeta[2:5], weights, atol=1e-4)


def test_a_basis_needs_a_name_for_each_vector():
    with pytest.raises(ShapeError, match="one name for each of 2"):
        linear_region_model(
            reference.grid_neutral(),
            np.ones((2, reference.N, 3)),
            ("a",),
            reference.grid_regions(),
            reference.grid_faces(),
        )
