"""Apple's lens tables: a distorted picture of a known scene becomes the pinhole picture."""

import numpy as np
import pytest

from facewright.capture.lens import LensTable, undistort
from facewright.errors import FileFormatError, ShapeError

SIZE = (60, 80)
CENTRE = (41.3, 28.6)


def _scene(x, y):
    """Depth, mm, and a smooth colour at pinhole pixels: a slanted plane before a wall, with a straight edge."""
    plane = 500.0 + 0.8 * x + 0.5 * y
    depth = np.where(x < 55.0, plane, 1500.0)
    color = np.stack([100 + x, 60 + y, 0 * x + 128], axis=-1)
    return depth, np.clip(np.rint(color), 0, 255).astype(np.uint8)


def _distorted(strength):
    """What a lens with r' = r (1 + strength t^2), t the radius by the farthest corner's, makes of the scene."""
    y, x = np.mgrid[: SIZE[0], : SIZE[1]].astype(float)
    far = np.hypot(max(CENTRE[0], SIZE[1] - CENTRE[0]), max(CENTRE[1], SIZE[0] - CENTRE[1]))
    u, v = x - CENTRE[0], y - CENTRE[1]
    px, py = u.copy(), v.copy()
    for _ in range(60):  # where the undistorted point is that lands here
        m = 1 + strength * (px**2 + py**2) / far**2
        px, py = u / m, v / m
    table = strength * np.linspace(0, 1, 42) ** 2
    depth, color = _scene(px + CENTRE[0], py + CENTRE[1])
    return color, depth.astype(np.float32), LensTable(CENTRE, table)


@pytest.mark.parametrize("strength", [0.03, -0.02])
def test_scene_comes_back(strength):
    color, depth, lens = _distorted(strength)
    new_color, new_depth = undistort(color, depth, lens)
    y, x = np.mgrid[: SIZE[0], : SIZE[1]].astype(float)
    true_depth, true_color = _scene(x, y)
    core = (slice(4, -4), slice(4, -4))
    away = np.abs(x - 55.0)[core] > 1.5
    assert np.abs(new_depth - true_depth)[core][away].max() < 0.05  # mm
    assert np.abs(depth - true_depth)[core][away].max() > 0.3  # it was off before
    assert np.abs(new_color.astype(int) - true_color)[core].max() <= 2


def test_no_surface_is_made_up_at_a_step():
    color, depth, lens = _distorted(0.03)
    _, new_depth = undistort(color, depth, lens)
    between = (new_depth > 640.0) & (new_depth < 1499.0)
    assert not between.any()


def test_holes_stay_holes():
    color, depth, lens = _distorted(0.0)
    depth[20:30, 20:30] = 0.0
    _, new_depth = undistort(color, depth, lens)
    np.testing.assert_array_equal(new_depth, depth)


def test_beyond_the_border_there_is_no_depth():
    _, depth, _ = _distorted(0.0)
    lens = LensTable(CENTRE, np.full(42, 0.3))
    _, new_depth = undistort(np.zeros((*SIZE, 3), np.uint8), depth, lens)
    assert (new_depth[0] == 0).all() and (new_depth[:, 0] == 0).all() and new_depth[28, 41] > 0


@pytest.mark.parametrize("table", [[], [0.0], [0.0, np.nan], [0.0, 0.9], [[0.0, 0.1]]])
def test_bad_tables_are_refused(table):
    with pytest.raises(FileFormatError, match="lens distortion table"):
        LensTable(CENTRE, np.array(table, dtype=float))


def test_sizes_must_agree():
    with pytest.raises(ShapeError, match="color"):
        undistort(np.zeros((4, 5, 3), np.uint8), np.zeros((5, 4)), LensTable(CENTRE, np.zeros(2)))
