"""TRC files (Motion Analysis, OpenSim): a table of labelled points with a header of five lines."""

from __future__ import annotations

import os

import numpy as np

from facewright.errors import FileFormatError
from facewright.io.atomic import write_atomically
from facewright.io.c3d import MarkerTable
from facewright.io.marker_data import MarkerData
from facewright.io.marker_text import numbers, read_lines


def read_trc(path: str | os.PathLike[str]) -> MarkerTable:
    """Read a TRC file's points.

    Raises
    ------
    StoreError
        If the file is missing or unreadable.
    FileFormatError
        If it is no TRC file or a row does not fit its header.
    """
    lines = read_lines(path)
    if len(lines) < 6 or not lines[0].lstrip("\ufeff").startswith("PathFileType"):
        raise FileFormatError(f"{path} must be a TRC file that begins with PathFileType, got something else.")
    keys, values = lines[1].split("\t"), lines[2].split("\t")
    header = {key.strip(): value.strip() for key, value in zip(keys, values)}
    names = [cell.strip() for cell in lines[3].rstrip("\t\n ").split("\t")]
    labels = tuple(name for name in names[2:] if name)
    n = 3 * len(labels)
    if not labels:
        raise FileFormatError(f"{path} must name its markers in the fourth line, got none.")
    rows = [line for line in lines[5:] if line.strip()]
    table = numbers(path, [row.rstrip("\n").split("\t") for row in rows], 2 + n, first_line=6)
    times = table[:, 1]
    if np.isnan(times).any() or (np.diff(times) <= 0).any():
        try:
            times = np.arange(len(table)) / float(header["DataRate"])
        except (KeyError, ValueError, ZeroDivisionError) as error:
            raise FileFormatError(f"{path} must have times or a DataRate, got neither.") from error
    return MarkerTable(times, labels, table[:, 2:].reshape(len(table), -1, 3), header.get("Units"), None)


def write_trc(path: str | os.PathLike[str], markers: MarkerData) -> None:
    """Write markers as TRC: millimetres, y up; unseen ones are empty cells.

    Raises
    ------
    StoreError
        If the file cannot be written.
    """
    T, M = markers.positions.shape[:2]
    rate = (T - 1) / float(markers.times[-1] - markers.times[0]) if T > 1 else 120.0
    count = ["DataRate", "CameraRate", "NumFrames", "NumMarkers", "Units"]
    count += ["OrigDataRate", "OrigDataStartFrame", "OrigNumFrames"]
    with write_atomically(path) as temporary, temporary.open("w", encoding="utf-8", newline="\n") as file:
        file.write(f"PathFileType\t4\t(X/Y/Z)\t{os.path.basename(os.fspath(path))}\n")  # noqa: PTH119
        file.write("\t".join(count) + "\n")
        file.write(f"{rate:.6g}\t{rate:.6g}\t{T}\t{M}\tmm\t{rate:.6g}\t1\t{T}\n")
        file.write("Frame#\tTime\t" + "\t\t\t".join(markers.labels) + "\t\t\n")
        file.write("\t\t" + "\t".join(f"{axis}{k + 1}" for k in range(M) for axis in "XYZ") + "\n\n")
        for k, (time, row) in enumerate(zip(markers.times, markers.positions.reshape(T, -1).tolist())):
            cells = "\t".join("" if value != value else f"{value:.5f}" for value in row)
            file.write(f"{k + 1}\t{time:.6f}\t{cells}\n")
