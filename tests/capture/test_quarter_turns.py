"""Pictures, points and cameras turn together."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from facewright.camera.depth_map import back_project
from facewright.camera.pinhole import Intrinsics
from facewright.capture.quarter_turns import (
    check_quarter_turns,
    turn_intrinsics,
    turn_picture,
    turn_points,
    turn_size,
)
from facewright.errors import ValueRangeError

K = Intrinsics(300.0, 310.0, 3.2, 5.1)


@given(st.integers(0, 3), st.integers(0, 7), st.integers(0, 4))
def test_points_follow_their_pixels(turns, column, row):
    picture = np.zeros((5, 8))
    picture[row, column] = 1.0
    x, y = turn_points([column, row], (5, 8), turns)
    assert turn_picture(picture, turns)[int(y), int(x)] == 1.0
    assert turn_picture(picture, turns).shape == turn_size((5, 8), turns)


@pytest.mark.parametrize("turns", range(4))
def test_four_turns_and_back_are_none(rng, turns):
    points = rng.uniform(0, 5, (7, 2))
    there = turn_points(points, (5, 8), turns)
    np.testing.assert_allclose(turn_points(there, turn_size((5, 8), turns), -turns % 4), points, atol=1e-12)


@pytest.mark.parametrize("turns", range(4))
def test_turned_camera_sees_the_same_shape(rng, turns):
    """Back-projected points differ by a rotation about the optical axis, not by a mirror."""
    depth = rng.uniform(500, 700, (5, 8))
    points = back_project(depth, K)
    turned = back_project(turn_picture(depth, turns), turn_intrinsics(K, (5, 8), turns))
    a = np.deg2rad(-90.0 * turns)  # y points down: counter-clockwise in the picture is a negative angle
    R = np.array([[np.cos(a), -np.sin(a), 0], [np.sin(a), np.cos(a), 0], [0, 0, 1]])
    np.testing.assert_allclose(turned, turn_picture(points, turns) @ R.T, atol=1e-9)


@pytest.mark.parametrize("turns", [-1, 4, 1.5, "1"])
def test_other_turns_are_refused(turns):
    with pytest.raises(ValueRangeError, match="must be 0, 1, 2 or 3"):
        check_quarter_turns(turns)
