import itertools

import numpy as np
import pytest
from scipy.ndimage import binary_dilation, binary_erosion, gaussian_filter, label

from facewright.errors import DegenerateError, ShapeError, ValueRangeError
from facewright.imaging import seam
from facewright.imaging.seam import find_seam


def seam_cost(region, difference):
    """Sum of both pixels' differences over all neighbours on either side."""
    total = 0.0
    for axis in (0, 1):
        first = [slice(None)] * 2
        second = [slice(None)] * 2
        first[axis], second[axis] = slice(None, -1), slice(1, None)
        across = region[tuple(first)] != region[tuple(second)]
        total += (difference[tuple(first)] + difference[tuple(second)])[across].sum()
    return total


@pytest.fixture()
def ring():
    y, x = np.mgrid[:90, :100]
    radius = np.hypot(x - 50, y - 45)
    return radius < 15, radius < 38


def test_no_region_is_cheaper(rng):
    """All regions of a small band, tried one by one."""
    inner = np.zeros((5, 6), bool)
    inner[2, 2] = True
    outer = np.zeros((5, 6), bool)
    outer[1:4, 1:5] = True
    a = rng.uniform(0, 200, (5, 6, 3))
    got = find_seam(a, np.zeros_like(a), inner, outer, level_free=False, length_cost=0.5)
    cost = gaussian_filter(np.abs(a).mean(2).astype(np.float32), 0.7) + 0.25
    band = np.argwhere(outer & ~inner)
    best = np.inf
    for choice in itertools.product([False, True], repeat=len(band)):
        region = inner.copy()
        region[tuple(band.T)] = choice
        best = min(best, seam_cost(region, cost))
    assert seam_cost(got, cost) <= best + 0.5


def test_runs_through_the_gap(rng, ring):
    """The pictures agree along a wavy line only."""
    inner, outer = ring
    y, x = np.mgrid[:90, :100]
    radius, angle = np.hypot(x - 50, y - 45), np.arctan2(y - 45, x - 50)
    valley = np.abs(radius - (26 + 6 * np.sin(3 * angle)))
    a = np.full((90, 100, 3), 100.0)
    b = a + np.clip(12 * (valley - 1.5), 0, 90)[..., None] * rng.choice([-1, 1], (90, 100, 1))
    got = find_seam(a, b, inner, outer)
    assert (got[inner]).all() and not got[~outer].any()
    edge = binary_dilation(got) & ~binary_erosion(got)
    assert np.percentile(valley[edge], 95) < 3
    assert label(got)[1] == 1


def test_a_constant_difference_is_no_obstacle(ring):
    """With `level_free`, a region of equal colour is worth no less than one with a constant shift."""
    inner, outer = ring
    a = np.full((90, 100, 3), 100.0)
    b = a + 40
    b[:, :30] += 60  # a real disagreement on the left, within the band
    got = find_seam(a, b, inner, outer)
    assert not (got & (np.arange(100) < 29)[None]).any()


def test_coarse_to_fine_is_hardly_dearer(rng, ring, monkeypatch):
    inner, outer = ring
    a = rng.uniform(0, 60, (90, 100, 3))
    b = np.zeros_like(a)
    exact = find_seam(a, b, inner, outer)
    monkeypatch.setattr(seam, "_MAX_NODES", 500)
    quick = find_seam(a, b, inner, outer)
    assert quick[inner].all() and not quick[~outer].any()
    difference = np.abs(a - np.median(a[outer & ~inner], axis=0)).mean(2) + 0.25
    assert seam_cost(quick, difference) < 1.25 * seam_cost(exact, difference)


def test_two_eyes_and_the_pictures_border(rng):
    """Several bands at once; one runs over the picture's border."""
    y, x = np.mgrid[:60, :120]
    left, right = np.hypot(x - 5, y - 30), np.hypot(x - 85, y - 30)
    inner, outer = (left < 8) | (right < 8), (left < 18) | (right < 18)
    got = find_seam(rng.uniform(0, 255, (60, 120, 3)), np.zeros((60, 120, 3)), inner, outer)
    assert got[inner].all() and not got[~outer].any()
    assert label(got)[1] == 2


def test_without_a_band_or_an_outside_there_is_nothing_to_choose(rng):
    a = rng.uniform(0, 255, (20, 20, 3))
    inner = np.zeros((20, 20), bool)
    inner[5:9, 5:9] = True
    np.testing.assert_array_equal(find_seam(a, 0 * a, inner, inner), inner)
    assert find_seam(a, 0 * a, inner, np.ones((20, 20), bool))[inner].all()


@pytest.mark.parametrize(
    ("change", "error"),
    [
        ({"a": np.zeros((8, 8))}, ShapeError),
        ({"b": np.zeros((8, 9, 3))}, ShapeError),
        ({"inner": np.zeros((8, 9), bool)}, ShapeError),
        ({"outer": np.ones((8, 9), bool)}, ShapeError),
        ({"inner": np.zeros((8, 8), bool)}, DegenerateError),
        ({"outer": np.zeros((8, 8), bool)}, ValueRangeError),
    ],
)
def test_refuses(change, error):
    picture = np.zeros((8, 8, 3), np.uint8)
    good = {"a": picture, "b": picture, "inner": np.eye(8, dtype=bool), "outer": np.ones((8, 8), bool)}
    with pytest.raises(error):
        find_seam(**(good | change))
