"""A background that goes on behind what hides it."""

import numpy as np
import pytest

from facewright.imaging._patch_kernels import KNOWN, UNUSED, WANTED, match_patches, vote
from facewright.imaging.background_plate import complete_background
from facewright.imaging.inpaint import inpaint

SIZE = (120, 140)


@pytest.fixture(scope="module")
def wall():
    _, x = np.mgrid[: SIZE[0], : SIZE[1]]
    stripes = np.where((x // 7) % 2, 180, 70)[..., None] + np.array([0, 10, 20])
    return (stripes + np.random.default_rng(1).normal(0, 2, (*SIZE, 3))).clip(0, 255).astype(np.uint8)


@pytest.fixture(scope="module")
def person():
    y, x = np.mgrid[: SIZE[0], : SIZE[1]]
    return ((x - 70) / 24) ** 2 + ((y - 55) / 32) ** 2 < 1


@pytest.fixture(scope="module")
def photo(wall, person):
    photo = wall.copy()
    photo[person] = (200, 150, 120)
    return photo


def test_stripes_go_on_behind_a_head(wall, person, photo):
    plate = complete_background(photo, person, person, 64.0)
    np.testing.assert_array_equal(plate[~person], photo[~person])
    error = np.abs(plate[person].astype(float) - wall[person]).mean()
    smooth = np.abs(inpaint(photo, person)[person].astype(float) - wall[person]).mean()
    assert error < 12 and error < 0.35 * smooth, (error, smooth)
    np.testing.assert_array_equal(plate, complete_background(photo, person, person, 64.0))


def test_a_large_photo_is_completed_at_its_own_resolution(wall, person, photo):
    big, hole, truth = (np.kron(a, np.ones((3, 3) + (1,) * (a.ndim - 2), a.dtype)) for a in (photo, person, wall))
    plate = complete_background(big, hole, hole, 450.0)
    assert np.abs(plate[hole].astype(float) - truth[hole]).mean() < 15


def test_what_is_person_but_not_hidden_is_never_taken(wall, person, photo):
    body = np.zeros(SIZE, bool)
    body[95:] = True
    marked = photo.copy()
    marked[body] = (0, 255, 0)
    plate = complete_background(marked, person, person | body, 64.0)
    green = (plate[person][:, 1].astype(int) - plate[person][:, 0]) > 100
    assert not green.any()


def test_nothing_known_gives_the_picture_back(photo, person):
    everything = np.ones(SIZE, bool)
    np.testing.assert_array_equal(complete_background(photo, everything, everything, 64.0), photo)


def test_votes_are_those_of_a_loop(rng):
    picture = (255 * rng.random((16, 17, 3))).astype(np.float32)
    role = np.full((16, 17), KNOWN, np.uint8)
    role[6:10, 6:11] = WANTED
    role[0] = UNUSED
    nearest = np.stack([rng.integers(3, 13, role.shape), rng.integers(3, 14, role.shape)], axis=-1).astype(np.int32)
    cost = np.where(rng.random(role.shape) < 0.8, 100 * rng.random(role.shape), 1e30).astype(np.float32)
    trust = rng.random(role.shape).astype(np.float32)
    out = picture.copy()
    vote(picture, role, trust, nearest, cost, np.float32(50), out)
    np.testing.assert_array_equal(out[role != WANTED], picture[role != WANTED])
    for y, x in np.argwhere(role == WANTED):
        total, colour = 0.0, np.zeros(3)
        for k in range(-2, 3):
            for m in range(-2, 3):
                if cost[y + k, x + m] < 1e29:
                    w = trust[y + k, x + m] * np.exp(-cost[y + k, x + m] / 50)
                    v, u = nearest[y + k, x + m] - (k, m)
                    total, colour = total + w, colour + w * picture[v, u]
        np.testing.assert_allclose(out[y, x], colour / total, rtol=1e-3)


def test_search_finds_an_exact_copy():
    picture = (255 * np.random.default_rng(4).random((40, 40, 3))).astype(np.float32)
    picture[25:34, 25:34] = picture[5:14, 5:14]
    role = np.full((40, 40), KNOWN, np.uint8)
    ys, xs = (a.ravel() for a in np.mgrid[27:32, 27:32])
    source = np.zeros((40, 40), bool)
    source[2:24, 2:38] = True
    nearest = np.full((40, 40, 2), 20, np.int32)
    cost = np.full((40, 40), 1e30, np.float32)
    match_patches(picture, role, source, np.ones((40, 40), np.float32), ys, xs, nearest, cost, 400, np.float32(0), 5)
    np.testing.assert_array_equal(nearest[ys, xs], np.stack([ys - 20, xs - 20], axis=1))
    assert cost[ys, xs].max() == 0
