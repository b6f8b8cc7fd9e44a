"""Markers in wide tables: one row a frame, three columns a marker, in the dialects of common programs."""

from __future__ import annotations

import os
import re
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from facewright.errors import FileFormatError
from facewright.io.atomic import write_atomically
from facewright.io.c3d import MarkerTable
from facewright.io.marker_data import MarkerData
from facewright.io.marker_text import number, numbers, read_lines
from facewright.io.marker_units import unit_named

_AXIS = re.compile(r"^(?P<label>.*?)[\s_.:\-|]*\(?(?P<axis>[xyzXYZ])\)?(\s*[\(\[](?P<unit>\w+)[\)\]])?$")
_TIME = re.compile(r"^(time|t|seconds|timestamp|time[ _]*[\(\[]?\w*[\)\]]?)$", re.IGNORECASE)
_MOTIVE_RATE = ("Export Frame Rate", "Capture Frame Rate")


class _Columns(NamedTuple):
    """Labels, the first column of each, the column of times or None, and a unit."""

    labels: list[str]
    columns: NDArray[np.intp]
    time: int | None
    unit: str | None


def read_marker_csv(path: str | os.PathLike[str]) -> MarkerTable:
    """Read markers from a CSV table.

    Understood are one header row (``Time,L_X,L_Y,L_Z,...``, also ``L.X``, ``L:X``, ``LX`` and units in brackets), and
    two rows, labels above axes, as Vicon Nexus (``Frame,Sub Frame,X,Y,Z``) and OptiTrack Motive export them. Columns
    may be parted by commas, semicolons or tabs. Columns that are no markers are left out.

    Raises
    ------
    StoreError
        If the file is missing or unreadable.
    FileFormatError
        If no marker columns, no times and no frame rate are found, or a cell is no number.
    """
    lines = read_lines(path)
    delimiter = max(",;\t", key=lambda mark: sum(line.count(mark) for line in lines[:40]))
    rows = [[cell.strip().strip('"') for cell in line.split(delimiter)] for line in lines[:40]]
    first = next((k for k, row in enumerate(rows) if _is_data(row) and _columns(rows[:k]) is not None), None)
    found = None if first is None else _columns(rows[:first])
    if first is None or found is None:
        raise FileFormatError(
            f"{path} must be a table of markers with a header such as Time,L_X,L_Y,L_Z, got something else."
        )
    body = [line.split(delimiter) for line in lines[first:] if line.strip(delimiter + " ")]
    end = next((k for k, row in enumerate(body) if not _is_data([cell.strip() for cell in row])), len(body))
    width = max(len(row) for row in body[:end])
    table = numbers(path, body[:end], width, first_line=first + 1)
    if int(found.columns.max()) + 2 >= width:
        raise FileFormatError(f"{path} must have {int(found.columns.max()) + 3} columns as its header, got {width}.")
    positions = table[:, found.columns[:, None] + np.arange(3)]
    return MarkerTable(
        _times(path, table, found, rows[:first], delimiter), tuple(found.labels), positions, found.unit, None
    )


def write_marker_csv(path: str | os.PathLike[str], markers: MarkerData) -> None:
    """Write markers as ``Time,L_X (mm),L_Y (mm),L_Z (mm),...``: seconds, millimetres, y up; unseen ones are empty.

    Raises
    ------
    StoreError
        If the file cannot be written.
    """
    T = len(markers.times)
    with write_atomically(path) as temporary, temporary.open("w", encoding="utf-8", newline="\n") as file:
        file.write(",".join(["Time", *(f"{name}_{axis} (mm)" for name in markers.labels for axis in "XYZ")]) + "\n")
        for time, row in zip(markers.times, markers.positions.reshape(T, -1).tolist()):
            cells = ",".join("" if value != value else f"{value:.5f}" for value in row)
            file.write(f"{time:.6f},{cells}\n")


def _is_data(row: list[str]) -> bool:
    """Return whether a row holds numbers and holes, and a number at its start."""
    values = [number(cell) for cell in row]
    start = values[0] if values else None
    return len(row) > 3 and None not in values and start is not None and start == start


def _columns(header: list[list[str]]) -> _Columns | None:
    """Find the markers' columns in the rows above the numbers, or None."""
    for k in range(len(header) - 1, -1, -1):
        axes = [cell.lower() for cell in header[k]]
        triples = [i for i in range(len(axes) - 2) if axes[i : i + 3] == ["x", "y", "z"]]
        if triples:
            return _two_rows(header, k, triples)
    return _one_row(header[-1]) if header else None


def _two_rows(header: list[list[str]], k: int, triples: list[int]) -> _Columns | None:
    """Read labels from the rows above the row of axes, units from that below."""
    kinds = next((row for row in header[:k] if "Position" in row), None)
    named = next((row for row in header[:k] if len(row) > 1 and row[1] == "Name"), None)  # Motive
    above = named if named is not None else header[k - 1] if k else []
    if kinds is not None:
        triples = [i for i in triples if i < len(kinds) and kinds[i] == "Position"]
    labels, columns = [], []
    for i in triples:
        label = above[i] if i < len(above) else ""
        if label:
            labels.append(label.rpartition(":")[2].strip() or label)
            columns.append(i)
    if not labels:
        return None
    below = header[k + 1] if k + 1 < len(header) else []
    unit = unit_named(below[columns[0]]) if columns[0] < len(below) else None
    cells = [cell for row in header[:k] for cell in row]
    if unit is None and "Length Units" in cells[:-1]:
        unit = unit_named(cells[cells.index("Length Units") + 1])
    time = next((i for i, cell in enumerate(header[k]) if _TIME.match(cell)), None)
    return _Columns(labels, np.array(columns), time, unit)


def _one_row(row: list[str]) -> _Columns | None:
    """Read labels that end in x, y and z in neighbouring columns."""
    labels, columns, unit = [], [], None
    matches = [_AXIS.match(cell) for cell in row]
    for i in range(len(row) - 2):
        three = [match for match in matches[i : i + 3] if match is not None]
        axes = "".join(match["axis"].lower() for match in three)
        if len(three) == 3 and axes == "xyz" and len({match["label"] for match in three}) == 1 and three[0]["label"]:
            labels.append(three[0]["label"])
            columns.append(i)
            unit = unit or (unit_named(three[0]["unit"]) if three[0]["unit"] else None)
    time = next((i for i, cell in enumerate(row) if _TIME.match(cell)), None)
    return _Columns(labels, np.array(columns), time, unit) if labels else None


def _times(
    path: str | os.PathLike[str],
    table: NDArray[np.float64],
    found: _Columns,
    header: list[list[str]],
    delimiter: str,
) -> NDArray[np.float64]:
    """Return seconds: the column of times, or frames over the rate that the header states."""
    if found.time is not None and np.isfinite(table[:, found.time]).all():
        return table[:, found.time]
    cells = [cell for row in header for cell in row]
    for name in _MOTIVE_RATE:
        if name in cells[:-1] and (number(cells[cells.index(name) + 1]) or 0.0) > 0:
            return np.arange(len(table)) / float(cells[cells.index(name) + 1])
    for row in header:  # Nexus: the rate stands alone in its row
        filled = [cell for cell in row if cell]
        rate = number(filled[0]) if len(filled) == 1 else None
        if rate is not None and rate > 0:
            return np.arange(len(table)) / rate
    raise FileFormatError(f"{path} must have a column of times or state its frame rate, got neither.")
