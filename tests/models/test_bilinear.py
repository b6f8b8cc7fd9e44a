import importlib.util
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from facewright.errors import ShapeError, ValueRangeError
from facewright.models.bilinear import fit_bilinear

_spec = importlib.util.spec_from_file_location("reference_bilinear", Path(__file__).with_name("reference_bilinear.py"))
reference = importlib.util.module_from_spec(_spec)
_spec.loader.exec_module(reference)


def test_scaling_training_weights_have_unit_mean_square(model):
    N, S = len(model.identity_weights), len(model.expression_weights)
    np.testing.assert_allclose(model.identity_weights.T @ model.identity_weights, N * np.eye(8), atol=1e-9)
    np.testing.assert_allclose(model.expression_weights.T @ model.expression_weights, S * np.eye(6), atol=1e-9)
    assert np.abs(model.identity_weights[:, 0] - 1).max() < 0.1  # the mean face


def test_training_cells_are_reproduced_to_the_truncation_error(population):
    topology_free = {"expression_names": [str(i) for i in range(9)]}
    from facewright.mesh.topology import Topology

    topology = Topology("dots", population.shape[2], np.array([[0, 1, 2]], dtype=np.int32))
    full = fit_bilinear(population, 16, 9, topology=topology, **topology_free)
    for n, s in ((0, 0), (3, 7), (15, 8)):
        face = full.synthesise(full.identity_weights[n], full.expression_weights[s])
        np.testing.assert_allclose(face, population[n, s], atol=5e-4)


def test_synthesise_is_equation_10(model, rng):
    w_id, w_exp = model.sample_identity(rng), model.sample_expression(rng)
    expected = reference.contract(model.core, w_id, w_exp)
    np.testing.assert_allclose(model.synthesise(w_id, w_exp), expected, atol=1e-3)
    np.testing.assert_allclose(np.tensordot(w_exp, model.person(w_id), 1), expected, atol=1e-3)
    np.testing.assert_allclose(np.tensordot(w_id, model.expression(w_exp), 1), expected, atol=1e-3)
    assert model.synthesise(w_id, w_exp).dtype == np.float32


def test_core_is_a_view_in_the_papers_order(model):
    assert model.core.shape == (model.n_vertices, 3, 8, 6)
    assert np.shares_memory(model.core, model.core_rows)
    assert model.core[5, 1, 2, 3] == model.core_rows[2, 3, 5, 1]


def test_blendshapes_are_equation_17(model, rng):
    w_id = model.sample_identity(rng)
    rig = model.blendshapes(w_id)
    assert rig.names == model.expression_names[1:]
    np.testing.assert_allclose(rig.neutral, model.synthesise(w_id, model.expression_weights[0]), atol=1e-3)
    for i, name in enumerate(rig.names, start=1):
        expected = model.synthesise(w_id, model.expression_weights[i])
        np.testing.assert_allclose(rig.shape(name), expected, atol=1e-3)


def test_expression_from_blendshapes_matches_the_rig(model, rng):
    w_id, beta = model.sample_identity(rng), rng.uniform(size=8)
    face = model.synthesise(w_id, model.expression_from_blendshapes(beta))
    np.testing.assert_allclose(face, model.blendshapes(w_id).pose(beta), atol=1e-3)


def test_prior_is_the_training_weights(model):
    np.testing.assert_allclose(model.identity_mean, model.identity_weights.mean(0))
    d = model.identity_weights - model.identity_mean
    np.testing.assert_allclose(model.identity_covariance, d.T @ d / len(d), atol=1e-12)
    draws = np.array([model.sample_identity(np.random.default_rng(i)) for i in range(500)])
    np.testing.assert_allclose(draws.mean(0), model.identity_mean, atol=0.2)
    np.testing.assert_allclose(draws.std(0)[1:], np.sqrt(np.diag(model.identity_covariance))[1:], rtol=0.2)


def test_precisions_are_inverse_covariances_and_stiff_along_the_mean(model):
    for mean, covariance, precision in (
        (model.identity_mean, model.identity_covariance, model.identity_precision),
        (model.expression_mean, model.expression_covariance, model.expression_precision),
    ):
        tangent = np.linalg.qr(mean[:, None], mode="complete")[0][:, 1:]
        identity = tangent.T @ precision @ covariance @ tangent
        np.testing.assert_allclose(identity, np.eye(len(mean) - 1), atol=1e-6)
        assert mean @ precision @ mean / (mean @ mean) == pytest.approx(1e4, rel=0.01)


def test_gauge(model, rng):
    w_id, w_exp = model.sample_identity(rng), model.sample_expression(rng)
    a, b = model.in_gauge(w_id, w_exp)
    assert model.expression_gauge @ b == pytest.approx(1)
    np.testing.assert_allclose(model.synthesise(a, b), model.synthesise(w_id, w_exp), atol=1e-3)
    np.testing.assert_allclose(model.in_gauge(a, b)[0], a)
    assert model.expression_gauge @ model.expression_mean == pytest.approx(1)
    assert np.abs(model.expression_weights @ model.expression_gauge - 1).max() < 0.05
    with pytest.raises(ValueRangeError, match="along the mean"):
        model.in_gauge(w_id, np.zeros(6))


def test_truncated_is_the_corner_of_the_core(model, rng):
    small = model.truncated(3, 2)
    assert (small.n_identity, small.n_expression) == (3, 2)
    w_id, w_exp = rng.normal(size=3), rng.normal(size=2)
    padded = model.synthesise(np.r_[w_id, np.zeros(5)], np.r_[w_exp, np.zeros(4)])
    np.testing.assert_allclose(small.synthesise(w_id, w_exp), padded, atol=1e-3)
    with pytest.raises(ValueRangeError, match=r"n_identity must be in \[1, 8\]"):
        model.truncated(9, 2)
    with pytest.raises(ValueRangeError, match="n_expression"):
        model.truncated(2, 0)


def test_at_vertices(model, rng):
    ids = np.array([7, 3, 3, 100])
    points = model.at_vertices(ids)
    w_id, w_exp = model.sample_identity(rng), model.sample_expression(rng)
    expected = model.synthesise(w_id, w_exp)[ids]
    np.testing.assert_allclose(points.positions(w_id, w_exp), expected, atol=1e-3)
    np.testing.assert_allclose(points.identity_matrix(w_exp) @ w_id, expected, atol=1e-3)
    np.testing.assert_allclose(points.expression_matrix(w_id) @ w_exp, expected, atol=1e-3)
    np.testing.assert_allclose(points.select([3, 0]).positions(w_id, w_exp), expected[[3, 0]], atol=1e-3)
    with pytest.raises(ValueRangeError, match="vertex_ids"):
        model.at_vertices([model.n_vertices])
    with pytest.raises(ValueRangeError, match="vertex_ids"):
        model.at_vertices([-1])


def test_mean_face_is_near_the_mean_neutral(model, population):
    distance = np.linalg.norm(model.mean_face - population[:, 0].mean(0), axis=1)
    assert np.sqrt((distance**2).mean()) < 0.7  # truncated to 6 of 9 expression components


def test_guards(model, population):
    with pytest.raises(ShapeError, match="w_id"):
        model.synthesise(np.zeros(7), np.zeros(6))
    with pytest.raises(ShapeError, match="w_exp"):
        model.expression(np.zeros(7))
    with pytest.raises(ValueRangeError, match="w_exp must be finite"):
        model.synthesise(np.zeros(8), np.full(6, np.nan))
    with pytest.raises(ShapeError, match="beta"):
        model.expression_from_blendshapes(np.zeros(9))
    with pytest.raises(ShapeError, match=r"tensor must have shape \(N, 1, 180, 3\), got"):
        fit_bilinear(population, 3, 3, topology=model.topology, expression_names=["neutral"])
    with pytest.raises(ShapeError, match="one name per shape"):
        fit_bilinear([population], 3, 3, topology=model.topology, expression_names=["neutral"])
    with pytest.raises(ShapeError, match="core_rows"):
        replace(model, core_rows=model.core_rows[:, :, :-1])
    with pytest.raises(ShapeError, match="C-contiguous float32"):
        replace(model, core_rows=model.core_rows.astype(float))
    with pytest.raises(ShapeError, match="expression_weights"):
        replace(model, expression_weights=model.expression_weights[:, :3])
