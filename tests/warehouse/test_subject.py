"""One person of the database, as arrays."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from facewright.errors import ShapeError, ValueRangeError
from facewright.warehouse.subject import Subject, check_name


def subject(**changes):
    values = {"name": "ada", "expressions": ("neutral", "smile"), "meshes": np.zeros((2, 5, 3), np.float32)}
    return Subject(**{**values, **changes})


def test_a_subject_needs_no_more_than_meshes():
    assert subject().blendshapes is None


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"expressions": ("smile", "neutral")}, "begin with 'neutral'"),
        ({"expressions": ("neutral", "neutral")}, "must be unique"),
        ({"expressions": ()}, "begin with 'neutral'"),
        ({"meshes": np.full((2, 5, 3), np.nan, np.float32)}, "meshes of subject 'ada' must be finite"),
        ({"blendshapes": np.full((47, 5, 3), np.inf, np.float32)}, "blendshapes of subject 'ada' must be finite"),
    ],
)
def test_subjects_refuse_impossible_values(change, message):
    with pytest.raises(ValueRangeError, match=message):
        subject(**change)


@pytest.mark.parametrize(
    "change",
    [
        {"meshes": np.zeros((3, 5, 3), np.float32)},
        {"blendshapes": np.zeros((47, 6, 3), np.float32)},
        {"blendshapes": np.zeros((46, 5, 3), np.float32)},
        {"expression_weights": np.zeros((2, 47))},
        {"depth": np.zeros((2, 4, 6), np.float32), "color": np.zeros((2, 4, 7, 3), np.uint8)},
        {"landmarks": np.zeros((2, 68, 2))},
        {"depth": np.zeros((2, 4, 6), np.float32), "raw_depth": np.zeros((2, 4, 7), np.float32)},
        {"camera_from_model": np.zeros((2, 3, 4))},
    ],
)
def test_subjects_refuse_arrays_that_do_not_match(change):
    with pytest.raises(ShapeError):
        subject(**change)


@given(st.text(max_size=12))
def test_names_are_safe_in_paths(name):
    try:
        check_name(name)
    except ValueRangeError:
        return
    assert name
    assert name == name.strip("/ \\")
    assert not name.startswith(".")
    assert "/" not in name


def test_names_that_are_refused():
    for bad in ("", ".hidden", "a/b", "a b", "..", "é", "x" * 129):
        with pytest.raises(ValueRangeError, match="name of a subject"):
            check_name(bad)
