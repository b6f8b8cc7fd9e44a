import numpy as np
import pytest

from facewright.errors import DegenerateError, ShapeError, ValueRangeError
from facewright.imaging.gradient_blend import blend_gradients


@pytest.fixture()
def disc():
    y, x = np.mgrid[:64, :80]
    return np.hypot(x - 40, y - 30) < 20


def texture(rng, shape=(64, 80, 3)):
    """Smooth light and fine grain, well inside the range."""
    y, x = np.mgrid[: shape[0], : shape[1], : shape[2]][:2]
    return np.clip(110 + 30 * np.sin(x / 17) + 20 * np.cos(y / 11) + 6 * rng.normal(size=shape), 20, 235)


@pytest.mark.parametrize("mixed", [False, True])
def test_outside_the_mask_nothing_changes(rng, disc, mixed):
    target, source = texture(rng).astype(np.uint8), rng.integers(0, 256, (64, 80, 3), dtype=np.uint8)
    got = blend_gradients(target, source, disc, mixed=mixed)
    np.testing.assert_array_equal(got[~disc], target[~disc])
    assert (got[disc] != target[disc]).any()
    assert got.dtype == np.uint8


def test_a_shifted_copy_gives_the_picture_back(rng, disc):
    """The correction is harmonic: any harmonic difference between the pictures vanishes."""
    target = texture(rng)
    y, x = np.mgrid[:64, :80]
    shift = 25 + 0.3 * x - 0.2 * y + 0.004 * (x * x - y * y)
    np.testing.assert_allclose(blend_gradients(target, target - shift[..., None], disc), target, atol=0.05)
    np.testing.assert_allclose(blend_gradients(target, target - 25, disc, mixed=True), target, atol=0.05)


def test_keeps_the_sources_gradients(rng, disc):
    """Laplacians inside equal the source's."""
    target, source = texture(rng), texture(rng)
    got = blend_gradients(target, source, disc)

    def laplacian(image):
        return 4 * image[1:-1, 1:-1] - image[:-2, 1:-1] - image[2:, 1:-1] - image[1:-1, :-2] - image[1:-1, 2:]

    np.testing.assert_allclose(laplacian(got)[disc[1:-1, 1:-1]], laplacian(source)[disc[1:-1, 1:-1]], atol=0.1)


def test_mixed_keeps_the_targets_lines(disc):
    """A flat source over a target with a line: plain blending wipes the line out, mixed keeps it."""
    target = np.full((64, 80, 3), 150.0)
    target[:, 40:42] = 60
    flat = np.full_like(target, 100.0)
    plain, mixed = blend_gradients(target, flat, disc), blend_gradients(target, flat, disc, mixed=True)
    assert plain[30, 40, 0] > 120
    np.testing.assert_allclose(mixed, target, atol=0.5)


def test_a_free_stretch_of_the_border_does_not_bleed(disc):
    """Dark hair right of the mask in the target only: where it is free, the region stays the source's level."""
    target = np.full((64, 80, 3), 150, np.uint8)
    hair = np.zeros((64, 80), bool)
    hair[:, 55:] = True
    target[hair] = 10
    source = np.full_like(target, 140)
    bled = blend_gradients(target, source, disc & ~hair)
    held = blend_gradients(target, source, disc & ~hair, free=hair)
    assert bled[30, 54, 0] < 90
    assert (held[disc & ~hair] == 150).all()


def test_the_range_is_kept(disc):
    target = np.full((64, 80, 3), 250, np.uint8)
    source = np.where(np.arange(80)[None, :, None] % 4 < 2, 0, 200).astype(np.uint8) + np.zeros((64, 80, 3), np.uint8)
    got = blend_gradients(target, source, disc)
    assert got[disc].max() == 255 and got[disc].min() > 30


def test_an_empty_mask_changes_nothing(rng):
    target = texture(rng).astype(np.uint8)
    np.testing.assert_array_equal(blend_gradients(target, 255 - target, np.zeros((64, 80), bool)), target)


@pytest.mark.parametrize(
    ("change", "error"),
    [
        ({"target": np.zeros((4, 5), np.uint8)}, ShapeError),
        ({"source": np.zeros((4, 6, 3), np.uint8)}, ShapeError),
        ({"mask": np.zeros((5, 5), bool)}, ShapeError),
        ({"free": np.zeros((5, 5), bool)}, ShapeError),
        ({"source": np.zeros((4, 5, 3))}, ValueRangeError),
        ({"target": np.zeros((4, 5, 3), int), "source": np.zeros((4, 5, 3), int)}, ValueRangeError),
        ({"mask": np.ones((4, 5), bool)}, DegenerateError),
    ],
)
def test_refuses(change, error):
    good = {
        "target": np.zeros((4, 5, 3), np.uint8),
        "source": np.zeros((4, 5, 3), np.uint8),
        "mask": np.eye(4, 5, dtype=bool),
    }
    with pytest.raises(error):
        blend_gradients(**(good | change))
