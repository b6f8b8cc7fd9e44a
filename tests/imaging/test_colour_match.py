import numpy as np
import pytest
from scipy.ndimage import gaussian_filter

from facewright.errors import DegenerateError, ShapeError, ValueRangeError
from facewright.imaging.colour import srgb_from_linear
from facewright.imaging.colour_match import ColourMatch, estimate_colour_match, match_colours

SIZE = (120, 150)


def skin(rng, size=SIZE):
    """Linear light of a textured surface, (H, W, 3)."""
    grain = gaussian_filter(rng.normal(size=(*size, 1)), (2, 2, 0))
    blotches = gaussian_filter(rng.normal(size=(*size, 1)), (12, 12, 0))
    level = 1 + 0.25 * grain / grain.std() + 0.3 * blotches / blotches.std()
    return np.clip(level, 0.3, 2.0) * np.array([0.30, 0.18, 0.13])


def encoded(linear):
    return np.rint(srgb_from_linear(linear) * 255).astype(np.uint8)


def levels_apart(a, b):
    return np.abs(a.astype(int) - b)


def test_a_known_gain_comes_back(rng):
    linear, gain = skin(rng), np.array([0.7, 0.8, 1.1])
    source, target = encoded(linear), encoded(linear * gain)
    match = estimate_colour_match(source, target, np.ones(SIZE, bool))
    np.testing.assert_allclose(match.gain, gain, rtol=0.02)
    np.testing.assert_allclose(match.offset, 0, atol=0.004)
    assert np.percentile(levels_apart(match.apply(source), target), 99) <= 2


def test_gain_and_offset_come_back_where_colours_vary(rng):
    linear = skin(rng)
    source, target = encoded(linear), encoded(0.8 * linear + 0.03)
    match = estimate_colour_match(source, target, np.ones(SIZE, bool), local=False)
    assert np.percentile(levels_apart(match.apply(source), target), 99) <= 4
    assert (match.offset > 0.012).all()


def test_a_third_of_other_surface_does_not_spoil_it(rng):
    """A beard in one picture only."""
    linear, gain = skin(rng), np.array([0.8, 0.9, 1.1])
    target = linear * gain
    target[80:] *= 0.25
    match = estimate_colour_match(encoded(linear), encoded(target), np.ones(SIZE, bool))
    np.testing.assert_allclose(match.gain, gain, rtol=0.05)


def test_textures_that_have_nothing_in_common_keep_their_contrast(rng):
    """Misaligned pictures of like surfaces: the gain is the ratio of their means, no grey veil."""
    source, target = encoded(skin(rng)), encoded(skin(rng) * 0.6)
    match = estimate_colour_match(source, target, np.ones(SIZE, bool), local=False)
    np.testing.assert_allclose(match.gain, 0.6, rtol=0.25)
    np.testing.assert_allclose(match.offset, 0, atol=0.02)


def test_light_from_one_side_is_followed(rng):
    """The left is lit half as bright again as the right, in the target only."""
    linear = skin(rng)
    light = 1.25 - 0.5 * np.linspace(0, 1, SIZE[1])[None, :, None]
    source, target = encoded(linear), encoded(linear * light)
    everywhere = np.ones(SIZE, bool)
    with_light, without = (match_colours(source, target, everywhere, local=local) for local in (True, False))
    assert levels_apart(with_light, target).mean() < 0.4 * levels_apart(without, target).mean()


def test_a_ring_tells_its_inside(rng):
    """Colours are compared round the mouth only; inside, what the mouth does is kept."""
    y, x = np.mgrid[: SIZE[0], : SIZE[1]]
    radius = np.hypot(x - 75, y - 60)
    linear, gain = skin(rng), np.array([0.75, 0.8, 0.9])
    lips = linear * np.where(radius < 20, 0.4, 1.0)[..., None]
    got = match_colours(encoded(lips), encoded(linear * gain), (radius > 30) & (radius < 50))
    inside = radius < 18
    assert levels_apart(got, encoded(lips * gain))[inside].mean() < 2


def test_no_match_is_no_change():
    """Gain 1, offset 0, light 1: every byte comes back from linear light as it was."""
    every = np.arange(256, dtype=np.uint8)[:, None, None].repeat(3, axis=2)
    nothing = ColourMatch(np.ones(3), np.zeros(3), np.ones((4, 1, 3), np.float32), 64, (256, 1))
    np.testing.assert_array_equal(nothing.apply(every), every)


def test_only_where_asked(rng):
    linear = skin(rng)
    source = encoded(linear)
    match = estimate_colour_match(source, encoded(0.5 * linear), np.ones(SIZE, bool))
    where = np.zeros(SIZE, bool)
    where[:50] = True
    got = match.apply(source, where)
    np.testing.assert_array_equal(got[~where], source[~where])
    np.testing.assert_array_equal(got[where], match.apply(source)[where])


def test_equal_pictures_stay(rng):
    source = encoded(skin(rng))
    assert levels_apart(match_colours(source, source, np.ones(SIZE, bool)), source).max() <= 1


def test_large_pictures_are_compared_by_cells(rng):
    linear = np.kron(skin(rng, (60, 70)), np.ones((8, 8, 1)))
    source, target = encoded(linear), encoded(linear * 0.7)
    match = estimate_colour_match(source, target, np.ones(source.shape[:2], bool))
    assert match.cell == 4
    assert np.percentile(levels_apart(match.apply(source), target), 99) <= 2


@pytest.mark.parametrize(
    ("change", "error"),
    [
        ({"source": np.zeros((30, 30), np.uint8)}, ShapeError),
        ({"target": np.zeros((30, 31, 3), np.uint8)}, ShapeError),
        ({"where": np.ones((30, 31), bool)}, ShapeError),
        ({"source": np.full((30, 30, 3), 100.0)}, ValueRangeError),
        ({"target": np.full((30, 30, 3), 255, np.uint8)}, DegenerateError),
        ({"where": np.zeros((30, 30), bool)}, DegenerateError),
    ],
)
def test_refuses(change, error):
    grey = np.full((30, 30, 3), 100, np.uint8)
    good = {"source": grey, "target": grey, "where": np.ones((30, 30), bool)}
    with pytest.raises(error):
        estimate_colour_match(**(good | change))


def test_apply_refuses_another_size(rng):
    source = encoded(skin(rng))
    match = estimate_colour_match(source, source, np.ones(SIZE, bool))
    with pytest.raises(ShapeError):
        match.apply(source[1:])
    with pytest.raises(ValueRangeError):
        match.apply(source.astype(float))
