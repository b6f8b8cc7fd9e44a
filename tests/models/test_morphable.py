import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from facewright.errors import ShapeError, ValueRangeError
from facewright.models.morphable import MorphableModel


@pytest.fixture(scope="module")
def samples():
    rng = np.random.default_rng(3)
    modes = rng.normal(size=(5, 30, 3)) * np.array([5, 3, 2, 1, 0.5])[:, None, None]
    return 100 + np.einsum("ni,ivc->nvc", rng.normal(size=(40, 5)), modes)


def test_modes_are_principal_components_at_one_standard_deviation(samples):
    model = MorphableModel.from_samples(samples, 5)
    flat = (samples - samples.mean(0)).reshape(40, -1)
    _, s, vt = np.linalg.svd(flat, full_matrices=False)
    basis = model.identity_basis.reshape(5, -1)
    np.testing.assert_allclose(np.linalg.norm(basis, axis=1), s[:5] / np.sqrt(39), rtol=1e-5)
    np.testing.assert_allclose(np.abs(np.sum(basis * vt[:5], axis=1)), s[:5] / np.sqrt(39), rtol=1e-5)


def test_training_coefficients_have_unit_variance(samples):
    model = MorphableModel.from_samples(samples, 5)
    c = np.array([model.project(x) for x in samples])
    np.testing.assert_allclose(np.cov(c, rowvar=False), np.eye(5), atol=1e-3)
    np.testing.assert_allclose(model.synthesise(c[3]), samples[3], atol=1e-3)


@settings(max_examples=30, deadline=None)
@given(st.lists(st.floats(-3, 3), min_size=5, max_size=5))
def test_project_inverts_synthesise(c):
    rng = np.random.default_rng(0)
    model = MorphableModel.from_samples(rng.normal(size=(12, 20, 3)) * 10, 5)
    np.testing.assert_allclose(model.project(model.synthesise(np.array(c))), c, atol=1e-4)


def test_noise_shrinks_and_weights_ignore(samples, rng):
    model = MorphableModel.from_samples(samples, 5)
    c = rng.normal(size=5)
    face = model.synthesise(c)
    assert np.linalg.norm(model.project(face, noise_mm=20.0)) < np.linalg.norm(c)
    broken = face.copy()
    broken[4] = np.nan
    weights = np.ones(30)
    weights[4] = 0
    np.testing.assert_allclose(model.project(broken, vertex_weights=weights), c, atol=1e-3)


def test_fewer_coefficients_and_truncated_agree(samples, rng):
    model = MorphableModel.from_samples(samples, 5)
    c = rng.normal(size=2)
    np.testing.assert_array_equal(model.synthesise(c), model.truncated(2).synthesise(c))


def test_sample_is_reproducible_and_varies(samples):
    model = MorphableModel.from_samples(samples, 5)
    a, b = (model.sample(np.random.default_rng(1)) for _ in range(2))
    np.testing.assert_array_equal(a, b)
    assert np.abs(a - model.mean_shape).max() > 0.1


def test_guards(samples):
    model = MorphableModel.from_samples(samples, 5)
    with pytest.raises(ShapeError, match="samples"):
        MorphableModel.from_samples(samples[0], 2)
    with pytest.raises(ValueRangeError, match=r"n_modes must be in \[1, 39\]"):
        MorphableModel.from_samples(samples, 40)
    with pytest.raises(ValueRangeError, match="at most 5"):
        MorphableModel.from_samples(samples, 6)
    with pytest.raises(ValueRangeError, match="finite"):
        MorphableModel.from_samples(np.full((4, 3, 3), np.nan), 2)
    with pytest.raises(ValueRangeError, match="coefficients"):
        model.synthesise(np.zeros(6))
    with pytest.raises(ValueRangeError, match="finite"):
        model.synthesise(np.full(5, np.inf))
    with pytest.raises(ShapeError, match="vertices"):
        model.project(np.zeros((29, 3)))
    with pytest.raises(ValueRangeError, match="negative"):
        model.project(np.zeros((30, 3)), noise_mm=-1)
    with pytest.raises(ValueRangeError, match="n_modes"):
        model.truncated(6)
    with pytest.raises(ShapeError, match="identity_basis"):
        MorphableModel(model.mean_shape, model.identity_basis[:, :3])
