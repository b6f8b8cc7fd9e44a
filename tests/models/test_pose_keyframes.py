import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.interpolate import PchipInterpolator

from facewright.errors import ShapeError, ValueRangeError
from facewright.models.pose_keyframes import PoseKeyframes


def _keys(rng, K=5, P=7):
    return PoseKeyframes(np.cumsum(rng.uniform(0.1, 1.0, K)), rng.normal(size=(K, P)))


def test_passes_through_its_keyframes_and_stays_at_the_ends(rng):
    keys = _keys(rng)
    np.testing.assert_allclose(keys.at(keys.times), keys.coefficients, atol=1e-12)
    np.testing.assert_array_equal(keys.at([0.0, 1e6]), keys.coefficients[[0, -1]])


def test_inside_it_is_scipys_monotone_cubic(rng):
    # the slopes at inner keyframes are PCHIP's; only the ends differ, where ours rest
    keys = _keys(rng, K=6)
    t = np.linspace(keys.times[1], keys.times[-2], 200)
    np.testing.assert_allclose(keys.at(t), PchipInterpolator(keys.times, keys.coefficients)(t), atol=1e-12)


@settings(deadline=None, max_examples=60)
@given(st.lists(st.tuples(st.floats(0.01, 3), st.floats(-5, 5)), min_size=2, max_size=8))
def test_never_leaves_the_range_of_the_keyframes_around(steps):
    times = np.cumsum([step for step, _ in steps])
    values = np.array([[value] for _, value in steps])
    keys = PoseKeyframes(times, values)
    for k in range(len(times) - 1):
        between = keys.at(np.linspace(times[k], times[k + 1], 50))
        low, high = sorted(values[k : k + 2, 0])
        assert (between >= low - 1e-9).all() and (between <= high + 1e-9).all()
        steps_between = np.diff(between[:, 0]) * np.sign(values[k + 1, 0] - values[k, 0])
        assert (steps_between >= -1e-9).all()


def test_velocity_is_continuous_and_zero_at_both_ends(rng):
    keys = _keys(rng)
    e = 1e-6
    before, after = keys.at(keys.times - e), keys.at(keys.times + e)
    at = keys.at(keys.times)
    np.testing.assert_allclose((at - before) / e, (after - at) / e, atol=1e-3)
    assert np.abs((after - at)[0] / e).max() < 1e-3 and np.abs((at - before)[-1] / e).max() < 1e-3


def test_keys_are_added_replaced_moved_and_removed(rng):
    keys = PoseKeyframes.none(2)
    keys = keys.with_key(1.0, np.array([1.0, 0.0])).with_key(0.0, np.array([0.0, 0.0]))
    assert keys.times.tolist() == [0.0, 1.0] and keys.duration == 1.0
    keys = keys.with_key(1.0, np.array([2.0, 0.0]))
    assert len(keys) == 2 and keys.coefficients[1, 0] == 2.0
    keys = keys.with_key(0.5, np.array([9.0, 9.0])).moved(2, 0.5)
    assert keys.times.tolist() == [0.0, 0.5] and keys.coefficients[1, 0] == 2.0
    assert keys.index_at(0.52) is None and keys.index_at(0.52, 0.05) == 1
    assert len(keys.without(0).without(0)) == 0 and PoseKeyframes.none(2).index_at(0.0) is None
    one = PoseKeyframes.none(1).with_key(3.0, np.array([4.0]))
    assert one.at([0.0, 9.0]).ravel().tolist() == [4.0, 4.0]


def test_refuses(rng):
    keys = _keys(rng)
    with pytest.raises(ValueRangeError, match="at least one"):
        PoseKeyframes.none(2).at([0.0])
    with pytest.raises(ValueRangeError, match="increase"):
        PoseKeyframes(np.array([1.0, 1.0]), np.zeros((2, 3)))
    with pytest.raises(ValueRangeError, match="increase"):
        PoseKeyframes(np.array([-1.0, 1.0]), np.zeros((2, 3)))
    with pytest.raises(ValueRangeError, match="finite"):
        PoseKeyframes(np.array([0.0, 1.0]), np.full((2, 3), np.nan))
    with pytest.raises(ShapeError):
        PoseKeyframes(np.array([0.0, 1.0]), np.zeros((3, 3)))
    with pytest.raises(ShapeError):
        keys.with_key(0.0, np.zeros(3))
    for time in (-0.1, np.nan):
        with pytest.raises(ValueRangeError, match="0 s or later"):
            keys.with_key(time, np.zeros(7))
    for index in (-1, 5):
        with pytest.raises(ValueRangeError, match=r"\[0, 5\)"):
            keys.without(index)
