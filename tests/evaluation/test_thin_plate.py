import numpy as np
import pytest

from facewright.errors import ShapeError, ValueRangeError
from facewright.evaluation.thin_plate import thin_plate_warp


@pytest.fixture
def picture(rng):
    """A smooth picture, so that bicubic look-ups between pixels are exact to a few levels."""
    y, x = np.mgrid[:96, :120]
    waves = [np.sin(x / 9 + y / 13), np.cos(x / 11 - y / 8), np.sin(y / 10)]
    return (127 + 100 * np.stack(waves, axis=-1)).astype(np.uint8)


def grid():
    return np.stack(np.meshgrid(np.linspace(30, 90, 6), np.linspace(25, 70, 6)), axis=-1).reshape(-1, 2)


def test_still_landmarks_give_the_picture_back(picture):
    np.testing.assert_allclose(thin_plate_warp(picture, grid(), grid()).astype(int), picture.astype(int), atol=1)


def test_landmarks_arrive_and_the_border_stays(picture):
    """A white dot at each landmark is found at its target."""
    source = grid()
    target = source + np.stack([3 * np.sin(source[:, 1] / 15), 2 * np.cos(source[:, 0] / 20)], axis=1)
    marked = np.zeros_like(picture)
    y, x = np.mgrid[: picture.shape[0], : picture.shape[1]]
    for px, py in source:
        dot = 255 * np.exp(-((x - px) ** 2 + (y - py) ** 2) / 4)
        marked = np.maximum(marked, dot[..., None]).astype(np.uint8)
    warped = thin_plate_warp(marked, source, target)[..., 0].astype(float)
    for px, py in target:
        near = np.hypot(x - px, y - py) < 4
        centre = (warped * near * x).sum() / (warped * near).sum(), (warped * near * y).sum() / (warped * near).sum()
        assert np.hypot(centre[0] - px, centre[1] - py) < 0.3  # pixels
    frame = thin_plate_warp(picture, source, target)
    np.testing.assert_allclose(frame[0, ::15].astype(int), picture[0, ::15].astype(int), atol=4)


def test_the_spline_against_scipy(picture):
    from scipy.interpolate import RBFInterpolator

    from facewright.evaluation.thin_plate import _design, _spline

    rng = np.random.default_rng(1)
    knots, values = rng.random((30, 2)), rng.random((30, 2))
    at = rng.random((50, 2))
    expected = RBFInterpolator(knots, values, kernel="thin_plate_spline")(at)
    np.testing.assert_allclose(_design(at, knots) @ _spline(knots, values), expected, atol=2e-3)


def test_closed_lips_do_not_break_it(picture):
    source = np.concatenate([grid(), grid()[:2]])
    warped = thin_plate_warp(picture, source, source + [2.0, 0.0])
    assert np.abs(warped[45, 45:80].astype(int) - picture[45, 43:78].astype(int)).max() < 8


def test_refuses(picture):
    with pytest.raises(ShapeError):
        thin_plate_warp(picture, grid(), grid()[:-1])
    with pytest.raises(ValueRangeError):
        thin_plate_warp(picture, grid() * np.nan, grid())
