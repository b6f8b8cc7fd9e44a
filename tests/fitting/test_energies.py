import numpy as np
import pytest

from facewright.fitting.energies.expression_prior import ExpressionPrior
from facewright.fitting.energies.identity_prior import IdentityPrior
from facewright.fitting.energies.landmark_term import landmark_energy, noise_px, robust_weights


def test_weights_are_the_gradient_of_the_energy(rng):
    """d energy / d r = w r, which makes re-weighted least squares descend it."""
    residuals, sigma, h = rng.normal(size=(6, 2)) * 5, rng.uniform(0.5, 2, 6), 1e-6
    gradient = np.zeros_like(residuals)
    for index in np.ndindex(residuals.shape):
        step = np.zeros_like(residuals)
        step[index] = h
        gradient[index] = (landmark_energy(residuals + step, sigma) - landmark_energy(residuals - step, sigma)) / (
            2 * h
        )
    np.testing.assert_allclose(robust_weights(residuals, sigma)[:, None] * residuals, gradient, rtol=1e-5, atol=1e-7)


def test_missing_points_weigh_nothing(rng):
    sigma = noise_px(2.0, 1.0, np.array([1.0, 0.25, 0.0]))
    np.testing.assert_allclose(sigma, [2.0, 4.0, np.inf])
    residuals = rng.normal(size=(3, 2))
    assert robust_weights(residuals, sigma)[2] == 0
    assert landmark_energy(residuals, sigma) == landmark_energy(residuals[:2], sigma[:2])


def test_outliers_are_damped():
    sigma = np.ones(2)
    w = robust_weights(np.array([[0.1, 0.0], [30.0, 0.0]]), sigma)
    assert w[1] < 0.01 * w[0]


def test_expression_prior_gradient(rng):
    prior, beta, h = ExpressionPrior(0.3, 1.5), rng.uniform(0, 1, 5), 1e-6
    numeric = [(prior.energy(beta + h * e) - prior.energy(beta - h * e)) / (2 * h) for e in np.eye(5)]
    np.testing.assert_allclose(prior.gradient(beta), numeric, rtol=1e-6)


def test_identity_prior_spans_the_training_spread(small_model):
    prior = IdentityPrior.of(small_model)
    np.testing.assert_allclose(
        prior.axes @ prior.axes.T,
        small_model.identity_covariance,
        atol=1e-6 * np.trace(small_model.identity_covariance),
    )
    np.testing.assert_array_equal(prior.weights(np.zeros(prior.axes.shape[1])), small_model.identity_mean)


def test_training_people_are_typical(small_model):
    prior = IdentityPrior.of(small_model)
    c = np.linalg.lstsq(prior.axes, (small_model.identity_weights - prior.mean).T, rcond=None)[0]
    assert (c**2).mean() == pytest.approx(1.0, rel=0.05)
