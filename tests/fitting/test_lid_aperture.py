import numpy as np
import pytest

from facewright.errors import ShapeError
from facewright.fitting.lid_aperture import _CORNERS, _LOWER, _UPPER, lid_aperture, lid_closure, open_aperture


def eyes(height):
    """Points of a frame whose eyes are 30 wide and `height` (right, left) high."""
    points = np.zeros((478, 2))
    for k, x in enumerate((100.0, 160.0)):
        points[_CORNERS[k][0]], points[_CORNERS[k][1]] = (x - 15, 50), (x + 15, 50)
        points[list(_UPPER[k])], points[list(_LOWER[k])] = (x, 50 - height[k] / 2), (x, 50 + height[k] / 2)
    return points


def test_closure_is_measured_against_the_clip_s_own_open_eyes():
    heights = [(10, 6)] * 20 + [(5, 6), (2, 6), (5, 6)]
    points = np.array([eyes(h) for h in heights])
    np.testing.assert_allclose(lid_aperture(points)[0], [1 / 3, 0.2])
    opened = open_aperture(points)
    np.testing.assert_allclose(opened, [1 / 3, 0.2])
    closed = lid_closure(points, opened)
    assert closed[:20].max() < 1e-9 and closed[21, 0] == 1.0 and 0.5 < closed[20, 0] < 1.0
    assert np.abs(closed[:, 1]).max() < 1e-9
    np.testing.assert_allclose(lid_closure(3.0 * points, opened), closed)  # the size of the face does not matter


def test_refuses_other_points():
    with pytest.raises(ShapeError):
        lid_aperture(np.zeros((3, 468, 2)))
