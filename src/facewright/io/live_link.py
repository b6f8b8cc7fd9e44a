"""Face curves as text: Live Link Face recordings and Audio2Face tables, read in any spelling, written as Live Link."""

from __future__ import annotations

import csv
import io
import math
import re
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from facewright.errors import FileFormatError, StoreError, ValueRangeError
from facewright.io.atomic import write_atomically
from facewright.io.timecode import read_times, timecode
from facewright.numeric.check import check_finite, check_shape

SHAPE_COLUMNS: tuple[str, ...] = (
    *("EyeBlinkLeft", "EyeLookDownLeft", "EyeLookInLeft", "EyeLookOutLeft", "EyeLookUpLeft", "EyeSquintLeft"),
    *("EyeWideLeft", "EyeBlinkRight", "EyeLookDownRight", "EyeLookInRight", "EyeLookOutRight", "EyeLookUpRight"),
    *("EyeSquintRight", "EyeWideRight", "JawForward", "JawRight", "JawLeft", "JawOpen", "MouthClose", "MouthFunnel"),
    *("MouthPucker", "MouthRight", "MouthLeft", "MouthSmileLeft", "MouthSmileRight", "MouthFrownLeft"),
    *("MouthFrownRight", "MouthDimpleLeft", "MouthDimpleRight", "MouthStretchLeft", "MouthStretchRight"),
    *("MouthRollLower", "MouthRollUpper", "MouthShrugLower", "MouthShrugUpper", "MouthPressLeft", "MouthPressRight"),
    *("MouthLowerDownLeft", "MouthLowerDownRight", "MouthUpperUpLeft", "MouthUpperUpRight", "BrowDownLeft"),
    *("BrowDownRight", "BrowInnerUp", "BrowOuterUpLeft", "BrowOuterUpRight", "CheekPuff", "CheekSquintLeft"),
    *("CheekSquintRight", "NoseSneerLeft", "NoseSneerRight", "TongueOut"),
)
"""The 52 shapes of Live Link Face, in the column order of its recordings."""
ANGLE_COLUMNS: tuple[str, ...] = (
    *("HeadYaw", "HeadPitch", "HeadRoll", "LeftEyeYaw", "LeftEyePitch", "LeftEyeRoll"),
    *("RightEyeYaw", "RightEyePitch", "RightEyeRoll"),
)
"""The nine angles that follow them, radians."""
CURVE_COLUMNS: tuple[str, ...] = SHAPE_COLUMNS + ANGLE_COLUMNS

MAX_BYTES = 1 << 29
_COUNT = "blendshapecount"
_KNOWN = {name.lower(): k for k, name in enumerate(CURVE_COLUMNS)}
# Names that some writers use for a shape of both sides, and the column it is.
_OTHER_SPELLINGS = {"lookdownleft": "eyelookdownleft", "lookdownright": "eyelookdownright"}


@dataclass(frozen=True, eq=False)
class FaceCurves:
    """A recording of ARKit's 52 coefficients and nine angles over T moments.

    Signs of the angles, seen by the subject: yaw is positive towards the *right*, pitch *downwards*, roll lifts the
    right side (the head tilts to the left shoulder): Unreal's left-handed axes. For yaw and pitch of the eyes this was
    measured on a real recording (positive ``LeftEyeYaw`` goes with ``EyeLookInLeft``, positive ``LeftEyePitch`` with
    ``EyeLookDownLeft``); in that recording the head's angles are all zero, and they are taken to be the same.

    Parameters
    ----------
    times : ndarray of shape (T,), float64, seconds
        Strictly increasing, the first is 0.
    values : ndarray of shape (T, 61), float64
        In the order of `CURVE_COLUMNS`: shapes in [0, 1], angles in radians; zero where the source says nothing.
    tracked : ndarray of shape (T,), bool
        Whether a face was seen; values of the other rows are zero and mean nothing.
    notes : tuple of str
        What the reader did about oddities: one sentence each, for the user.

    Raises
    ------
    ShapeError, ValueRangeError
        If the arrays do not match, a value is not finite, a shape lies outside [0, 1] or times do not increase.
    """

    times: NDArray[np.float64]
    values: NDArray[np.float64]
    tracked: NDArray[np.bool_]
    notes: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        sizes = check_shape("times", self.times, "T")
        check_shape("values", self.values, "T", len(CURVE_COLUMNS), **sizes)
        check_shape("tracked", self.tracked, "T", **sizes)
        check_finite("times", self.times)
        check_finite("values", self.values)
        shapes = self.values[:, : len(SHAPE_COLUMNS)]
        if shapes.size and not (shapes.min() >= 0 and shapes.max() <= 1):
            raise ValueRangeError(f"shapes must lie in [0, 1], got [{shapes.min():.3g}, {shapes.max():.3g}].")
        if (np.diff(self.times) <= 0).any():
            raise ValueRangeError("times must increase from row to row, got one that does not.")

    def column(self, name: str) -> NDArray[np.float64]:
        """Return the (T,) values of one of `CURVE_COLUMNS`."""
        return self.values[:, CURVE_COLUMNS.index(name)]


def read_face_curves(path: str | Path, *, frames_per_second: float | None = None) -> FaceCurves:
    """Read a Live Link Face or Audio2Face recording, or any table whose header names ARKit's shapes.

    Spellings that are understood: ``EyeBlinkLeft``, ``eyeBlinkLeft``, ``eyeBlink_L``, ``eye_blink_left``,
    ``blendShapes.EyeBlinkLeft``; comma, semicolon or tab; time as ``HH:MM:SS:FF.mmm``, ``HH:MM:SS.mmm``, seconds or
    frame numbers (see `facewright.io.timecode`). Rows with ``BlendShapeCount`` 0 end early and are untracked. Values
    beyond [0, 1] are clipped, columns of other names are left out, absent shapes are zero; `FaceCurves.notes` says so.

    Parameters
    ----------
    path : str or Path
        The file, UTF-8 or UTF-16 with its mark.
    frames_per_second : float, optional
        Rate of the time code's frames, or of rows without a time; found from the file, or 60 (time code) and 30 (rows),
        where absent.

    Raises
    ------
    StoreError
        If the file cannot be read.
    FileFormatError
        If it is not such a table: no header, no known shape, a value that is no number, a short row of a tracked face,
        time that runs backwards; the message names the line.
    """
    path = Path(path)
    rows = _rows(_text(path), path)
    notes: list[str] = []
    header = [_plain(name) for name in rows[0][1]]
    columns = _columns(header, rows[0][1], path, notes)
    count = header.index(_COUNT) if _COUNT in header else None
    body = _without_cut_row(rows[1:], len(header), count, path, notes)
    if not body:
        raise FileFormatError(f"{path} must hold at least one row of curves below its header, got none.")
    tracked = np.array([_is_tracked(row, count) for _, row in body])
    values = np.zeros((len(body), len(CURVE_COLUMNS)))
    known = tuple(columns)
    targets = [columns[k] for k in known]
    for at, ((line, row), seen) in enumerate(zip(body, tracked)):
        if seen:
            values[at, targets] = _numbers(row, known, len(header), rows[0][1], line, path)
    times, kept = read_times(
        _time_column(header), [(line, row) for line, row in body], path, notes, frames_per_second=frames_per_second
    )
    values, tracked = values[kept], tracked[kept]
    _clip(values, notes)
    if not tracked.all():
        lost = int((~tracked).sum())
        notes.append(f"{lost} of {len(tracked)} rows {'is' if lost == 1 else 'are'} untracked.")
    return FaceCurves(times, values, tracked, tuple(notes))


def write_live_link(path: str | Path, curves: FaceCurves) -> None:
    """Write curves as a Live Link Face recording, whole.

    63 columns: time code (frames on a base of 60, three decimals), count 61 (0 for an untracked row, which ends there),
    52 shapes, nine angles.

    Raises
    ------
    StoreError
        If the file cannot be written.
    """
    lines = [",".join(("Timecode", "BlendShapeCount", *CURVE_COLUMNS))]
    for time, values, seen in zip(curves.times, curves.values, curves.tracked):
        start = f"{timecode(float(time))},{len(CURVE_COLUMNS) if seen else 0}"
        # -0.0 would be written with its sign.
        lines.append(start + ("," + ",".join(f"{value:.10f}" for value in values + 0.0) if seen else ""))
    with write_atomically(path) as temporary:
        temporary.write_text("\n".join(lines) + "\n", encoding="utf-8")


def _text(path: Path) -> str:
    try:
        if path.is_file() and path.stat().st_size > MAX_BYTES:
            raise FileFormatError(f"{path} must have at most {MAX_BYTES >> 20} MB, got {path.stat().st_size >> 20} MB.")
        data = path.read_bytes()
    except FileFormatError:
        raise
    except OSError as error:
        raise StoreError(f"{path} must be a readable file, got: {error.strerror or error}.") from error
    encoding = "utf-16" if data[:2] in (b"\xff\xfe", b"\xfe\xff") else "utf-8-sig"
    try:
        text = data.decode(encoding)
    except UnicodeDecodeError as error:
        raise FileFormatError(f"{path} must be a CSV file of face curves in UTF-8, got other bytes.") from error
    if "\0" in text:
        raise FileFormatError(f"{path} must be a CSV file of face curves in UTF-8, got other bytes.")
    return text


def _rows(text: str, path: Path) -> list[tuple[int, list[str]]]:
    """Split into rows with their line numbers; empty lines are left out."""
    first = text.lstrip().partition("\n")[0]
    delimiter = max(",;\t", key=first.count)
    try:
        reader = csv.reader(io.StringIO(text, newline=""), delimiter=delimiter)
        rows = [
            (reader.line_num, [cell.strip() for cell in row]) for row in reader if any(cell.strip() for cell in row)
        ]
    except csv.Error as error:
        raise FileFormatError(f"{path} must be a CSV file of face curves, got: {error}.") from error
    if not rows:
        raise FileFormatError(f"{path} must be a CSV file of face curves, got an empty one.")
    return rows


def _plain(name: str) -> str:
    """Reduce a column's name to what all spellings of it share."""
    name = name.strip().strip("\"'")
    name = re.sub(r"^blend_?shapes?[.:/]", "", name, flags=re.IGNORECASE)
    name = re.sub(r"[_. ](L|R)$", lambda side: "Left" if side[1] == "L" else "Right", name)
    plain = re.sub(r"[^a-z0-9]", "", name.lower())
    return _OTHER_SPELLINGS.get(plain, plain)


def _columns(header: list[str], names: list[str], path: Path, notes: list[str]) -> dict[int, int]:
    """Map the file's columns to ours; say which are foreign and which are missing."""
    columns: dict[int, int] = {}
    foreign = []
    for k, name in enumerate(header):
        if name in _KNOWN:
            if _KNOWN[name] in columns.values():
                raise FileFormatError(f"{path} must name every shape once, got {names[k]!r} twice.")
            columns[k] = _KNOWN[name]
        elif name and name != _COUNT and k != _time_column(header):
            foreign.append(names[k])
    found = {k for k in columns.values() if k < len(SHAPE_COLUMNS)}
    if not found:
        raise FileFormatError(
            f"{path} must have a header that names ARKit's shapes (EyeBlinkLeft, JawOpen, ...), "
            f"got {', '.join(names[:4])}{', ...' if len(names) > 4 else ''}."
        )
    missing = [name for k, name in enumerate(SHAPE_COLUMNS) if k not in found]
    if foreign:
        several = f"{len(foreign)} columns of unknown names are left out, such as {foreign[0]!r}."
        notes.append(several if len(foreign) > 1 else f"The column {foreign[0]!r} is unknown and left out.")
    if missing:
        several = f"{len(missing)} of the 52 shapes are absent and stay zero, such as {missing[0]}."
        notes.append(several if len(missing) > 1 else f"The shape {missing[0]} is absent and stays zero.")
    return columns


def _time_column(header: list[str]) -> int | None:
    """Return the index of the column that says when, or None."""
    for name in ("timecode", "time", "timestamp", "seconds", "timesec", "times", "frame", "framenumber", "frameindex"):
        if name in header:
            return header.index(name)
    return None


def _is_tracked(row: list[str], count: int | None) -> bool:
    if count is None:
        return True
    try:
        return float(row[count]) > 0
    except (IndexError, ValueError):
        return False


def _without_cut_row(
    rows: list[tuple[int, list[str]]], width: int, count: int | None, path: Path, notes: list[str]
) -> list[tuple[int, list[str]]]:
    """Leave out the last row where the file was cut in the middle of it."""
    if rows and len(rows[-1][1]) < width and (count is None or _is_tracked(rows[-1][1], count)):
        notes.append(f"the last row (line {rows[-1][0]}) is cut short and left out.")
        return rows[:-1]
    return rows


def _numbers(
    row: list[str], known: tuple[int, ...], width: int, names: list[str], line: int, path: Path
) -> list[float]:
    if len(row) < width:
        raise FileFormatError(
            f"{path} must have {width} values in every row of a tracked face, got {len(row)} in line {line}."
        )
    numbers = []
    for k in known:
        try:
            number = float(row[k])
        except ValueError:
            number = math.nan
        if not math.isfinite(number):
            raise FileFormatError(f"{path} must hold numbers, got {row[k]!r} for {names[k]} in line {line}.")
        numbers.append(number)
    return numbers


def _clip(values: NDArray[np.float64], notes: list[str]) -> None:
    """Bring shapes into [0, 1], in place; say how many were outside."""
    shapes = values[:, : len(SHAPE_COLUMNS)]
    outside = (shapes < 0) | (shapes > 1)
    if outside.any():
        worst = SHAPE_COLUMNS[int(np.flatnonzero(outside.any(axis=0))[0])]
        n = int(outside.sum())
        notes.append(
            f"{n} value{'s' if n > 1 else ''} outside [0, 1] clipped (range found: {shapes.min():.4g} to "
            f"{shapes.max():.4g}), such as {worst}."
        )
        np.clip(shapes, 0.0, 1.0, out=shapes)
