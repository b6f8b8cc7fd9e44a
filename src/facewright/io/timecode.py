"""When the rows of a curve table happened: time codes, seconds, frame numbers."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from facewright.errors import FileFormatError

LIVE_LINK_BASE = 60.0
ROWS_PER_SECOND = 30.0
_SECONDS_OF_DAY = 86_400.0
_FRAME_CODE = re.compile(r"^(\d{1,3}):(\d{1,2}):(\d{1,2})[:;](\d{1,3}(?:\.\d+)?)$")
_CLOCK_CODE = re.compile(r"^(\d{1,3}):(\d{1,2}):(\d{1,2}(?:\.\d+)?)$")


def timecode(seconds: float, base: float = LIVE_LINK_BASE) -> str:
    """Return ``HH:MM:SS:FF.mmm`` of a time, frames on a base of 60 with three decimals, as Live Link Face writes it.

    Examples
    --------
    >>> timecode(3661.5)
    '01:01:01:30.000'
    """
    thousandths = round(seconds * base * 1000)
    whole, rest = divmod(thousandths, round(base * 1000))
    minutes, second = divmod(whole, 60)
    hours, minute = divmod(minutes, 60)
    return f"{hours:02d}:{minute:02d}:{second:02d}:{rest // 1000:02d}.{rest % 1000:03d}"


def read_times(
    column: int | None,
    rows: list[tuple[int, list[str]]],
    path: Path,
    notes: list[str],
    *,
    frames_per_second: float | None = None,
) -> tuple[NDArray[np.float64], NDArray[np.intp]]:
    """Return the time of every row, the first at zero, and the rows that are kept.

    ``HH:MM:SS:FF.mmm`` counts frames on the base (24, 25, 30, 48, 50, 60, 120) that makes the steps even, 60 where the
    recording is too short to tell; ``HH:MM:SS.mmm`` and plain numbers are seconds; whole numbers that count up by one
    are frames. Midnight is passed. Rows of one time keep the first.

    Parameters
    ----------
    column : int or None
        Where the time stands; None for a table without one: 30 rows a second.
    rows : list of (int, list of str)
        Line number and cells.
    path : Path
        For messages.
    notes : list of str
        Sentences about fallbacks are added here.
    frames_per_second : float, optional
        Overrides the base and the rate of rows.

    Raises
    ------
    FileFormatError
        If a time cannot be read or runs backwards; the message names the line.
    """
    every = np.arange(len(rows))
    if column is None:
        rate = frames_per_second or ROWS_PER_SECOND
        notes.append(f"the table has no time: {rate:g} rows a second are assumed.")
        return every / rate, every
    cells = [(line, row[column] if column < len(row) else "") for line, row in rows]
    codes = [_FRAME_CODE.match(cell) for _, cell in cells]
    if codes[0]:
        seconds, frames = np.zeros(len(cells)), np.zeros(len(cells))
        for k, code in enumerate(codes):
            if code is None:
                raise _unreadable(path, *cells[k])
            hours, minutes, whole = (int(code[n]) for n in (1, 2, 3))
            seconds[k], frames[k] = 3600 * hours + 60 * minutes + whole, float(code[4])
        times = seconds + frames / (frames_per_second or _base(seconds, frames))
    else:
        times = np.array([_plain_time(path, line, cell) for line, cell in cells])
        if len(times) > 1 and (times == np.round(times)).all() and (np.diff(times) == 1).all():
            rate = frames_per_second or ROWS_PER_SECOND
            notes.append(f"times are frame numbers: {rate:g} frames a second are assumed.")
            times = times / rate
    steps = np.diff(times)
    times[1:] += np.cumsum(np.where(steps < -_SECONDS_OF_DAY / 2, _SECONDS_OF_DAY, 0.0))
    backwards = np.flatnonzero(np.diff(times) < 0)
    if len(backwards):
        line, cell = cells[int(backwards[0]) + 1]
        raise FileFormatError(
            f"{path} must have times that increase, got {cell!r} in line {line}, before the last one."
        )
    kept = np.concatenate([[0], 1 + np.flatnonzero(np.diff(times) > 0)]).astype(np.intp)
    if len(kept) < len(times):
        notes.append(f"{len(times) - len(kept)} rows repeat the time of the row before and are left out.")
    return times[kept] - times[0], kept


def _unreadable(path: Path, line: int, cell: str) -> FileFormatError:
    return FileFormatError(
        f"{path} must state times as HH:MM:SS:FF.mmm, HH:MM:SS.mmm or seconds, got {cell!r} in line {line}."
    )


def _plain_time(path: Path, line: int, cell: str) -> float:
    clock = _CLOCK_CODE.match(cell)
    if clock:
        return 3600.0 * int(clock[1]) + 60.0 * int(clock[2]) + float(clock[3])
    try:
        value = float(cell)
    except ValueError:
        value = np.nan
    if not np.isfinite(value):
        raise _unreadable(path, line, cell)
    return value


def _base(seconds: NDArray[np.float64], frames: NDArray[np.float64]) -> float:
    """Find how many frames a second the code counts: the base whose steps over full seconds are like the others."""
    if not (np.diff(seconds) != 0).any():
        return LIVE_LINK_BASE
    best, least = LIVE_LINK_BASE, np.inf
    for base in (60.0, 30.0, 25.0, 24.0, 50.0, 48.0, 120.0):
        if frames.max() >= base:
            continue
        steps = np.diff(seconds + frames / base)
        spread = float(np.mean(np.abs(steps - np.median(steps))) * base)
        # A clear win only: 60 is what the app writes, whatever its rate.
        if spread < 0.5 * least:
            best, least = base, max(spread, 1e-3)
    return best
