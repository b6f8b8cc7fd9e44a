import numpy as np
import pytest
from scipy import ndimage

from facewright.imaging.wide_blur import block_means, wide_blur


@pytest.mark.parametrize("sigma", [8.0, 11.0, 16.5, 40.0])
@pytest.mark.parametrize("channels", [(), (3,)])
def test_a_wide_blur_is_nearly_the_plain_one(rng, sigma, channels):
    picture = (rng.random((203, 331, *channels)) > 0.5).astype(np.float32)
    picture[60:140, 100:180] = 1.0
    expected = ndimage.gaussian_filter(picture, (sigma, sigma, *([0] * len(channels))))
    error = np.abs(wide_blur(picture, sigma) - expected)
    reach = int(sigma)
    assert error[reach:-reach, reach:-reach].max() < 0.015
    assert error.max() < 0.05  # at the border, whose last block may hold few pixels


def test_a_narrow_blur_is_the_plain_one(rng):
    picture = rng.random((40, 50)).astype(np.float32)
    np.testing.assert_array_equal(wide_blur(picture, 3.0), ndimage.gaussian_filter(picture, 3.0))


def test_block_means_beside_a_plain_loop(rng):
    picture = rng.random((11, 14, 2)).astype(np.float32)
    found = block_means(picture, 4)
    assert found.shape == (3, 4, 2)
    for i in range(3):
        for j in range(4):
            expected = picture[4 * i : 4 * i + 4, 4 * j : 4 * j + 4].mean(axis=(0, 1))
            np.testing.assert_allclose(found[i, j], expected, rtol=1e-6)


def test_a_flat_picture_stays_flat():
    assert np.abs(wide_blur(np.full((90, 70), 5.0), 20.0) - 5.0).max() < 1e-5
