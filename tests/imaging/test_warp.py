"""A photo through an inverse map."""

import numpy as np
import pytest

from facewright.errors import ShapeError, ValueRangeError
from facewright.imaging.warp import warp_picture


@pytest.fixture
def photo(rng):
    return rng.integers(0, 256, (24, 32, 3), dtype=np.uint8)


def test_no_displacement_keeps_the_bits(photo):
    np.testing.assert_array_equal(warp_picture(photo, np.zeros((24, 32, 2))), photo)


def test_a_whole_step_is_a_shifted_copy(photo):
    field = np.zeros((24, 32, 2), np.float32)
    field[...] = (2, -1)
    np.testing.assert_array_equal(warp_picture(photo, field)[1:, :-2], photo[:-1, 2:])


def test_a_part_is_that_of_the_whole(photo, rng):
    field = rng.normal(0, 2, (24, 32, 2)).astype(np.float32)
    field[rng.random((24, 32)) < 0.3] = 0
    whole = warp_picture(photo, field)
    part = warp_picture(photo, field[5:17, 3:20], (3, 5))
    np.testing.assert_array_equal(part, whole[5:17, 3:20])


def test_the_photo_is_not_changed(photo, rng):
    before = photo.copy()
    warp_picture(photo, rng.normal(0, 2, (24, 32, 2)))
    np.testing.assert_array_equal(photo, before)


def test_guards(photo):
    with pytest.raises(ValueRangeError, match="must lie in the photo of 32 x 24"):
        warp_picture(photo, np.zeros((24, 32, 2)), (1, 0))
    with pytest.raises(ValueRangeError):
        warp_picture(photo, np.full((24, 32, 2), np.nan))
    with pytest.raises(ShapeError):
        warp_picture(photo[..., 0], np.zeros((24, 32, 2)))
    with pytest.raises(ShapeError):
        warp_picture(photo, np.zeros((24, 32, 3)))
