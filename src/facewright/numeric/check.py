"""Guards for array arguments: one sentence pattern, expected and found."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from facewright.errors import ShapeError, ValueRangeError


def check_shape(name: str, array: Any, *axes: int | str, **sizes: int) -> dict[str, int]:
    """Check an array's shape against integers and named axes.

    Parameters
    ----------
    name : str
        The argument's name, for the message.
    array : ndarray
        The array to check.
    *axes : int or str
        One entry per axis: an int must match exactly; a name (``"V"``) must match ``sizes[name]`` where given and
        is bound to the found size otherwise.
    **sizes : int
        Known sizes of named axes.

    Returns
    -------
    dict of str to int
        `sizes` extended by the names bound here; pass it on to the next check.

    Raises
    ------
    ShapeError
        If the number of axes or any size differs.

    Examples
    --------
    >>> check_shape("vertices", np.zeros((4, 3)), "V", 3)
    {'V': 4}
    """
    shape = np.shape(array)
    bound = dict(sizes)
    ok = len(shape) == len(axes)
    if ok:
        for axis, found in zip(axes, shape):
            if isinstance(axis, str):
                ok &= bound.setdefault(axis, found) == found
            else:
                ok &= axis == found
    if not ok:
        expected = ", ".join(f"{a}={sizes[a]}" if isinstance(a, str) and a in sizes else str(a) for a in axes)
        raise ShapeError(f"{name} must have shape ({expected}), got {tuple(shape)}.")
    return bound


def check_finite(name: str, array: Any) -> None:
    """Raise ValueRangeError if `array` holds NaN or infinity; the message counts them."""
    values = np.asarray(array)
    bad = values.size - int(np.isfinite(values).sum())
    if bad:
        raise ValueRangeError(f"{name} must be finite, got {bad} NaN or infinite of {values.size} values.")


def check_indices(name: str, indices: Any, size: int) -> None:
    """Raise ValueRangeError unless all `indices` are integers in [0, size)."""
    values = np.asarray(indices)
    if values.size and (values.dtype.kind not in "iu" or values.min() < 0 or values.max() >= size):
        found = f"{values.dtype} in [{values.min()}, {values.max()}]"
        raise ValueRangeError(f"{name} must be integers in [0, {size}), got {found}.")


def check_choice(name: str, value: Any, choices: Mapping[Any, Any] | list[Any] | tuple[Any, ...]) -> None:
    """Raise ValueRangeError unless `value` is one of `choices`; the message lists them."""
    if value not in choices:
        raise ValueRangeError(f"{name} must be one of {', '.join(map(str, choices))}, got {value!r}.")
