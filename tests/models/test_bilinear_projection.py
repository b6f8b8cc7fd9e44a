import importlib.util
from pathlib import Path

import numpy as np
import pytest

from facewright.errors import ConvergenceWarning, ShapeError, ValueRangeError
from facewright.models.bilinear_projection import BilinearProjector, gram_of_rows

_spec = importlib.util.spec_from_file_location("reference_bilinear", Path(__file__).with_name("reference_bilinear.py"))
reference = importlib.util.module_from_spec(_spec)
_spec.loader.exec_module(reference)


@pytest.mark.parametrize("seed", range(10))
def test_project_inverts_synthesise(model, seed):
    rng = np.random.default_rng(seed)
    w_id, w_exp = model.in_gauge(model.sample_identity(rng), model.sample_expression(rng))
    found_id, found_exp = model.project(model.synthesise(w_id, w_exp))
    np.testing.assert_allclose(found_id, w_id, atol=2e-4)
    np.testing.assert_allclose(found_exp, w_exp, atol=2e-4)


def test_training_people_get_their_own_weights(model):
    for n, s in ((0, 0), (5, 3), (15, 8)):
        w = model.in_gauge(model.identity_weights[n], model.expression_weights[s])
        found = model.project(model.synthesise(*w))
        np.testing.assert_allclose(found[0], w[0], atol=2e-4)
        np.testing.assert_allclose(found[1], w[1], atol=2e-4)


def test_unseen_mesh_reaches_what_alternation_reaches(model, tensor_maker):
    """Newton from three alternations is at least as near as 300 alternations of dense least squares."""
    target = tensor_maker(np.random.default_rng(7), n_people=17)[16, 5]
    fit = BilinearProjector(model).fit(target)
    _, _, errors = reference.project_by_alternation(model.core, target, model.identity_mean, model.expression_mean, 300)
    assert fit.rms_mm <= errors[-1] + 1e-4
    face = model.synthesise(fit.identity_weights, fit.expression_weights)
    rms = np.sqrt(((face - target) ** 2).sum(1).mean())
    assert fit.rms_mm == pytest.approx(rms, abs=1e-4)
    assert model.expression_gauge @ fit.expression_weights == pytest.approx(1)


def test_gradient_vanishes_at_the_solution(model, tensor_maker):
    """The posterior's gradient by central differences, sigma > 0."""
    target = tensor_maker(np.random.default_rng(7), n_people=17)[16, 2].astype(float)
    sigma = 2.0
    fit = BilinearProjector(model).fit(target, noise_mm=sigma, tolerance_mm=1e-8)
    precision = model.identity_precision
    core = model.core.astype(float)
    m = model.expression_mean
    tangent = np.linalg.qr(m[:, None], mode="complete")[0][:, 1:]
    tangent_precision = tangent.T @ model.expression_precision @ tangent

    def energy(x):
        w_id, w_exp = x[:8], m + tangent @ x[8:]
        d = w_id - model.identity_mean
        data = ((core @ w_exp @ w_id - target) ** 2).sum()
        return data + sigma**2 * (d @ precision @ d + x[8:] @ tangent_precision @ x[8:])

    x = np.r_[fit.identity_weights, tangent.T @ (fit.expression_weights - m)]
    for h in 1e-3 * np.eye(len(x)):
        gradient = (energy(x + h) - energy(x - h)) / 2e-3
        curvature = (energy(x + h) - 2 * energy(x) + energy(x - h)) / 1e-6
        assert abs(gradient / curvature) < 1e-4  # the Newton step still to go


def test_more_noise_pulls_towards_the_prior_mean_not_zero(model, tensor_maker):
    target = tensor_maker(np.random.default_rng(7), n_people=17)[16, 4]
    projector = BilinearProjector(model)
    distances, errors = [], []
    for noise_mm in (0.0, 5.0, 50.0, 5000.0):
        fit = projector.fit(target, noise_mm=noise_mm)
        distances.append(np.linalg.norm(fit.identity_weights - model.identity_mean))
        errors.append(fit.rms_mm)
    assert distances == sorted(distances, reverse=True)
    assert errors == sorted(errors)
    assert distances[-1] < 0.05


def test_vertex_subset_and_weights(model, rng):
    w = model.in_gauge(model.sample_identity(rng), model.sample_expression(rng))
    face = model.synthesise(*w)
    ids = rng.permutation(model.n_vertices)[:60]
    found = model.project(face[ids], vertex_ids=ids)
    np.testing.assert_allclose(model.synthesise(*found), face, atol=5e-2)
    weights = np.zeros(model.n_vertices)
    weights[ids] = rng.uniform(0.5, 2, size=60)
    broken = np.where(weights[:, None] > 0, face, np.nan)
    found = model.project(broken, vertex_weights=weights)
    np.testing.assert_allclose(model.synthesise(*found), face, atol=5e-2)


def test_few_points_with_prior_stay_plausible(model, rng):
    """Ten points cannot determine 14 weights; the prior must keep them finite and small."""
    w = model.in_gauge(model.sample_identity(rng), model.sample_expression(rng))
    ids = np.arange(0, 180, 60)
    fit = BilinearProjector(model, vertex_ids=ids).fit(model.synthesise(*w)[ids], noise_mm=1.0)
    assert np.abs(fit.identity_weights).max() < 6
    assert fit.rms_mm < 2


def test_start_at_the_answer_takes_no_time(model, rng):
    w = model.in_gauge(model.sample_identity(rng), model.sample_expression(rng))
    fit = BilinearProjector(model).fit(model.synthesise(*w), start=w)
    assert fit.iterations <= 3


def test_limit_warns(model, tensor_maker):
    target = tensor_maker(np.random.default_rng(7), n_people=17)[16, 5]
    with pytest.warns(ConvergenceWarning, match="stopped after 1"):
        BilinearProjector(model).fit(target, max_iterations=1)


def test_one_expression_component(model, rng):
    small = model.truncated(5, 1)
    w = small.in_gauge(small.sample_identity(rng), small.expression_mean)
    np.testing.assert_allclose(small.project(small.synthesise(*w))[0], w[0], atol=2e-4)


@pytest.mark.parametrize("columns", [100, 20_000])
def test_gram_of_rows(rng, columns):
    rows = rng.normal(size=(5, columns)).astype(np.float32)
    expected = rows.astype(float) @ rows.T.astype(float)
    np.testing.assert_allclose(gram_of_rows(rows), expected, rtol=1e-5, atol=1e-3 if columns > 6000 else 1e-9)


def test_guards(model):
    face = model.mean_face
    with pytest.raises(ShapeError, match=r"vertices must have shape \(180, 3\) for this model"):
        model.project(face[:-1])
    with pytest.raises(ValueRangeError, match="finite"):
        model.project(np.full_like(face, np.nan))
    with pytest.raises(ValueRangeError, match="noise_mm"):
        model.project(face, noise_mm=-1)
    with pytest.raises(ValueRangeError, match="vertex_ids"):
        model.project(face[:1], vertex_ids=np.array([180]))
    with pytest.raises(ShapeError, match="vertex_weights"):
        model.project(face, vertex_weights=np.ones(3))
    with pytest.raises(ValueRangeError, match="not all zero"):
        model.project(face, vertex_weights=np.zeros(180))
    with pytest.raises(ValueRangeError, match="non-negative"):
        model.project(face, vertex_weights=np.full(180, -1.0))
