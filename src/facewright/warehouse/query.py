"""Conditions on attributes, such as ``age > 30`` or ``sex = f``."""

from __future__ import annotations

import operator
import re
from collections import Counter
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from facewright.errors import ValueRangeError

Value = str | int | float | bool
_MOST_VALUES = 8

# Longest first, so that ">=" is not read as ">".
OPERATORS: dict[str, Callable[[Any, Any], bool]] = {
    "==": operator.eq,
    "!=": operator.ne,
    "<=": operator.le,
    ">=": operator.ge,
    "=": operator.eq,
    "<": operator.lt,
    ">": operator.gt,
}
KEY = r"[^<>=!\s](?:[^<>=!\n\r\t]*[^<>=!\s])?"
"""What can name an attribute: any text without the signs of a comparison."""
_CONDITION = re.compile(rf"\s*({KEY})\s*({'|'.join(OPERATORS)})\s*(.*?)\s*", re.DOTALL)
_AND = re.compile(r"""\s+and\s+(?=(?:[^"']|"[^"]*"|'[^']*')*$)""", re.IGNORECASE)


@dataclass(frozen=True)
class Condition:
    """One comparison: attribute `key`, `sign` of `OPERATORS`, and a value.

    A subject without the attribute never fits, also not with ``!=``. Numbers compare as numbers, also where one of
    them is written as text; anything else fits ``=`` and ``!=`` only, upper and lower case told apart.
    """

    key: str
    sign: str
    value: Value

    def fits(self, attributes: Mapping[str, Any]) -> bool:
        """Tell whether a subject's attributes meet the condition."""
        if self.key not in attributes:
            return False
        found, wanted = attributes[self.key], self.value
        numbers = _number(found), _number(wanted)
        if numbers[0] is not None and numbers[1] is not None:
            return OPERATORS[self.sign](*numbers)
        if self.sign in ("=", "==", "!="):
            return OPERATORS[self.sign](_text(found), _text(wanted))
        return False


def parse_value(text: str) -> Value:
    """Read a value as people type it: a number, true or false, else text; quotes make it text.

    Examples
    --------
    >>> [parse_value(text) for text in ("34", "1.5", "true", "f", "'34'")]
    [34, 1.5, True, 'f', '34']
    """
    text = text.strip()
    if len(text) >= 2 and text[0] == text[-1] and text[0] in "\"'":
        return text[1:-1]
    if text.lower() in ("true", "false"):
        return text.lower() == "true"
    if re.fullmatch(r"[+-]?\d{1,15}", text):
        return int(text)
    number = _number(text)
    return text if number is None else number


def parse_where(where: str | Iterable[str]) -> list[Condition]:
    """Read conditions, joined by ``and`` or given one by one; all of them must hold.

    Raises
    ------
    ValueRangeError
        If a condition is not attribute, sign, value, or compares order with what is no number.

    Examples
    --------
    >>> [(c.key, c.sign, c.value) for c in parse_where("age > 30 and sex == 'f'")]
    [('age', '>', 30), ('sex', '==', 'f')]
    """
    texts = [where] if isinstance(where, str) else list(where)
    conditions = []
    for text in (piece for whole in texts if whole.strip() for piece in _AND.split(whole)):
        match = _CONDITION.fullmatch(text)
        if match is None or not match[3]:
            raise ValueRangeError(
                f"condition must be an attribute, one of = != < <= > >=, and a value, such as age>30, got {text!r}."
            )
        value = parse_value(match[3])
        if match[2] in ("<", "<=", ">", ">=") and _number(value) is None:
            raise ValueRangeError(f"condition {text.strip()!r} must compare with a number, got {match[3]!r}.")
        conditions.append(Condition(match[1], match[2], value))
    return conditions


def conditions_of(where: str | Iterable[str] = (), **attributes: Value) -> list[Condition]:
    """Join conditions as text and attributes that must be equal."""
    return parse_where(where) + [Condition(key, "=", value) for key, value in attributes.items()]


def check_known(conditions: Iterable[Condition], attributes: Iterable[Mapping[str, Any]]) -> None:
    """Raise ValueRangeError if a condition asks for an attribute that no subject has: most likely a typing mistake."""
    known = sorted({key for mapping in attributes for key in mapping})
    for condition in conditions:
        if condition.key not in known:
            raise ValueRangeError(
                f"condition must be about an attribute that some subject has ({', '.join(known) or 'there is none'}), "
                f"got {condition.key!r}."
            )


def explain_nobody(where: str | Iterable[str], attributes: Sequence[Mapping[str, Any]]) -> list[str]:
    """Return a sentence a condition: how many fit it, and which values its attribute has.

    Parameters
    ----------
    where : str or iterable of str
        Conditions that nobody meets all of.
    attributes : sequence of mapping
        Of every subject.

    Examples
    --------
    >>> explain_nobody("sex=f and age>70", [{"sex": "female", "age": 71}, {"sex": "male", "age": 20}, {"age": 30}])
    ['0 of 3 people fit sex = f: sex is female, male.', '1 of 3 people fit age > 70: age is 20 to 71.']
    """
    sentences = []
    for condition in parse_where(where):
        n_fit = sum(condition.fits(mapping) for mapping in attributes)
        values = [mapping[condition.key] for mapping in attributes if condition.key in mapping]
        sentences.append(
            f"{n_fit} of {len(attributes)} people fit {condition.key} {condition.sign} {condition.value}: "
            f"{condition.key} is {_values_text(values)}."
        )
    return sentences


def _values_text(values: Sequence[Any]) -> str:
    """Name the values that occur, the most frequent first; the range where all are numbers."""
    if not values:
        return "not known of anybody"
    numbers = [_number(value) for value in values]
    known = [number for number in numbers if number is not None]
    if len(known) == len(values) and len(set(known)) > 1:
        return f"{min(known):g} to {max(known):g}"
    counts = Counter(_text(value) for value in values).most_common()
    more = f" and {len(counts) - _MOST_VALUES} more values" if len(counts) > _MOST_VALUES else ""
    return ", ".join(value for value, _ in counts[:_MOST_VALUES]) + more


def _number(value: Any) -> float | None:
    if isinstance(value, bool):
        return None
    if isinstance(value, int | float):
        return float(value)
    if isinstance(value, str) and re.fullmatch(r"[+-]?(\d+\.?\d*|\.\d+)([eE][+-]?\d{1,3})?", value.strip()):
        return float(value)
    return None


def _text(value: Any) -> str:
    return str(value).lower() if isinstance(value, bool) else str(value)
