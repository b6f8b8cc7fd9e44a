import numpy as np

from facewright.camera.rotation import rotation_from_head_angles
from facewright.fitting.rest_appearance import RestAppearance, SkinSamples, light_slope, light_terms


def make_samples(rng, K=40, N=400):
    """Return samples of skin under a known light while the head turns, and the truth."""
    normals = rng.normal(size=(N, 3)) * [0.5, 0.5, 0.2] - [0, 0, 1.0]
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    light = np.array([0.15, -0.3, -0.1, 0.05, 0.08, -0.05, 0.03, 0.1])
    brightness = 120.0 * np.exp(rng.normal(0, 0.1, N))
    turned = np.stack([normals @ rotation_from_head_angles(*rng.normal(0, 12, 3)).T for _ in range(K)])
    exposure = rng.normal(0, 0.05, K)
    exposure -= exposure.mean()
    shading = light_terms(turned) @ light
    levels = brightness * np.exp(shading + exposure[:, None]) + rng.normal(0, 1.0, (K, N))
    samples = SkinSamples(levels, turned, np.ones((K, N)), np.zeros((K, N)))
    return samples, light, shading, exposure


def test_brightness_and_light_are_told_apart(rng):
    samples, _, shading, exposure = make_samples(rng)
    look = RestAppearance.learned(samples)
    ours = look.brightness * np.exp(light_terms(samples.normals) @ look.light)
    true = samples.brightness / np.exp(exposure)[:, None]
    assert np.abs(ours / true - 1.0).mean() < 0.02
    # what a change of the normal does, rather than what a point is like
    change = light_terms(samples.normals) @ look.light
    a, b = change - change.mean(axis=0), shading - shading.mean(axis=0)
    assert np.corrcoef(a.ravel(), b.ravel())[0, 1] > 0.98
    assert 0.3 < np.median(look.noise) < 3.0


def test_what_is_misread_or_hidden_does_not_count(rng):
    samples, *_ = make_samples(rng)
    clean = RestAppearance.learned(samples)
    spoiled, seen = samples.brightness.copy(), samples.seen.copy()
    spoiled[:8, ::3] = 250.0  # a hand before the face
    seen[8:12] = 0.0
    spoiled[8:12] = 5.0
    seen[:, 7] = 0.0
    look = RestAppearance.learned(SkinSamples(spoiled, samples.normals, seen, samples.displaced))
    others = np.arange(400) != 7
    assert np.abs(look.brightness[others] / clean.brightness[others] - 1.0).mean() < 0.02
    assert np.isinf(look.noise[7]) and np.isfinite(look.noise[others]).all()


def test_points_that_an_expression_moves_count_less(rng):
    samples, *_ = make_samples(rng)
    clean = RestAppearance.learned(samples)
    levels, displaced = samples.brightness.copy(), samples.displaced.copy()
    levels[::2, :50] *= 1.1
    displaced[::2, :50] = 10.0
    shift = [
        np.abs(
            RestAppearance.learned(SkinSamples(levels, samples.normals, samples.seen, d)).brightness / clean.brightness
        )
        for d in (displaced, np.zeros_like(displaced))
    ]
    assert abs(shift[0][:50].mean() - 1.0) < 0.5 * abs(shift[1][:50].mean() - 1.0)


def test_slope_of_the_light(rng):
    light, n, h = rng.normal(size=8), rng.normal(size=3), 1e-6
    value, *slope = light_slope(light, *n)
    np.testing.assert_allclose(value, light_terms(n) @ light, rtol=1e-12)
    numeric = [(light_terms(n + h * e) - light_terms(n - h * e)) @ light / (2 * h) for e in np.eye(3)]
    np.testing.assert_allclose(slope, numeric, rtol=1e-6, atol=1e-8)
