"""Landmark files: iBUG ``.pts``, Menpo ``.ljson``, tables in ``.csv`` and the project's own JSON."""

from __future__ import annotations

import json
import re
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from facewright.errors import FileFormatError, ShapeError, StoreError, ValueRangeError
from facewright.io.atomic import write_atomically
from facewright.numeric.check import check_shape

_FORMAT, _VERSION = "facewright landmarks", 1
_MAX_BYTES = 16 * 1024 * 1024
_MAX_POINTS = 100_000


@dataclass(frozen=True, eq=False)
class PointsFile:
    """What a landmark file holds.

    Parameters
    ----------
    points : ndarray of shape (L, 2) or (L, 3), float64
        Pixels (x right, y down, the centre of the first pixel is (0, 0)); three columns where the file has them, in the
        file's own axes. NaN where the file marks a point as missing.
    confidence : ndarray of shape (L,), float64
        In [0, 1]; 0 where the file marks a point as missing, 1 where it says nothing.
    scheme : str or None
        The scheme that the file names.
    """

    points: NDArray[np.float64]
    confidence: NDArray[np.float64]
    scheme: str | None = None


def read_points(path: str | Path) -> PointsFile:
    """Read a landmark file; the kind is that of the suffix: ``.pts``, ``.ljson``, ``.json`` or ``.csv``.

    Parameters
    ----------
    path : str or Path
        The file. ``.pts``: one-based pixels, turned into the project's zero-based ones. ``.ljson``: y before x,
        turned round; ``null`` marks a missing point; 68 labelled points are brought into iBUG's order. ``.json``: the
        project's own, as `write_points` writes it.
        ``.csv``: a row for each point, x before y (before z), after an optional name; a first row of titles is skipped.

    Returns
    -------
    PointsFile
        Points, confidence, scheme.

    Raises
    ------
    StoreError
        If the file does not exist or cannot be read.
    FileFormatError
        If it is empty, of another or a newer format, has another number of points than it states, or holds a
        coordinate that is not a finite number.

    Notes
    -----
    NaN is refused also in ``.pts``: a missing point is said explicitly, with ``null``, in one of the JSON formats.
    """
    file = Path(path)
    readers = {".pts": _parse_pts, ".ljson": _parse_ljson, ".json": _parse_own, ".csv": _parse_csv}
    if file.suffix.lower() not in readers:
        raise FileFormatError(f"{file} must be a landmark file ending in .pts, .ljson, .json or .csv.")
    text = _read_text(file)
    if not text.strip():
        raise FileFormatError(f"{file} must hold landmarks, got an empty file.")
    return readers[file.suffix.lower()](text, file)


def write_points(
    path: str | Path,
    points: NDArray[np.floating[Any]],
    scheme: str | None = None,
    confidence: NDArray[np.floating[Any]] | None = None,
) -> None:
    """Write landmarks as ``.pts`` (one-based) or as the project's own ``.json``.

    Parameters
    ----------
    path : str or Path
        The file.
    points : ndarray of shape (L, 2), pixels, or (L, 3)
        The centre of the first pixel is (0, 0). A point with confidence 0 is missing; ``.pts`` cannot say that, nor
        hold points of three coordinates.
    scheme : str, optional
        Scheme name, kept by ``.json`` only.
    confidence : ndarray of shape (L,), optional
        In [0, 1], kept by ``.json`` only; all 1 where absent.

    Raises
    ------
    ShapeError, ValueRangeError
        If the arrays do not match, a point that is not missing is not finite, a point is missing in ``.pts``, or the
        suffix is another.
    StoreError
        If the file cannot be written.
    """
    file = Path(path)
    suffix = file.suffix.lower()
    sizes = check_shape("points", points, "L", 3 if suffix == ".json" and np.shape(points)[-1:] == (3,) else 2)
    weights = np.ones(sizes["L"]) if confidence is None else np.asarray(confidence, dtype=np.float64)
    check_shape("confidence", weights, "L", **sizes)
    missing = weights == 0
    if not np.isfinite(np.asarray(points)[~missing]).all():
        raise ValueRangeError("points must be finite or have confidence 0.")
    if suffix == ".pts":
        if missing.any():
            raise ValueRangeError(f"a .pts file cannot mark points as missing, got {int(missing.sum())}: use .json.")
        rows = "\n".join(f"{x + 1:.6f} {y + 1:.6f}" for x, y in np.asarray(points, dtype=np.float64).tolist())
        text = f"version: 1\nn_points: {sizes['L']}\n{{\n{rows}\n}}\n"
    elif suffix == ".json":
        digits = 6 if points.shape[1] == 2 else 9
        rounded = [None if gone else [round(x, digits) for x in row] for gone, row in zip(missing, points.tolist())]
        text = json.dumps(
            {
                "format": _FORMAT,
                "version": _VERSION,
                "scheme": scheme,
                "points": rounded,
                "confidence": np.round(weights, 6).tolist(),
            },
            allow_nan=False,
        )
    else:
        raise ValueRangeError(f"landmark file must end in .pts or .json, got {file.name!r}.")
    with write_atomically(file) as temporary:
        temporary.write_text(text, encoding="utf-8")


def _read_text(file: Path) -> str:
    try:
        if file.stat().st_size > _MAX_BYTES:
            raise FileFormatError(f"{file} must be a landmark file, got {file.stat().st_size} bytes.")
        return file.read_text(encoding="utf-8")
    except FileNotFoundError as error:
        raise StoreError(f"{file} does not exist.") from error
    except UnicodeDecodeError as error:
        raise FileFormatError(f"{file} must be a text file of landmarks, got other bytes.") from error
    except OSError as error:
        if isinstance(error, StoreError):
            raise
        raise StoreError(f"{file} cannot be read: {error.strerror or error}.") from error


def _parse_pts(text: str, file: Path) -> PointsFile:
    opening, closing = text.find("{"), text.rfind("}")
    if opening < 0 or closing < opening:
        raise FileFormatError(f"{file} must hold points between braces, as iBUG's .pts files do; it is truncated.")
    stated = None
    for line in text[:opening].splitlines():
        key, _, value = line.partition(":")
        if key.strip() == "n_points":
            stated = value.strip()
        elif key.strip() == "version" and value.strip() not in ("1", "1.0"):
            raise FileFormatError(f"{file} must be a .pts file of version 1, got version {value.strip()}.")
    rows = [line.split() for line in text[opening + 1 : closing].splitlines() if line.strip()]
    if stated is not None and stated != str(len(rows)):
        raise FileFormatError(f"{file} states {stated} points, got {len(rows)}.")
    try:
        values = np.array([[float(number) for number in row] for row in rows], dtype=np.float64)
    except ValueError as error:
        raise FileFormatError(f"{file} must hold two numbers in each row of points.") from error
    if values.ndim != 2 or values.shape[1] != 2:
        raise FileFormatError(f"{file} must hold two numbers in each row of points.")
    return _checked(values - 1.0, np.ones(len(values)), None, file)


def _parse_ljson(text: str, file: Path) -> PointsFile:
    data = _json(text, file)
    if not isinstance(data, dict) or data.get("version") not in (1, 2, 3):
        found = data.get("version") if isinstance(data, dict) else type(data).__name__
        raise FileFormatError(f"{file} must be a Menpo .ljson file of version 1, 2 or 3, got {found!r}.")
    groups = data.get("groups")
    if data["version"] == 3 and isinstance(groups, dict):
        if len(groups) != 1:
            raise FileFormatError(f"{file} must hold one group of landmarks, got {len(groups)}.")
        data = next(iter(groups.values()))
    if isinstance(data, dict) and isinstance(data.get("groups"), list):  # version 1: points inside labelled groups
        listed: Any = [point.get("point") for group in data["groups"] for point in group.get("landmarks", [])]
    else:
        landmarks = data.get("landmarks") if isinstance(data, dict) else None
        listed = landmarks.get("points") if isinstance(landmarks, dict) else None
        listed = _in_ibug_order(listed, data.get("labels"))
    points, present = _rows(listed, file)
    if points.shape[1] == 2:
        points = points[:, ::-1]  # y before x
    return _checked(points, present.astype(np.float64), None, file)


#: Names that Menpo's files give the groups of 68 points, in iBUG's order of the groups, and their sizes. Left and right
#: are the picture's.
_LABELS = (
    (("jaw", "chin"), 17),
    (("lefteyebrow", "leyebrow"), 5),
    (("righteyebrow", "reyebrow"), 5),
    (("nose",), 9),
    (("lefteye", "leye"), 6),
    (("righteye", "reye"), 6),
    (("mouth",), 20),
)


def _in_ibug_order(listed: Any, labels: Any) -> Any:
    """Bring 68 labelled points into iBUG's order: files of 3D scans list the eyes before the brows."""
    if not isinstance(listed, list) or len(listed) != 68 or not isinstance(labels, list):
        return listed
    masks = {}
    for label in labels:
        if isinstance(label, dict) and isinstance(label.get("mask"), list):
            masks[re.sub(r"[^a-z]", "", str(label.get("label", "")).lower())] = label["mask"]
    order: list[Any] = []
    for names, size in _LABELS:
        mask: list[Any] = next((masks[name] for name in names if name in masks), [])
        if len(mask) != size:
            return listed
        order += mask
    if any(not isinstance(k, int) for k in order) or sorted(order) != list(range(68)):
        return listed
    return [listed[k] for k in order]


def _parse_own(text: str, file: Path) -> PointsFile:
    data = _json(text, file)
    if not isinstance(data, dict) or data.get("format") != _FORMAT:
        raise FileFormatError(f"{file} must say format {_FORMAT!r}, got another JSON file.")
    version = data.get("version")
    if version != _VERSION:
        raise FileFormatError(f"{file} must be of version {_VERSION}, got {version!r}; it may be of a newer release.")
    scheme = data.get("scheme")
    if scheme is not None and not isinstance(scheme, str):
        raise FileFormatError(f"{file} must name its scheme by a string, got {scheme!r}.")
    points, present = _rows(data.get("points"), file)
    stated = data.get("confidence")
    try:
        confidence = np.ones(len(points)) if stated is None else np.array(stated, dtype=np.float64)
        check_shape("confidence", confidence, len(points))
    except (ShapeError, TypeError, ValueError) as error:
        raise FileFormatError(f"{file} must hold one confidence per point, {len(points)} in all.") from error
    if not ((confidence >= 0) & (confidence <= 1)).all():
        raise FileFormatError(f"{file} must hold confidences in [0, 1].")
    confidence[~present] = 0.0
    return _checked(points, confidence, scheme, file)


def _parse_csv(text: str, file: Path) -> PointsFile:
    lines = [line for line in text.splitlines() if line.strip() and not line.lstrip().startswith("#")]
    rows = [[field for field in re.split(r"[;,\s]+", line.strip()) if field] for line in lines]
    if rows and not any(_is_number(field) for field in rows[0]):
        rows = rows[1:]  # titles
    named = [row[1:] if row and not _is_number(row[0]) else row for row in rows]
    try:
        points = np.array([[float(field) for field in row] for row in named], dtype=np.float64)
    except ValueError as error:
        raise FileFormatError(f"{file} must hold two or three numbers in each row, after an optional name.") from error
    if points.ndim != 2 or points.shape[1] not in (2, 3):
        raise FileFormatError(f"{file} must hold two or three numbers in each row, after an optional name.")
    return _checked(points, np.ones(len(points)), None, file)


def _is_number(field: str) -> bool:
    try:
        float(field)
    except ValueError:
        return False
    return True


def _json(text: str, file: Path) -> Any:
    try:
        return json.loads(text)
    except (json.JSONDecodeError, RecursionError) as error:
        raise FileFormatError(f"{file} must be JSON; it is truncated or corrupt.") from error


def _rows(listed: Any, file: Path) -> tuple[NDArray[np.float64], NDArray[np.bool_]]:
    """Return points (L, 2 or 3) of a JSON list and which are present; null, or a row of nulls, is missing."""
    if not isinstance(listed, list) or not listed or len(listed) > _MAX_POINTS:
        raise FileFormatError(f"{file} must hold a list of points, got none.")
    gone = [row is None or (isinstance(row, list) and len(row) > 0 and all(v is None for v in row)) for row in listed]
    width = next((len(row) for row, absent in zip(listed, gone) if not absent and isinstance(row, list)), 2)
    if width not in (2, 3):
        raise FileFormatError(f"{file} must hold points of 2 or 3 coordinates, got {width}.")
    try:
        rows = [[np.nan] * width if absent else [float(v) for v in row] for row, absent in zip(listed, gone)]
        points = np.array(rows, dtype=np.float64)
        check_shape("points", points, len(listed), width)
    except (ShapeError, TypeError, ValueError) as error:
        raise FileFormatError(f"{file} must hold points of {width} numbers each.") from error
    return points, ~np.array(gone, dtype=bool)


def _checked(
    points: NDArray[np.float64], confidence: NDArray[np.float64], scheme: str | None, file: Path
) -> PointsFile:
    bad = ~np.isfinite(points).all(axis=1) & (confidence > 0)
    if bad.any():
        raise FileFormatError(
            f"{file} must hold finite coordinates, got {int(bad.sum())} points that are not (first: point "
            f"{int(np.flatnonzero(bad)[0])}); mark missing points by null in a .json file."
        )
    points[confidence == 0] = np.nan
    return PointsFile(np.ascontiguousarray(points), confidence, scheme)
