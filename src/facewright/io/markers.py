"""Motion capture files by their suffix: .c3d, .trc and .csv to labelled points in millimetres, and back."""

from __future__ import annotations

import os
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from facewright.errors import FileFormatError, ValueRangeError
from facewright.io.c3d import MarkerTable, read_c3d, write_c3d
from facewright.io.marker_csv import read_marker_csv, write_marker_csv
from facewright.io.marker_data import MarkerData
from facewright.io.marker_units import MM_PER_UNIT, guess_unit, turned_up, unit_named
from facewright.io.trc import read_trc, write_trc
from facewright.numeric.check import check_choice

MARKER_SUFFIXES = (".c3d", ".trc", ".csv")


@dataclass(frozen=True, eq=False)
class MarkerRecording:
    """Markers as read from a file.

    Parameters
    ----------
    markers : MarkerData
        Millimetres; y up where `up` is known.
    unit : str
        The file's unit.
    up : str or None
        The file's axis that points up; None where it does not say and nobody did, and axes are as in the file.
    notes : tuple of str
        What was guessed or mended, one sentence each.
    """

    markers: MarkerData
    unit: str
    up: str | None
    notes: tuple[str, ...] = ()


def read_markers(path: str | os.PathLike[str], *, unit: str | None = None, up: str | None = None) -> MarkerRecording:
    """Read a motion capture file by its suffix: C3D, TRC or CSV.

    Parameters
    ----------
    path : str or path
    unit : str, optional
        ``"mm"``, ``"cm"``, ``"m"`` or ``"in"``; as the file says, or guessed from a face's size, where absent.
    up : str, optional
        The file's axis that points up, ``"y"`` or ``"z"`` mostly; as the file says where absent.

    Raises
    ------
    StoreError, FileFormatError, MissingExtraError
        As the readers of the formats.
    ValueRangeError
        If unit or axis are unknown, or the unit cannot be guessed.
    """
    table = _read_table(Path(path))
    if unit is not None:
        check_choice("unit", unit, MM_PER_UNIT)
    notes: list[str] = []
    labels, positions = _unique(table, notes)
    stated = unit_named(table.unit) if table.unit else None
    if unit is None and stated is None:
        unit = guess_unit(positions)
        notes.append(f"the file does not state its unit; {unit} gives a face's size")
    chosen = unit or stated or "mm"
    positions = positions * MM_PER_UNIT[chosen]
    axis = up or table.up
    if axis is not None:
        positions = turned_up(positions, axis)
    times = table.times
    if len(times) > 1 and (np.diff(times) <= 0).any():
        raise FileFormatError(f"{path} must have times that increase, got one that does not.")
    holes = np.isnan(positions)
    positions[holes.any(axis=2)] = np.nan
    return MarkerRecording(MarkerData(times, labels, positions), chosen, axis, tuple(notes))


def write_markers(path: str | os.PathLike[str], markers: MarkerData) -> None:
    """Write markers by the path's suffix: .c3d, .trc or .csv; millimetres, y up.

    Raises
    ------
    ValueRangeError
        If the suffix is another.
    StoreError, MissingExtraError
        As the writers of the formats.
    """
    suffix = Path(path).suffix.lower()
    writers = {".c3d": write_c3d, ".trc": write_trc, ".csv": write_marker_csv}
    if suffix not in writers:
        raise ValueRangeError(f"a marker file must end in {', '.join(MARKER_SUFFIXES)}, got {Path(path).name!r}.")
    writers[suffix](path, markers)


def _read_table(path: Path) -> MarkerTable:
    readers = {".c3d": read_c3d, ".trc": read_trc, ".csv": read_marker_csv}
    suffix = path.suffix.lower()
    if suffix not in readers:
        raise FileFormatError(f"{path} must be a marker file in {', '.join(MARKER_SUFFIXES)}, got {suffix!r}.")
    return readers[suffix](path)


def _unique(table: MarkerTable, notes: list[str]) -> tuple[tuple[str, ...], np.ndarray]:
    """Return labels and positions (T, M, 3) without markers never seen, repeated labels numbered."""
    seen = np.isfinite(table.positions).all(axis=2).any(axis=0)
    if not seen.any():
        raise FileFormatError("the file must hold a marker that was seen, got none.")
    if not seen.all():
        notes.append(f"{int((~seen).sum())} labels without any marker were left out")
    labels: list[str] = []
    count: dict[str, int] = {}
    for label in (label for label, there in zip(table.labels, seen) if there):
        count[label] = count.get(label, 0) + 1
        labels.append(label if count[label] == 1 else f"{label}#{count[label]}")
    repeated = sum(n > 1 for n in count.values())
    if repeated:
        notes.append(f"{repeated} labels occur more than once and were numbered")
    return tuple(labels), table.positions[:, seen].copy()
