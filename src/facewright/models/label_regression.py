"""From labels that people carry (age, sex, ethnicity, ...) to identity weights: FaceWarehouse 4.1, eq. 11-12."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from facewright.errors import ShapeError
from facewright.models.attribute_regression import leave_one_out_r_squared
from facewright.numeric.check import check_finite, check_shape

Label = str | int | float | bool | None

MIN_PEOPLE = 8  # fewer say nothing about a face's shape
MIN_PER_CATEGORY = 3
MAX_CATEGORIES = 12  # a label with more different texts is a note, not a kind of people


@dataclass(frozen=True, eq=False)
class LabelAttribute:
    """A label as a direction of identity weights, per standard deviation of the label.

    Parameters
    ----------
    name : str
        The label (``age``), or label and category (``sex: female``), which contrasts its people with all others.
    direction : ndarray of shape (I,), float64
        Change of identity weights for one standard deviation, the other labels held.
    mean, standard_deviation : float
        Of the number, or of being in the category (1) or not (0).
    n_people : int
        People who carry the label.
    r_squared : float
        Share of its variance that identity weights predict for people left out; not above 0 where shape tells nothing.
    """

    name: str
    direction: NDArray[np.float64]
    mean: float
    standard_deviation: float
    n_people: int
    r_squared: float


@dataclass(frozen=True)
class _Column:
    """One number for each person, NaN where unknown; columns of one label are one group."""

    group: str
    name: str
    values: NDArray[np.float64]


def fit_label_regression(
    identity_weights: NDArray[np.floating], labels: Mapping[str, Sequence[Label]]
) -> tuple[tuple[LabelAttribute, ...], dict[str, str]]:
    """Learn how identity weights go with labels.

    Parameters
    ----------
    identity_weights : ndarray of shape (N, I)
        One row per person.
    labels : mapping of str to sequence of N values
        Numbers, texts or booleans; None where a person does not carry the label. Numbers are used as they are; texts
        and booleans as one column of 0 and 1 for each category.

    Returns
    -------
    attributes : tuple of LabelAttribute
        In the order of `labels`, categories by name.
    left_out : dict of str to str
        Labels that say nothing, and why.

    Raises
    ------
    ShapeError, ValueRangeError
        If a label has not N values, or the weights are not finite.

    Notes
    -----
    FaceWarehouse eq. 11-12 with the labels as features: M_fea = W_id F^+. Measured attributes are not among them, so a
    change of age changes the shape as a whole. Where a person's *other* labels are unknown, they count as average.
    """
    N = check_shape("identity_weights", identity_weights, "N", "I")["N"]
    check_finite("identity_weights", identity_weights)
    columns: list[_Column] = []
    left_out: dict[str, str] = {}
    for name, values in labels.items():
        if len(values) != N:
            raise ShapeError(f"label {name!r} must have one value for each of the {N} people, got {len(values)}.")
        found = _columns(name, values)
        if isinstance(found, str):
            left_out[name] = found
        else:
            columns += found
    W = np.asarray(identity_weights, dtype=np.float64)
    return tuple(_fit(W, column, columns) for column in columns), left_out


def _columns(name: str, values: Sequence[Label]) -> list[_Column] | str:
    """Return the columns of a label, or why it has none."""
    known = [value for value in values if value is not None]
    if len(known) < MIN_PEOPLE:
        return f"known of {len(known)} people only, at least {MIN_PEOPLE} are needed"
    if all(isinstance(value, int | float) and not isinstance(value, bool) for value in known):
        numbers = np.array([np.nan if value is None else float(value) for value in values])
        if np.nanstd(numbers) <= 1e-9 * max(1.0, float(np.nanmax(np.abs(numbers)))):
            return "the same for everybody"
        return [_Column(name, name, numbers)]
    counts = Counter(_text(value) for value in known)
    if len(counts) > MAX_CATEGORIES:
        return f"of {len(counts)} different values, more than {MAX_CATEGORIES} kinds of people"
    kinds = [kind for kind, n in sorted(counts.items()) if n >= MIN_PER_CATEGORY and len(known) - n >= MIN_PER_CATEGORY]
    if not kinds:
        return f"no kind has at least {MIN_PER_CATEGORY} people in it and outside of it"
    texts = [None if value is None else _text(value) for value in values]
    return [
        _Column(name, f"{name}: {kind}", np.array([np.nan if t is None else float(t == kind) for t in texts]))
        for kind in kinds
    ]


def _fit(W: NDArray[np.float64], column: _Column, columns: Sequence[_Column]) -> LabelAttribute:
    """Regress the weights on one column, with the other labels' columns and a constant beside it."""
    known = np.isfinite(column.values)
    values = column.values[known]
    mean, deviation = float(values.mean()), float(values.std())
    features = [(values - mean) / deviation]
    for other in columns:
        if other.group != column.group and len(features) + 3 < len(values):
            features.append(np.nan_to_num(_standardised(other.values)[known]))
    F = np.stack([*features, np.ones(len(values))])
    # Eq. (12); the pseudoinverse, as labels may go together
    direction = W[known].T @ np.linalg.pinv(F, rcond=1e-8)
    r_squared = float(leave_one_out_r_squared(W[known], features[0][:, None])[0])
    return LabelAttribute(column.name, direction[:, 0], mean, deviation, len(values), r_squared)


def _standardised(values: NDArray[np.float64]) -> NDArray[np.float64]:
    return (values - np.nanmean(values)) / max(float(np.nanstd(values)), 1e-12)


def _text(value: Label) -> str:
    return str(value).lower() if isinstance(value, bool) else str(value)
