import numpy as np
import pytest
from scipy import ndimage

from facewright.errors import ShapeError
from facewright.fitting.lip_line import _LOWER_INNER, _UPPER_INNER, refine_lip_line
from facewright.landmarks.points import Landmarks
from facewright.landmarks.scheme import load_scheme

SCHEME = load_scheme("mediapipe478")


def mouth(gap, size=(300, 400)):
    """A painted mouth, teeth and darkness between two lips on skin, and its landmarks; the gap in pixels."""
    height, width = size
    y, x = np.mgrid[:height, :width].astype(float)
    u = np.clip((x - 200) / 60, -1, 1)
    arch = np.sqrt(1 - u**2)
    upper, lower = 200 - 0.5 * gap * arch, 200 + 0.5 * gap * arch
    picture = np.full((height, width, 3), (205, 160, 140), float)
    inside = np.abs(x - 200) < 60
    picture[inside & (y > upper - 16 * arch) & (y < lower + 20 * arch)] = (165, 85, 85)
    picture[inside & (y > upper) & (y < lower)] = (235, 230, 215)
    picture[inside & (y > upper) & (y < lower) & (np.abs(x - 200) > 40)] = (40, 15, 15)
    noisy = picture + np.random.default_rng(2).normal(0, 3, picture.shape)
    points = np.zeros((478, 2))

    def put(ids, level, extra):
        along = np.linspace(-0.8, 0.8, len(ids))
        bow = np.sqrt(1 - along**2)
        points[ids] = np.stack([200 + 60 * along, 200 + level * 0.5 * gap * bow + extra * bow], axis=1)

    put(_UPPER_INNER, -1, 0.0)
    put(_LOWER_INNER, 1, 0.0)
    put([185, 40, 39, 37, 0, 267, 269, 270, 409], -1, -16.0)
    put([146, 91, 181, 84, 17, 314, 405, 321, 375], 1, 20.0)
    points[[78, 308]] = [[140, 200], [260, 200]]
    for side, centre in (("right", 150), ("left", 250)):  # 100 pixels between the eyes
        ring = np.linspace(0, 2 * np.pi, 16, endpoint=False)
        points[SCHEME.groups[f"{side}_eye"]] = np.stack([centre + 15 * np.cos(ring), 90 + 6 * np.sin(ring)], axis=1)
    image = ndimage.gaussian_filter(noisy, (0.8, 0.8, 0))
    return np.clip(image, 0, 255).astype(np.uint8), Landmarks("mediapipe478", points)


@pytest.mark.parametrize("off", [-4.0, 3.0, 0.0])
def test_finds_the_edge_again(off):
    picture, truth = mouth(30)
    points = truth.points.copy()
    points[_UPPER_INNER, 1] += off
    points[_LOWER_INNER, 1] -= 0.8 * off
    found = refine_lip_line(picture, Landmarks("mediapipe478", points))
    for ids in (_UPPER_INNER, _LOWER_INNER):
        error = np.abs(found.points[ids, 1] - truth.points[ids, 1])
        assert error.mean() < 1.2 and error.max() < 2.0  # pixels, 100 between the eyes; blur counts as mouth
    others = np.setdiff1d(np.arange(478), np.concatenate([_UPPER_INNER, _LOWER_INNER]))
    np.testing.assert_array_equal(found.points[others], points[others])


def test_a_closed_mouth_stays():
    picture, truth = mouth(2)
    assert refine_lip_line(picture, truth) is truth


def test_without_colour_to_tell_points_stay_nearly():
    picture, truth = mouth(30)
    plain = np.full_like(picture, 150)
    found = refine_lip_line(plain, truth)
    assert np.abs(found.points - truth.points).max() < 0.5


def test_moves_are_bounded(rng):
    picture, truth = mouth(30)
    noise = rng.integers(0, 255, picture.shape).astype(np.uint8)
    moved = np.linalg.norm(refine_lip_line(noise, truth).points - truth.points, axis=1)
    assert moved.max() <= 0.07 * truth.interocular_distance() + 1e-9


def test_at_the_edge_of_the_picture_and_in_tiny_ones():
    picture, truth = mouth(30)
    cut = refine_lip_line(picture[:205], truth)
    assert np.isfinite(cut.points).all()
    small = Landmarks("mediapipe478", truth.points / 20)
    assert np.isfinite(refine_lip_line(picture[::20, ::20].copy(), small).points).all()


def test_points_outside_the_picture_stay():
    picture, truth = mouth(30)
    beyond = Landmarks("mediapipe478", truth.points + [2000.0, 0.0])
    assert refine_lip_line(picture, beyond) is beyond


def test_other_schemes_and_missing_points_stay():
    picture, truth = mouth(30)
    converted = truth.convert("fw74")
    assert refine_lip_line(picture, converted) is converted
    confidence = np.ones(478)
    confidence[13] = 0.0
    partial = Landmarks("mediapipe478", truth.points, confidence)
    assert refine_lip_line(picture, partial) is partial


def test_refuses_what_is_no_picture():
    with pytest.raises(ShapeError):
        refine_lip_line(np.zeros((10, 10), np.uint8), mouth(30)[1])
