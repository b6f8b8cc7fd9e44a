"""Text tables of numbers with holes: lines of a file, cells to numbers."""

from __future__ import annotations

import os
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from facewright.errors import FileFormatError, StoreError

MAX_BYTES = 1 << 31
_HOLES = ("", "nan", "na", "n/a", "null", "none", "-", "inf", "-inf")


def read_lines(path: str | os.PathLike[str]) -> list[str]:
    """Return the lines of a text file.

    Raises
    ------
    StoreError
        If it is missing or unreadable.
    FileFormatError
        If it is no text, or larger than 2 GB.
    """
    path = Path(path)
    try:
        if path.stat().st_size > MAX_BYTES:
            raise FileFormatError(f"{path} must be at most 2 GB, got {path.stat().st_size} bytes.")
        data = path.read_bytes()
    except OSError as error:
        raise StoreError(f"{path} cannot be read: {error.strerror or error}.") from error
    if b"\x00" in data[:4096]:
        raise FileFormatError(f"{path} must be a text file, got binary data.")
    try:
        return data.decode("utf-8-sig").splitlines()
    except UnicodeDecodeError:
        return data.decode("latin-1").splitlines()


def number(cell: str) -> float | None:
    """Return a cell's number, NaN for a hole, None for text."""
    text = cell.strip()
    if text.lower() in _HOLES:
        return float("nan")
    try:
        return float(text)
    except ValueError:
        return None


def numbers(path: str | os.PathLike[str], rows: list[list[str]], width: int, *, first_line: int) -> NDArray[np.float64]:
    """Return the table (T, width) of cells; short rows end in holes, more cells than `width` must be empty.

    Raises
    ------
    FileFormatError
        If a cell is text, a row is too long, or there is no row.
    """
    if not rows:
        raise FileFormatError(f"{path} must hold at least one frame, got none.")
    table = np.full((len(rows), width), np.nan)
    for k, row in enumerate(rows):
        cells = row[:width]
        if any(cell.strip() for cell in row[width:]):
            raise FileFormatError(f"{path} must have {width} columns, got {len(row)} in frame {k + 1}.")
        values = [number(cell) for cell in cells]
        if None in values:
            bad = cells[values.index(None)]
            raise FileFormatError(f"{path} must hold numbers, got {bad[:40]!r} about line {first_line + k}.")
        table[k, : len(cells)] = values
    table[~np.isfinite(table)] = np.nan
    return table
