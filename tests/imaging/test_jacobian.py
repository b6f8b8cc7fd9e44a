"""Folds are found and smoothed away; occlusions are left alone."""

import numpy as np
import pytest

from facewright.errors import ShapeError
from facewright.imaging._warp_kernels import blocks_with, jacobian_minimum
from facewright.imaging.jacobian import untangle

NONE = np.zeros((1, 1), bool)


def _naive_minimum(displacement, breaks, offset):
    h, w = displacement.shape[:2]
    least = np.inf
    for y in range(h - 1):
        for x in range(w - 1):
            v, u = y - offset[1], x - offset[0]
            if 0 <= v < breaks.shape[0] and 0 <= u < breaks.shape[1] and breaks[v, u]:
                continue
            dx = displacement[y, x + 1] - displacement[y, x] + (1, 0)
            dy = displacement[y + 1, x] - displacement[y, x] + (0, 1)
            least = min(least, dx[0] * dy[1] - dx[1] * dy[0])
    return least


def test_the_smallest_determinant_is_that_of_a_naive_loop(rng):
    for _ in range(5):
        d = rng.normal(0, 0.5, (23, 31, 2)).astype(np.float32)
        breaks = rng.random((9, 11)) < 0.3
        bad = np.zeros(d.shape[:2], np.float32)
        found, count = jacobian_minimum(d, breaks, (4, 3), bad)
        assert found == pytest.approx(_naive_minimum(d, breaks, (4, 3)), abs=1e-5)
        assert count == (bad == 1).sum() > 0


@pytest.mark.parametrize("height", [12.0, 30.0])
def test_a_fold_is_smoothed_away_and_nothing_else_changes(height):
    y, x = np.mgrid[:160, :160]
    bump = height * np.exp(-((x - 80) ** 2 + (y - 80) ** 2) / 50.0)  # folds: its slope is beyond -1
    d = np.stack([bump, np.zeros_like(bump)], axis=-1).astype(np.float32)
    before = d.copy()
    assert _naive_minimum(d, NONE, (0, 0)) < 0
    done = untangle(d, NONE)
    assert done.rounds > 0
    assert 0 < done.smallest == pytest.approx(_naive_minimum(d, NONE, (0, 0)), abs=1e-4)
    far = (abs(x - 80) > 70) | (abs(y - 80) > 70)
    np.testing.assert_array_equal(d[far], before[far])


def test_a_smooth_map_is_left_as_it_is(rng):
    y, x = np.mgrid[:80, :90]
    d = np.stack([5 * np.sin(x / 20), 4 * np.cos(y / 15)], axis=-1).astype(np.float32)
    before = d.copy()
    done = untangle(d, NONE)
    assert done.rounds == 0 and done.smallest > 0
    np.testing.assert_array_equal(d, before)


def test_a_jump_at_an_occlusion_is_kept():
    d = np.zeros((40, 40, 2), np.float32)
    d[:, 20:, 0] = -9.0  # one surface before another
    breaks = np.zeros((40, 40), bool)
    breaks[:, 19] = True
    before = d.copy()
    assert untangle(d, breaks).smallest == 1.0
    np.testing.assert_array_equal(d, before)
    assert untangle(d, NONE).rounds > 0


def test_a_map_that_only_shrinks_says_by_how_much():
    y, x = np.mgrid[:30, :30].astype(np.float32)
    assert untangle(0.2 * np.stack([x, y], axis=-1), NONE).smallest == pytest.approx(1.44, abs=1e-4)
    assert untangle(-0.1 * np.stack([x, y], axis=-1), NONE).smallest == pytest.approx(0.81, abs=1e-4)
    assert untangle(np.zeros((1, 5, 2), np.float32), NONE).smallest == 1.0


def test_blocks_are_those_of_numpy(rng):
    for shape in ((13, 20), (16, 16), (3, 50)):
        bad = (rng.random(shape) < 0.02).astype(np.float32)
        found = blocks_with(bad, 8)
        padded = np.pad(bad, [(0, -n % 8) for n in shape])
        expected = padded.reshape(padded.shape[0] // 8, 8, padded.shape[1] // 8, 8).any(axis=(1, 3))
        np.testing.assert_array_equal(found, expected)


def test_shapes_must_match():
    with pytest.raises(ShapeError):
        untangle(np.zeros((4, 4), np.float32), NONE)
    with pytest.raises(ShapeError):
        untangle(np.zeros((4, 4, 2), np.float32), np.zeros(4, bool))
