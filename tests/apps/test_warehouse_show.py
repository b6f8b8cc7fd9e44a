"""Pictures on a person's sheet: the head, upright, without the black that fills unlike sizes."""

import numpy as np
import pytest

from facewright.apps.warehouse_show import photo_tile
from facewright.capture.quarter_turns import turn_picture, turn_points
from facewright.landmarks.scheme import load_scheme

SIZE = (56, 46)


@pytest.fixture
def head():
    """A picture (120, 160) with a face of 40 pixels: green round it, red eyes above a blue mouth; its landmarks."""
    picture = np.full((120, 160, 3), (0, 160, 0), np.uint8)
    points = np.empty((74, 2))
    angles = np.linspace(0, 2 * np.pi, 74, endpoint=False)
    points[:] = np.stack([90 + 20 * np.cos(angles), 60 + 20 * np.sin(angles)], axis=1)
    groups = load_scheme("fw74").groups
    points[groups["left_eye"]], points[groups["right_eye"]] = (98, 50), (82, 50)
    points[groups["outer_mouth"]] = points[groups["inner_mouth"]] = (90, 74)
    picture[44:57, 76:105] = (200, 0, 0)
    picture[69:80, 80:101] = (0, 0, 200)
    return picture, points


def _is_upright(tile):
    """The upper half has the red, the lower one the blue, and both are large."""
    red = (tile[..., 0] > 120) & (tile[..., 2] < 60)
    blue = (tile[..., 2] > 120) & (tile[..., 0] < 60)
    rows = np.arange(len(tile))[:, None]
    assert red.sum() > 100 and blue.sum() > 60
    return (red * rows).sum() / red.sum() < (blue * rows).sum() / blue.sum() - 10


@pytest.mark.parametrize("turns", range(4))
def test_heads_are_cut_out_upright(head, turns):
    picture, points = head
    turned = turn_picture(picture, turns)
    padded = np.zeros((200, 240, 3), np.uint8)
    padded[: turned.shape[0], : turned.shape[1]] = turned
    tile = photo_tile(padded, turn_points(points, picture.shape[:2], turns), SIZE)
    assert tile.shape == (*SIZE, 3) and _is_upright(tile)
    assert tile.any(axis=2).all()  # none of the black


def test_points_that_are_missing_or_outside_do_not_matter(head):
    picture, points = head
    points[5], points[9] = np.nan, (-500.0, 30.0)
    assert _is_upright(photo_tile(picture, points, SIZE))


@pytest.mark.parametrize("landmarks", [None, np.full((74, 2), np.nan)])
def test_without_landmarks_the_whole_picture_is_shown(head, landmarks):
    tile = photo_tile(head[0], landmarks, SIZE)
    assert tile.shape == (*SIZE, 3)
    assert (tile[:5] == 255).all() and (tile[SIZE[0] // 2, :8] == (0, 160, 0)).all()  # a wide picture, white above


def test_a_black_picture_is_drawn():
    assert photo_tile(np.zeros((20, 30, 3), np.uint8), None, SIZE).shape == (*SIZE, 3)
