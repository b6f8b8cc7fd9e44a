"""Grain and contrast brought to another picture's."""

import numpy as np
import pytest
from scipy import ndimage

from facewright.errors import ShapeError
from facewright.imaging.detail_match import limit_contrast, match_grain

SIZE = (120, 130)
ALL = np.ones(SIZE, bool)


def grain(rng, strength, blur=0.0):
    noise = ndimage.gaussian_filter(rng.normal(size=(*SIZE, 3)), (blur, blur, 0))
    return (strength * noise / noise.std()).astype(np.float32)


@pytest.mark.parametrize("blur", [0.0, 0.7, 1.5])
def test_grain_becomes_as_weak_as_the_targets(rng, blur):
    quiet, loud = grain(rng, 0.02, blur), grain(rng, 0.1, blur)
    matched = match_grain(loud, quiet, ALL)
    fine = matched - ndimage.gaussian_filter(matched, (2, 2, 0))
    wanted = quiet - ndimage.gaussian_filter(quiet, (2, 2, 0))
    assert 0.8 * wanted.std() < fine.std() < 1.3 * wanted.std()


def test_edges_stay(rng):
    step = np.zeros((*SIZE, 3), np.float32)
    step[:, 65:] = 1.5
    matched = match_grain(step + grain(rng, 0.06), step + grain(rng, 0.01), ALL)
    rise = matched[:, 66:70].mean() - matched[:, 61:65].mean()
    assert rise > 1.35
    assert matched[20:100, 10:50].std() < 0.03


def test_a_picture_with_less_grain_is_left_alone(rng):
    quiet, loud = grain(rng, 0.02), grain(rng, 0.1)
    np.testing.assert_array_equal(match_grain(quiet, loud, ALL), quiet)
    np.testing.assert_array_equal(match_grain(loud, loud, ALL), loud)
    np.testing.assert_array_equal(match_grain(loud, quiet, ~ALL), loud)


@pytest.mark.parametrize("gain", [0.5, 1.2, 3.0, 6.0])
def test_contrast_is_at_most_a_third_more(rng, gain):
    soft = grain(rng, 0.1, 1.0)
    part = np.zeros(SIZE)
    part[30:90, 30:100] = 1.0
    limited = limit_contrast(gain * soft, soft, part, 32.0)
    inside, outside = part > 0, part == 0
    assert limited[inside].std() <= 1.45 * soft[inside].std() or gain <= 1.2
    np.testing.assert_array_equal(limited[outside], (gain * soft)[outside])
    if gain <= 1.2:
        np.testing.assert_allclose(limited, gain * soft, atol=1e-6)


def test_no_part_changes_nothing(rng):
    picture = grain(rng, 0.1)
    np.testing.assert_array_equal(limit_contrast(picture, 0 * picture, np.zeros(SIZE), 8.0), picture)


def test_bad_input_is_refused(rng):
    picture = grain(rng, 0.1)
    for call in (match_grain, lambda a, b, c: limit_contrast(a, b, c.astype(float), 4.0)):
        with pytest.raises(ShapeError, match="target"):
            call(picture, picture[:-1], ALL)
        with pytest.raises(ShapeError, match=r"where|weight"):
            call(picture, picture, ALL[:-1])
