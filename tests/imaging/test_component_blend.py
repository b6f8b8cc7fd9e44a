"""A component of one picture set into another."""

import numpy as np
import pytest

from facewright.errors import DegenerateError, ShapeError
from facewright.imaging.alignment_flow import AlignedPicture
from facewright.imaging.colour import linear_from_srgb, srgb_from_linear
from facewright.imaging.component_blend import blend_component

H, W = 90, 110
Y, X = np.mgrid[:H, :W].astype(float)
LEVEL = (28 - np.hypot(X - 55, Y - 45)) / 14
SKIN = np.ones((H, W), bool)


def aligned(image, seen=None):
    shown = np.ones((H, W), np.float32) if seen is None else seen.astype(np.float32)
    return AlignedPicture(image, shown, np.zeros((H, W, 2), np.float32), 1.0, 1.5)


def skin_picture():
    base = np.stack([170 + 10 * np.sin(X / 7), 130 + 8 * np.cos(Y / 5), 110 + 6 * np.sin((X + Y) / 6)], axis=-1)
    return base.astype(np.uint8)


def relit(image, factor):
    linear = linear_from_srgb(image / 255.0) * factor
    return np.rint(srgb_from_linear(linear) * 255).astype(np.uint8)


def test_outside_nothing_changes_and_the_core_comes_over():
    target = skin_picture()
    source = target.copy()
    mark = np.hypot(X - 55, Y - 45) < 5
    source[mark] = (90, 40, 40)
    blend = blend_component(target, aligned(source), LEVEL, SKIN)
    np.testing.assert_array_equal(blend.image[~blend.mask], target[~blend.mask])
    assert blend.mask[LEVEL >= 1].all() and not blend.mask[LEVEL <= 0].any()
    assert np.abs(blend.image[mark].astype(int) - (90, 40, 40)).max() <= 12
    assert blend.seen_share == 1.0


@pytest.mark.parametrize("factor", [0.4, 0.75, (0.5, 0.6, 0.8)])
def test_other_light_and_colour_are_undone(factor):
    target = skin_picture()
    slope = (0.8 + 0.4 * X / W)[..., None]
    blend = blend_component(target, aligned(relit(target, np.multiply(factor, slope))), LEVEL, SKIN)
    difference = np.abs(blend.image.astype(int) - target)
    assert difference.max() <= 8 and difference[blend.mask].mean() < 2


def test_a_mark_at_the_seam_does_not_tint_the_core():
    target = skin_picture()
    target[np.abs(X - 55) < 2] = 60  # a fold that only the target has, across every possible seam
    source = skin_picture()
    blend = blend_component(target, aligned(source), LEVEL, SKIN)
    core = np.hypot(X - 55, Y - 45) < 5
    assert np.abs(blend.image[core].astype(int) - source[core]).mean() < 4


def test_what_is_not_seen_stays():
    target, source = skin_picture(), skin_picture()[:, ::-1].copy()
    half = X < 55
    blend = blend_component(target, aligned(source, half), LEVEL, SKIN)
    assert not blend.mask[~half].any() and blend.mask[(LEVEL >= 1) & half].all()
    assert 0.4 < blend.seen_share < 0.6
    nothing = blend_component(target, aligned(source, np.zeros((H, W))), LEVEL, SKIN)
    assert nothing.seen_share == 0.0 and not nothing.mask.any()
    np.testing.assert_array_equal(nothing.image, target)


def test_specks_that_are_not_seen_are_filled_and_large_holes_stay():
    target, source = skin_picture(), skin_picture()
    seen = np.ones((H, W), bool)
    seen[45, 55] = False
    assert blend_component(target, aligned(source, seen), LEVEL, SKIN).mask[45, 55]
    seen[40:50, 50:60] = False
    assert not blend_component(target, aligned(source, seen), LEVEL, SKIN).mask[45, 55]


def test_bad_input_is_refused():
    target = skin_picture()
    with pytest.raises(ShapeError, match="level"):
        blend_component(target, aligned(target), LEVEL[:-1], SKIN)
    with pytest.raises(DegenerateError, match="component"):
        blend_component(target, aligned(target), LEVEL - 9, SKIN)
