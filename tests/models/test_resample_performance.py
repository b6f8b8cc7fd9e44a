"""A performance at other moments."""

from __future__ import annotations

from fractions import Fraction

import numpy as np
import pytest

from facewright.camera.rotation import rotation_from_head_angles
from facewright.errors import ValueRangeError
from facewright.models.performance import Performance
from facewright.models.resample_performance import resampled, usual_rate


def ramp(n: int = 11) -> Performance:
    times = np.arange(n) / 10
    rotations = np.array([rotation_from_head_angles(30 * t, 0, 0) for t in times])
    gaze = np.repeat(times, 4).reshape(n, 2, 2) * 0.1
    tracked = np.ones(n, bool)
    tracked[5:6] = False
    return Performance(times, ("jawOpen",), times[:, None], rotations, times[:, None] * [1.0, 2, 3], gaze, tracked)


def test_linear_motion_stays_linear(rng: np.random.Generator) -> None:
    times = np.sort(rng.uniform(0, 1, 40))
    between = resampled(ramp(), times)
    np.testing.assert_allclose(between.weights[:, 0], times, atol=1e-12)
    np.testing.assert_allclose(between.gaze, 0.1 * times[:, None, None] * np.ones((1, 2, 2)), atol=1e-12)
    expected = np.array([rotation_from_head_angles(30 * t, 0, 0) for t in times])
    np.testing.assert_allclose(between.rotations, expected, atol=1e-12)
    np.testing.assert_array_equal(between.tracked, np.abs(times - 0.5) > 0.05)


def test_same_times_give_the_same() -> None:
    again = resampled(ramp(), ramp().times)
    np.testing.assert_allclose(again.weights, ramp().weights, atol=1e-12)
    np.testing.assert_array_equal(again.tracked, ramp().tracked)
    one = resampled(ramp(1), np.zeros(1))
    assert one.n_frames == 1


def test_times_outside_are_refused() -> None:
    with pytest.raises(ValueRangeError, match="must lie in"):
        resampled(ramp(), np.array([0.5, 1.2]))


def test_usual_rate() -> None:
    assert usual_rate(np.arange(20) * 1001 / 30000) == Fraction(30000, 1001)
    jitter = np.array([0, 0.0333167, 0.0666667, 0.1, 0.1333167, 0.2, 0.2333333])
    assert usual_rate(jitter) == 30
    assert usual_rate(np.arange(9) / 15) == 15
    assert usual_rate(np.zeros(1)) == 30
