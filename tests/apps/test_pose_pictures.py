"""Pictures of posed faces: markers lie where the face is, and only they are drawn over it."""

import numpy as np
import pytest

from facewright.apps.pose_pictures import PosePainter


@pytest.fixture(scope="module")
def painter(builtin_face):
    return PosePainter(builtin_face, (120, 100))


def test_markers_are_drawn_where_the_point_is(painter, builtin_face):
    plain = painter.draw(builtin_face.mean_shape)
    tip = builtin_face.mean_shape[builtin_face.mean_shape[:, 2].argmax()][None]
    marked = painter.mark(plain, tip, tip, [0])
    changed = np.argwhere((marked != plain).any(axis=2))
    assert 1 <= len(changed) <= 25
    row, column = changed.mean(axis=0)
    assert abs(column - 49.5) < 1.5  # the nose is on the midline
    assert 40 < row < 80
    yellow = marked[round(row), round(column)].astype(int)
    assert yellow[0] > 180
    assert yellow[2] < 120


def test_nothing_is_drawn_without_points(painter, builtin_face):
    plain = painter.draw(builtin_face.mean_shape)
    assert np.array_equal(painter.mark(plain, np.zeros((0, 3)), np.zeros((0, 3))), plain)


def test_the_head_turns_to_its_own_left(builtin_face):
    tip = builtin_face.mean_shape[:, 2].argmax()
    front, left = (
        PosePainter(builtin_face, (120, 100), yaw_degrees=yaw)._project(builtin_face.mean_shape)[tip, 0]
        for yaw in (0.0, 25.0)
    )
    assert left > front + 5  # the picture's right
