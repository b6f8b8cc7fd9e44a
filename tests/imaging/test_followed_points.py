"""Maps that are made to meet points."""

import numpy as np
import pytest

from facewright.errors import ShapeError
from facewright.imaging.followed_points import meet_points


def test_points_are_met_and_the_rest_stays(rng):
    displacement = np.zeros((200, 220, 2), np.float32)
    target = np.array([[120.0, 90.0], [135.0, 96.0], [128.0, 110.0]])
    source = target + [[3.0, -1.0], [2.0, 2.0], [-1.0, 1.5]]
    meet_points(displacement, (20, 10), target, source, 350.0)
    for t, s in zip(target, source, strict=True):
        x, y = (t - (20, 10)).astype(int)
        np.testing.assert_allclose(displacement[y, x], s - t, atol=0.3)
    ys, xs = np.mgrid[:200, :220]
    far = np.min([np.hypot(xs + 20 - x, ys + 10 - y) for x, y in target], axis=0) > 0.06 * 350
    assert not displacement[far].any()


def test_a_map_that_meets_them_already_does_not_change():
    displacement = np.full((100, 100, 2), 2.5, np.float32)
    target = np.array([[40.0, 40.0], [41.0, 40.0]])
    meet_points(displacement, (0, 0), target, target + 2.5, 300.0)
    np.testing.assert_allclose(displacement, 2.5, atol=1e-5)


def test_coinciding_points_and_points_outside_are_harmless():
    displacement = np.zeros((80, 80, 2), np.float32)
    target = np.array([[40.0, 40.0], [40.0, 40.0], [500.0, 40.0]])
    meet_points(displacement, (0, 0), target, target + [[2.0, 0.0], [3.0, 0.0], [9.0, 9.0]], 300.0)
    np.testing.assert_allclose(displacement[40, 40], [2.5, 0.0], atol=0.1)
    meet_points(displacement, (0, 0), target[2:], target[2:], 300.0)
    with pytest.raises(ShapeError):
        meet_points(displacement, (0, 0), target, target[:1], 300.0)
