"""Two layers of a photo: together they are the photo; moved, the background stays."""

from dataclasses import replace

import numpy as np
import pytest

from facewright.imaging.photo_layers import BEHIND, BOTH, PERSON, PhotoLayers
from facewright.imaging.resample import resample_displaced

SIZE = (60, 70)


@pytest.fixture
def layers():
    """A grey person between columns 25 and 45 before stripes, one soft column on each side."""
    _, x = np.mgrid[: SIZE[0], : SIZE[1]]
    plate = np.repeat(np.where((x // 4) % 2, 200, 60)[..., None], 3, axis=2).astype(np.uint8)
    alpha = np.where((x > 25) & (x < 45), 255, 0).astype(np.uint8)
    alpha[:, [25, 45]] = 128
    front = np.rint(alpha[..., None] / 255 * np.array([120.0, 130, 140])).astype(np.uint8)
    hidden = (x > 22) & (x < 48)
    state = np.full(SIZE, BOTH, np.uint8)
    state[:, 28:43], state[:, :20], state[:, 51:] = PERSON, BEHIND, BEHIND
    photo = np.rint(front + (1 - alpha[..., None] / 255) * plate).astype(np.uint8)
    return photo, PhotoLayers((0, 0), alpha, front, plate, state, hidden, np.full(SIZE, 255, np.uint8), 2.0)


def test_nothing_moves_nothing_changes(layers):
    photo, found = layers
    part, moved, shares = found.resample(photo, np.zeros((30, 40, 2), np.float32), (10, 5))
    np.testing.assert_array_equal(part, photo[5:35, 10:50])
    assert not moved.any() and (shares == 255).all()


@pytest.mark.parametrize("dtype", [np.uint8, np.float32])
def test_a_person_who_moves_uncovers_the_plate(layers, dtype):
    photo, found = layers
    field = np.full((*SIZE, 2), (-6.0, 0.0), np.float32)
    part, moved, shares = found.resample(photo.astype(dtype), field, (0, 0))
    x = np.arange(SIZE[1])
    np.testing.assert_array_equal(part[:, 20:31], found.plate[:, 20:31])
    np.testing.assert_array_equal(part[:, 33:50], np.broadcast_to(np.uint8([120, 130, 140]), (SIZE[0], 17, 3)))
    np.testing.assert_array_equal(part[:, 52:], photo[:, 52:])
    mixed = np.rint(128 / 255 * np.array([120, 130, 140]) + 127 / 255 * found.plate[:, 31])
    np.testing.assert_allclose(part[:, 31], mixed, atol=1)
    assert not moved[:, (x < 22) | (x > 57)].any() and moved[:, 24:51].all()
    assert (shares[:, 33:50] == 255).all() and (shares[:, :25] == 0).all()
    assert not field[:, :20].any()  # what shows the background lies where it lies


def test_small_motions_change_little(layers):
    photo, found = layers
    # a matte that misses a column: the photo shows it, no layer does
    torn = photo.copy()
    torn[:, 24] = (250, 0, 0)
    change = []
    for step in (0.05, 0.3, 1.0, 3.0):
        part, _, _ = found.resample(torn, np.full((*SIZE, 2), (-step, 0.0), np.float32), (0, 0))
        change.append(np.abs(part[:, 24].astype(int) - torn[:, 24]).max())
    assert change[0] <= 8 and change[0] <= change[1] < change[2] < change[3]
    np.testing.assert_array_equal(part[:, 24], found.plate[:, 24])  # no ghost of it is left


def test_inside_the_person_it_is_the_plain_look_up(layers, rng):
    photo, found = layers
    photo = rng.integers(0, 256, photo.shape).astype(np.uint8)
    field = rng.uniform(-1.5, 1.5, (*SIZE, 2)).astype(np.float32)
    part, _, _ = found.resample(photo, field.copy(), (0, 0))
    plain, _ = resample_displaced(photo, field)
    np.testing.assert_array_equal(part[:, 31:40], plain[:, 31:40])


def test_beyond_the_box_the_photo_stays(layers):
    photo, found = layers
    wide = np.pad(photo, ((3, 3), (5, 5), (0, 0)), mode="edge")
    shifted = PhotoLayers((5, 3), found.alpha, found.front, found.plate, found.state, found.hidden, found.trust, 2.0)
    field = np.full((*wide.shape[:2], 2), (-6.0, 0.0), np.float32)
    part, moved, _ = shifted.resample(wide, field, (0, 0))
    assert not moved[:, :5].any()
    inner, _, _ = found.resample(photo, np.full((*SIZE, 2), (-6.0, 0.0), np.float32), (0, 0))
    np.testing.assert_array_equal(part[3:-3, 5:-5][:, 10:-10], inner[:, 10:-10])


def test_without_trust_it_is_the_plain_look_up(layers):
    """What lies behind bends with the person, as it does where there are no layers."""
    photo, found = layers
    field = np.full((*SIZE, 2), (-6.0, 0.0), np.float32)
    plain, _ = resample_displaced(photo, field)
    part, _, shares = replace(found, trust=np.zeros(SIZE, np.uint8)).resample(photo, field.copy(), (0, 0))
    np.testing.assert_array_equal(part, plain)
    assert (shares == 255).all()
    half, _, _ = replace(found, trust=np.full(SIZE, 128, np.uint8)).resample(photo, field.copy(), (0, 0))
    whole, _, _ = found.resample(photo, field.copy(), (0, 0))
    np.testing.assert_allclose(half, plain + 128 / 255 * (whole.astype(float) - plain), atol=1.01)


def test_trust_is_looked_up_in_the_photo(layers):
    _, found = layers
    trust = np.zeros(SIZE, np.uint8)
    trust[10, 20] = 255
    box = replace(found, trust=trust, origin=(5, 3))
    np.testing.assert_array_equal(box.trust_at(np.array([[25.2, 12.9], [24.0, 13.0], [-50.0, 900.0]])), [1, 0, 0])
