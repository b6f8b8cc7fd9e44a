import numpy as np
import pytest

from facewright.errors import ShapeError
from facewright.fitting.lip_closure import lip_closure, lip_gap_row, with_lips_closed
from facewright.models.blendshapes import BlendshapeRig

NAMES = ("jawOpen", "mouthClose", "mouthPucker")


def points(gap):
    p = np.zeros((1, 478, 2))
    p[0, 263] = 100.0, 0.0
    p[0, [87, 14, 317], 1] = gap
    return p


@pytest.mark.parametrize(("gap", "closure"), [(0.0, 1.0), (0.5, 1.0), (1.05, 0.5), (1.6, 0.0), (9.0, 0.0)])
def test_lips_touch_up_to_the_detectors_noise(gap, closure):
    np.testing.assert_allclose(lip_closure(points(gap)), [closure], atol=1e-12)


def test_the_row_is_the_gap_in_the_middle():
    neutral = np.zeros((8, 3), np.float32)
    neutral[:4, 0] = neutral[4:, 0] = -20, -1, 1, 20
    deltas = np.zeros((2, 8, 3), np.float32)
    deltas[0, 4:, 1] = -10  # the lower lip goes down
    deltas[0, [4, 7], 1] = -2  # and less at the corners, which do not count
    deltas[1, 4:, 1] = 8
    row = lip_gap_row(BlendshapeRig(neutral, ("jawOpen", "mouthClose"), deltas), np.arange(4), np.arange(4, 8))
    np.testing.assert_allclose(row, [10.0, -8.0])


def test_touching_lips_close_by_the_least_change_and_open_ones_stay(rng):
    weights, row = rng.uniform(0, 0.6, (40, 3)), np.array([30.0, -28.0, 2.0])
    closure = np.repeat([1.0, 0.0, 0.5], [15, 15, 10])
    result = with_lips_closed(weights, NAMES, closure, row)
    before, after = np.maximum(weights @ row, 0), np.maximum(result @ row, 0)
    np.testing.assert_allclose(after, (1 - closure) * before, atol=1e-9)
    np.testing.assert_array_equal(result[15:30], weights[15:30])
    np.testing.assert_array_equal(result[:, 2], weights[:, 2])
    shut = weights @ row <= 0
    np.testing.assert_array_equal(result[shut], weights[shut])
    assert result.min() >= 0
    assert result.max() <= 1


def test_a_mouth_close_at_its_end_leaves_the_rest_to_the_jaw():
    result = with_lips_closed(np.array([[1.0, 0.95, 0.0]]), NAMES, np.ones(1), np.array([40.0, -10.0, 0.0]))
    np.testing.assert_allclose(result, [[0.25, 1.0, 0.0]])


def test_models_without_the_shapes_stay():
    weights = np.full((2, 1), 0.5)
    np.testing.assert_array_equal(with_lips_closed(weights, ("jawOpen",), np.ones(2), np.array([30.0])), weights)


def test_other_sizes_are_refused():
    with pytest.raises(ShapeError, match="closure"):
        with_lips_closed(np.zeros((2, 3)), NAMES, np.ones(3), np.ones(3))
    with pytest.raises(ShapeError, match="points"):
        lip_closure(np.zeros((2, 68, 2)))
