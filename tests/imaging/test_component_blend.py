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


def aligned(image, seen=None, facing=1.0):
    facing = np.broadcast_to(np.float32(facing), (H, W))
    shown = np.ones((H, W), np.float32) if seen is None else seen.astype(np.float32)
    return AlignedPicture(image, shown, facing, np.zeros((H, W, 2), np.float32), 1.0, 1.5)


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


def test_a_fold_that_the_seam_cuts_fades():
    target, source = skin_picture(), skin_picture()
    source[np.abs(Y - 45) < 1.5] = 60  # across the whole picture, so that every seam cuts it
    blend = blend_component(target, aligned(source), LEVEL, SKIN)
    row = blend.image[45].astype(int).mean(axis=1)
    inside = np.flatnonzero(blend.mask[45])
    assert row[55] < 75  # as dark as in the reference
    step = np.abs(np.diff(row))[inside[0] - 2 : inside[-1] + 3]
    assert step.max() < 0.5 * (skin_picture()[45].mean() - 60)  # and nowhere an abrupt end


def test_skin_turned_away_is_left_out_and_steep_sides_within_are_not():
    target, source = skin_picture(), skin_picture()
    facing = np.where(X > 62, 0.45, 0.9)
    facing[40:50, 44:50] = 0.1  # the side of a nose
    picture = aligned(source, facing=facing)
    mask = blend_component(target, picture, LEVEL, SKIN, away_from_outline=True).mask
    assert not mask[:, 66:].any() and mask[45, 47] and mask[45, 55]
    assert blend_component(target, picture, LEVEL, SKIN).mask[45, 66]


def test_brows_keep_the_contrast_of_the_target_to_within_a_third():
    rng = np.random.default_rng(0)
    hair = np.abs(Y - 45) < 6
    target, source = skin_picture(), skin_picture()
    strands = rng.uniform(0, 1, (H, W, 1))
    target[hair] = (95 + 20 * strands * np.ones(3))[hair].astype(np.uint8)
    source[hair] = (10 + 120 * strands * np.ones(3))[hair].astype(np.uint8)
    brow = np.where(hair, 1.0, 0.0)
    core = hair & (np.hypot(X - 55, Y - 45) < 10)
    tamed = blend_component(target, aligned(source), LEVEL, SKIN & ~hair, brows=brow).image[core]
    wild = blend_component(target, aligned(source), LEVEL, SKIN & ~hair).image[core]
    tamed, wild, own = (picture.mean(axis=1).std() for picture in (tamed, wild, target[core]))
    assert tamed < 2.0 * own and wild > 1.5 * tamed


def test_dark_hair_stays_dark_grey_in_a_darker_light():
    """Light is multiplied: what is a tenth of the skin's stays a tenth, and none of it goes black."""
    target = relit(skin_picture(), 0.15)
    source = skin_picture()
    hair = np.hypot(X - 55, Y - 45) < 6
    source[hair] = (60, 55, 50)
    blend = blend_component(target, aligned(source), LEVEL, SKIN)
    ratio = linear_from_srgb(source[45, 55] / 255.0) / linear_from_srgb(skin_picture()[45, 55] / 255.0)
    wanted = srgb_from_linear(ratio * linear_from_srgb(target[45, 55] / 255.0)) * 255
    assert np.abs(blend.image[45, 55] - wanted).max() < 8 and blend.image[45, 55].min() > 8


def test_without_colours_skin_takes_the_targets_and_teeth_none():
    target, lips = skin_picture(), np.hypot(X - 55, Y - 45) < 12
    target[lips] = (150, 70, 80)
    mouth = (np.abs(Y - 45) < 4) & (np.abs(X - 55) < 8)
    bare = np.rint(target @ np.array([0.299, 0.587, 0.114])).astype(np.uint8)
    bare[mouth] = 225
    source = np.repeat(bare[..., None], 3, axis=2)
    blend = blend_component(target, aligned(source), LEVEL, SKIN & ~mouth, openings=mouth, colourless=True)
    teeth = blend.image[45, 50:60].astype(int)
    assert np.ptp(teeth, axis=1).max() < 14 and teeth.min() > 170
    lip = blend.image[37, 52:58].astype(int).mean(axis=0)
    assert np.abs(lip - (150, 70, 80)).max() < 22
    ring = blend.mask & (np.hypot(X - 55, Y - 45) > 17)
    assert np.abs(blend.image[ring].astype(int) - target[ring]).mean() < 5


def test_bad_input_is_refused():
    target = skin_picture()
    with pytest.raises(ShapeError, match="level"):
        blend_component(target, aligned(target), LEVEL[:-1], SKIN)
    with pytest.raises(ShapeError, match="openings"):
        blend_component(target, aligned(target), LEVEL, SKIN, openings=SKIN[:-1])
    with pytest.raises(DegenerateError, match="component"):
        blend_component(target, aligned(target), LEVEL - 9, SKIN)
