"""C3D files of optical motion capture, through ezc3d: labelled points, rate, unit and screen axes."""

from __future__ import annotations

import os
import struct
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from facewright.errors import FileFormatError, MissingExtraError, StoreError
from facewright.io.atomic import write_atomically
from facewright.io.marker_data import MarkerData

_INTEL, _DEC, _MIPS = 84, 85, 86
_BLOCK = 512


class MarkerTable(NamedTuple):
    """What a marker file says, in its own unit and axes.

    Parameters
    ----------
    times : ndarray of shape (T,), seconds
    labels : tuple of str
        As the file has them; they may repeat.
    positions : ndarray of shape (T, M, 3)
        NaN where unseen.
    unit : str or None
        As written in the file.
    up : str or None
        Axis that points up, where the file says so.
    """

    times: NDArray[np.float64]
    labels: tuple[str, ...]
    positions: NDArray[np.float64]
    unit: str | None
    up: str | None


def read_c3d(path: str | os.PathLike[str]) -> MarkerTable:
    """Read a C3D file's points.

    Sizes are compared with the file before its reader, which would crash on a truncated one, is let at it.

    Raises
    ------
    MissingExtraError
        Without the extra ``mocap``.
    StoreError
        If the file is missing or unreadable.
    FileFormatError
        If it is truncated or no C3D file, or holds no points.
    """
    path = Path(path)
    _check_sizes(path)
    try:
        content = _ezc3d().c3d(str(path))
    except MissingExtraError:
        raise
    except Exception as error:
        raise FileFormatError(f"{path} must be a C3D file, got one that cannot be read: {error}.") from error
    values = np.asarray(content["data"]["points"], dtype=np.float64)
    point = content["parameters"]["POINT"]
    if values.ndim != 3 or not values.shape[1] or not values.shape[2]:
        raise FileFormatError(f"{path} must hold points over time, got {values.shape[1:]} points and frames.")
    positions = values[:3].transpose(2, 1, 0).copy()
    residuals = np.asarray(content["data"]["meta_points"]["residuals"], dtype=np.float64)
    unseen = (residuals.reshape(-1, positions.shape[1], positions.shape[0])[0].T < 0) | ~np.isfinite(positions).all(2)
    positions[unseen | (positions == 0).all(axis=2)] = np.nan
    labels = _strings(point, "LABELS", positions.shape[1])
    rate = float(np.ravel(point["RATE"]["value"])[0]) if len(np.ravel(point["RATE"]["value"])) else 0.0
    if not rate > 0:
        raise FileFormatError(f"{path} must state its frame rate, got {rate}.")
    units = _texts(point, "UNITS")
    up = _texts(point, "Y_SCREEN")
    return MarkerTable(
        np.arange(len(positions)) / rate, labels, positions, units[0] if units else None, _axis(up[0]) if up else None
    )


def write_c3d(path: str | os.PathLike[str], markers: MarkerData) -> None:
    """Write markers as C3D: millimetres, y up, the frame rate that the times have on average.

    Raises
    ------
    MissingExtraError
        Without the extra ``mocap``.
    StoreError
        If the file cannot be written.
    """
    content = _ezc3d().c3d()
    T = len(markers.times)
    rate = (T - 1) / float(markers.times[-1] - markers.times[0]) if T > 1 else 120.0
    point = content["parameters"]["POINT"]
    point["RATE"]["value"] = [rate]
    point["UNITS"]["value"] = ["mm"]
    point["LABELS"]["value"] = list(markers.labels)
    content.add_parameter("POINT", "X_SCREEN", ["+X"])
    content.add_parameter("POINT", "Y_SCREEN", ["+Y"])
    values = np.ones((4, len(markers.labels), T))
    values[:3] = markers.positions.transpose(2, 1, 0)
    content["data"]["points"] = values
    residuals = np.where(markers.seen, 0.0, -1.0).T[None]
    content["data"]["meta_points"]["residuals"] = residuals
    with write_atomically(path) as temporary:
        content.write(str(temporary))


def _ezc3d() -> Any:
    try:
        import ezc3d
    except ImportError as error:
        raise MissingExtraError('C3D files need the extra "mocap": pip install "facewright[mocap]".') from error
    return ezc3d


def _check_sizes(path: Path) -> None:
    """Raise unless the file is as long as its header says."""
    try:
        with path.open("rb") as file:
            size = os.fstat(file.fileno()).st_size
            head = file.read(_BLOCK)
            start = (head[0] - 1) * _BLOCK if head else 0
            file.seek(max(start, 0))
            parameters = file.read(4)
    except OSError as error:
        raise StoreError(f"{path} cannot be read: {error.strerror or error}.") from error
    if len(head) < _BLOCK or head[1] != 0x50 or len(parameters) < 4 or parameters[3] not in (_INTEL, _DEC, _MIPS):
        raise FileFormatError(f"{path} must be a C3D file, got something else or {size} bytes of one.")
    order = ">" if parameters[3] == _MIPS else "<"
    n_points, n_analog, first, last = struct.unpack(order + "4H", head[2:10])
    data_block = struct.unpack(order + "H", head[16:18])[0]
    scale = struct.unpack(order + "f", head[12:16])[0]
    if parameters[3] == _DEC:  # only the sign is needed; a DEC float has it in the second byte
        scale = -1.0 if head[13] & 0x80 else 1.0
    word = 4 if scale < 0 else 2
    n_frames = last - first + 1
    expected = (data_block - 1) * _BLOCK + max(n_frames, 0) * (4 * n_points + n_analog) * word
    if data_block < 2 or start + parameters[2] * _BLOCK > size or size < expected:
        raise FileFormatError(f"{path} is truncated: its header says at least {expected} bytes, got {size}.")


def _texts(group: Any, name: str) -> list[str]:
    return [str(value).strip() for value in group[name]["value"]] if name in group else []


def _strings(group: Any, name: str, count: int) -> tuple[str, ...]:
    """Return `count` strings of a parameter that goes on as NAME2, NAME3 where it is long."""
    found = _texts(group, name)
    number = 2
    while f"{name}{number}" in group:
        found += _texts(group, f"{name}{number}")
        number += 1
    return tuple(found[:count] + [f"unlabelled {k + 1}" for k in range(len(found), count)])


def _axis(text: str) -> str | None:
    """Return "y" for "+Y", "-z" for "-Z"."""
    name = text.strip().lower().lstrip("+")
    return name if name.lstrip("-") in ("x", "y", "z") else None
