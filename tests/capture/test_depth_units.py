"""Units of depth are told from how far away the nearest things are."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from facewright.capture.depth_units import depth_factor, guess_counts_per_metre, nearest_depth
from facewright.errors import FileFormatError


def _scene(near, unit=1.0, size=(48, 64)):
    """A head `near` mm away before a wall 1.5 m behind it, in a unit of so many mm."""
    y, x = np.mgrid[: size[0], : size[1]]
    head = near + 0.2 * ((x - 32) ** 2 + (y - 24) ** 2)
    depth = np.where(head < near + 80, head, near + 1500.0)
    depth[:, :5] = 0
    return depth / unit


@given(st.floats(200, 1200))
def test_millimetres_stay(near):
    assert depth_factor([_scene(near)], "a") == (1.0, None)


@pytest.mark.parametrize(
    ("unit", "word"), [(1000.0, "metres"), (10.0, "centimetres"), (0.1, "tenths"), (0.2, "fifths")]
)
@pytest.mark.parametrize("near", [450.0, 600.0])
def test_other_units_are_told_and_said(unit, word, near):
    depth = _scene(near, unit)
    factor, sentence = depth_factor([depth], "anna/smile")
    assert factor == unit
    assert word in sentence and "anna/smile" in sentence and "not millimetres" in sentence
    assert abs(nearest_depth([depth * factor]) - near) < 40


@given(st.floats(200, 1100))
def test_metres_are_always_told(near):
    assert depth_factor([_scene(near, 1000.0)], "a")[0] == 1000.0


@pytest.mark.parametrize("empty", [np.zeros((4, 4)), np.zeros((0, 4))])
def test_no_depth_is_refused(empty):
    with pytest.raises(FileFormatError, match="must have depth, got frames without any"):
        depth_factor([empty], "a")


def test_nonsense_is_refused():
    with pytest.raises(FileFormatError, match="in no usual unit"):
        depth_factor([np.full((4, 4), 1e12)], "a")
    with pytest.raises(FileFormatError, match="in no usual unit"):
        depth_factor([np.full((4, 4), 1e-9)], "a")


def test_metres_rounded_to_whole_numbers_are_refused():
    """16-bit pictures of depth in metres hold ones and zeros: the shape is lost, no factor brings it back."""
    with pytest.raises(FileFormatError, match="only 2 different ones"):
        depth_factor([np.round(_scene(600.0, 1000.0))], "a")


@pytest.mark.parametrize("per_metre", [5000.0, 1000.0, 10000.0])
@pytest.mark.parametrize("near", [450.0, 600.0])
def test_counts_that_say_nothing(per_metre, near):
    counts = np.round(_scene(near) * per_metre / 1000.0).astype(np.uint16)
    assert guess_counts_per_metre(counts) == per_metre


def test_empty_counts_are_taken_as_tum_has_them():
    assert guess_counts_per_metre(np.zeros((4, 4), np.uint16)) == 5000.0
