"""Where an outline is to be trusted: a disk on a plain, and what may be wrong with it."""

import numpy as np
import pytest
from scipy import ndimage

from facewright.imaging.head_matte import _clean
from facewright.imaging.matte_trust import matte_trust, smoothness

SIZE, HEAD = 200, 100.0
Y, X = np.mgrid[:SIZE, :SIZE]
AWAY = np.hypot(X - 100, Y - 100) - 50
DISK = AWAY < 0
ABOVE = np.full((SIZE, SIZE), -HEAD)  # all of it above the chin


def _trust(person=DISK, tells=2.0, found=None, head=DISK, below=ABOVE):
    colour = np.where(DISK, tells, -tells) * np.ones((SIZE, SIZE))
    return matte_trust(person.astype(np.float32), colour, found, head, below, HEAD)


def test_colours_that_tell_are_trusted():
    assert _trust(found=ndimage.gaussian_filter(DISK.astype(float), 1)).min() > 0.9


def test_a_stretch_whose_colours_do_not_tell_is_not():
    tells = np.where(X < 100, 2.0, 0.0)
    trust = _trust(tells=tells)
    assert trust[100, 145:156].max() < 0.05 and trust[100, 45:56].min() > 0.9


@pytest.mark.parametrize("what", ["mesh", "clothes", "finder", "against"])
def test_what_disagrees_is_not(what):
    spot = np.hypot(X - 152, Y - 100) < 8
    options = {
        "mesh": {"head": DISK | spot},
        "clothes": {"person": DISK | spot, "below": np.where(X > 140, HEAD, -HEAD)},
        "finder": {"found": np.where(spot, 0.5, DISK)},
        "against": {"found": np.where(spot, 1.0, DISK)},
    }[what]
    trust = _trust(**options)
    assert trust[100, 152] < 0.05 and trust[100, 48] > 0.9


def test_nothing_or_everything_is_not_trusted():
    assert not _trust(person=np.zeros_like(DISK)).any() and not _trust(person=np.ones_like(DISK)).any()


@pytest.mark.parametrize("n", [1, 9])
def test_specks_and_bites_make_an_outline_ragged(rng, n):
    disk = np.where(DISK, 255, 0).astype(np.uint8)
    torn = np.where((AWAY > -7) & (AWAY < 2) & (X > 100), np.where(rng.random(DISK.shape) < 0.5, 255, 0), disk)
    large = torn.astype(np.uint8).repeat(n, axis=0).repeat(n, axis=1)
    smooth, k = smoothness(large, HEAD * n)
    at = n * 100 // k
    assert smooth[at, n * 147 // k] < 0.05 and smooth[at, n * 51 // k] > 0.9
    assert k == (1 if n == 1 else 2)
    assert (smoothness(np.zeros((40, 40), np.uint8), HEAD)[0] == 1).all()


@pytest.mark.parametrize("n", [1, 5])
def test_a_clean_matte_has_no_holes_and_no_specks(n):
    alpha = np.where(DISK, 255, 0).astype(np.uint8)
    alpha[95:105, 95:105] = 40  # a hole
    alpha[99:101, 100:] = 0  # a slot
    alpha[5:9, 5:9] = 255  # a speck
    large = alpha.repeat(n, axis=0).repeat(n, axis=1)
    _clean(large, HEAD * n)
    np.testing.assert_array_equal(large[::n][:, ::n][AWAY < -4], 255)
    assert not large[::n][:, ::n][AWAY > 4].any()
