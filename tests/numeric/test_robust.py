import numpy as np
import pytest

from facewright.errors import ValueRangeError
from facewright.numeric.robust import huber_weights, median_scale, tukey_weights


def test_weights_are_one_at_zero_and_fall(rng):
    r = np.sort(np.abs(rng.normal(size=50))) * 4
    for function in (huber_weights, tukey_weights):
        w = function(r, 2.0)
        assert function(np.zeros(1), 2.0)[0] == 1.0
        assert (np.diff(w) <= 0).all()
        np.testing.assert_array_equal(w, function(-r, 2.0))
    assert (tukey_weights(np.array([2.0, 9.0]), 2.0) == 0).all()


def test_a_mean_with_tukey_weights_ignores_an_outlier(rng):
    x = np.r_[rng.normal(size=99), 1e6]
    mean = np.median(x)
    for _ in range(20):
        w = tukey_weights(x - mean, 4.7 * median_scale(x - mean))
        mean = (w * x).sum() / w.sum()
    assert abs(mean) < 0.5


def test_median_scale_is_the_deviation_of_normal_noise(rng):
    assert median_scale(rng.normal(size=100_000) * 3) == pytest.approx(3, rel=0.05)


def test_refuses():
    with pytest.raises(ValueRangeError):
        huber_weights(np.zeros(1), 0.0)
    with pytest.raises(ValueRangeError):
        tukey_weights(np.zeros(1), np.nan)
    with pytest.raises(ValueRangeError):
        median_scale(np.zeros(0))
