"""Conditions on attributes."""

import pytest
from hypothesis import given
from hypothesis import strategies as st

from facewright.errors import ValueRangeError
from facewright.warehouse.query import Condition, conditions_of, explain_nobody, parse_value, parse_where

ANNA = {"age": 34, "sex": "f", "glasses": True, "height": "1.70", "note": "and so on", "hair colour": "brown"}


@pytest.mark.parametrize(
    ("where", "fits"),
    [
        ("age > 30", True),
        ("age>=34 and age<=34", True),
        ("age < 34", False),
        ("age != 34", False),
        ("age = 34.0", True),
        ("sex = f", True),
        ("sex == 'f'", True),
        ("sex = F", False),
        ("glasses = true", True),
        ("glasses = false", False),
        ("height > 1.6", True),  # a number that was written as text
        ('note = "and so on"', True),
        ("hair colour = brown and age > 3", True),
        ("hair colour != brown", False),
        ("weight != 3", False),  # who has no such attribute never fits
        ("sex > 3", False),
        ("age = old", False),
        ("", True),
    ],
)
def test_conditions(where, fits):
    assert all(condition.fits(ANNA) for condition in parse_where(where)) is fits


@pytest.mark.parametrize(
    "where", ["age", "age >", "> 3", "age ~ 3", "age > old", "age > 3 and", "a = ", "=", "sex < f"]
)
def test_what_is_no_condition_is_refused(where):
    with pytest.raises(ValueRangeError, match="condition"):
        parse_where(where)


def test_attributes_as_arguments():
    assert conditions_of("age > 3", sex="f") == [Condition("age", ">", 3), Condition("sex", "=", "f")]


@given(st.text(max_size=40))
def test_any_text_is_read_or_refused(text):
    try:
        conditions = parse_where(text)
    except ValueRangeError:
        return
    for condition in conditions:
        condition.fits(ANNA)


@given(st.one_of(st.integers(-(10**14), 10**14), st.floats(-1e9, 1e9), st.booleans()))
def test_values_are_read_as_they_are_shown(value):
    assert parse_value(str(value)) == value


def test_why_nobody_fits():
    people = [{"sex": "m", "age": 20, "tag": f"t{k}", "glasses": k == 0} for k in range(12)] + [{"sex": "f"}]
    told = explain_nobody(["sex=female", "age>30 and tag=x", "glasses=yes", "height>1"], people)
    assert told == [
        "0 of 13 people fit sex = female: sex is m, f.",
        "0 of 13 people fit age > 30: age is 20.",
        "0 of 13 people fit tag = x: tag is t0, t1, t2, t3, t4, t5, t6, t7 and 4 more values.",
        "0 of 13 people fit glasses = yes: glasses is false, true.",
        "0 of 13 people fit height > 1: height is not known of anybody.",
    ]
