"""Means over blocks of a mask, and the way back."""

import numpy as np
import pytest

from facewright.imaging.blocks import enlarge, masked_means


@pytest.mark.parametrize("n", [1, 3, 4])
def test_means_are_those_of_a_loop(rng, n):
    picture, mask = rng.integers(0, 256, (11, 14, 3)).astype(np.uint8), rng.random((11, 14)) < 0.5
    means, share = masked_means(picture, mask, n)
    for i in range(means.shape[0]):
        for j in range(means.shape[1]):
            block = np.s_[i * n : (i + 1) * n, j * n : (j + 1) * n]
            assert share[i, j] == pytest.approx(mask[block].mean(), abs=1e-6)
            wanted = picture[block][mask[block]].mean(axis=0) if mask[block].any() else np.zeros(3)
            np.testing.assert_allclose(means[i, j], wanted, atol=1e-3)


def test_tall_pictures_are_read_in_strips(rng):
    picture = rng.random((1500, 5, 3)).astype(np.float32)
    means, share = masked_means(picture, None, 7)
    assert means.shape == (215, 1, 3) and (share == 1).all()
    np.testing.assert_allclose(means[100, 0], picture[700:707].mean(axis=(0, 1)), atol=1e-5)
    np.testing.assert_allclose(means[214, 0], picture[1498:].mean(axis=(0, 1)), atol=1e-5)


def test_a_ramp_is_enlarged_to_a_ramp():
    y, x = np.mgrid[:20, :24].astype(np.float32)
    ramp = np.stack([x, y, x + y], axis=-1)
    small, _ = masked_means(ramp, None, 4)
    found = enlarge(small, 4, ramp.shape[:2])
    np.testing.assert_allclose(found[2:-2, 2:-2], ramp[2:-2, 2:-2], atol=1e-4)
    np.testing.assert_array_equal(enlarge(small, 4, ramp.shape[:2], slice(5, 9)), found[5:9])
