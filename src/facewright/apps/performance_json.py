"""Performances as JSON: all of what was tracked, exactly, out and in."""

from __future__ import annotations

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from facewright.camera.rotation import head_angles_from_rotation
from facewright.errors import FacewrightError, FileFormatError, StoreError
from facewright.faces.blendshape_names import BLENDSHAPE_NAMES
from facewright.io.atomic import write_atomically
from facewright.models.performance import Performance
from facewright.numeric.rotation import nearest_rotation

FORMAT, VERSION = "facewright performance", 1
MAX_BYTES = 1 << 30
#: Matrices farther than the first from a rotation are none; those nearer than the second are taken as they are.
_ROTATION_ERROR = 1e-3
_ROUNDING = 1e-6


def write_performance_json(
    path: str | Path,
    performance: Performance,
    cuts: NDArray[np.bool_] | None = None,
    extras: Mapping[str, Any] | None = None,
) -> None:
    """Write a performance as JSON, whole.

    Parameters
    ----------
    path : str or Path
        The file.
    performance : Performance
        Written with 6 decimals of coefficients and gaze, 8 of rotations, 4 of millimetres; times exactly.
    cuts : ndarray of shape (T,), bool, optional
        Frames that begin another shot.
    extras : mapping, optional
        Further JSON values; readers leave them alone.

    Raises
    ------
    StoreError
        If the file cannot be written.
    """
    content = {
        "format": FORMAT,
        "version": VERSION,
        "units": {"times": "s", "translations": "mm", "gaze": "rad", "head_angles": "degrees yaw, pitch, roll"},
        "names": list(performance.names),
        "times": performance.times.tolist(),
        "weights": np.round(performance.weights, 6).tolist(),
        "rotations": np.round(performance.rotations, 8).tolist(),
        "head_angles": [np.round(head_angles_from_rotation(R), 4).tolist() for R in performance.rotations],
        "translations": np.round(performance.translations, 4).tolist(),
        "gaze": np.round(performance.gaze, 6).tolist(),
        "tracked": performance.tracked.tolist(),
        "cuts": [] if cuts is None else np.flatnonzero(cuts).tolist(),
        **(extras or {}),
    }
    with write_atomically(path) as temporary:
        temporary.write_text(json.dumps(content, allow_nan=False) + "\n", encoding="utf-8")


def read_performance_json(path: str | Path) -> tuple[Performance, NDArray[np.bool_], tuple[str, ...]]:
    """Read a performance from JSON; the inverse of `write_performance_json`.

    Translations, gaze, ``tracked`` and ``cuts`` may be absent: zero, straight ahead, every frame, none. Shapes that are
    not among the 46 are left out, and coefficients beyond [0, 1] clipped, which is said.

    Returns
    -------
    performance : Performance
        As written, to within the written decimals.
    cuts : ndarray of shape (T,), bool
        Frames that begin another shot.
    notes : tuple of str
        What was made of oddities: one sentence each.

    Raises
    ------
    StoreError
        If the file cannot be read.
    FileFormatError
        If it is no such file, or contradicts itself; the message says where.
    """
    path = Path(path)
    content = _content(path)
    try:
        return _performance(path, content)
    except FileFormatError:
        raise
    except FacewrightError as error:
        raise FileFormatError(f"{path} must hold a performance, got one in which {error}") from error


def _content(path: Path) -> dict[str, Any]:
    try:
        if path.is_file() and path.stat().st_size > MAX_BYTES:
            raise FileFormatError(f"{path} must have at most {MAX_BYTES >> 20} MB, got {path.stat().st_size >> 20} MB.")
        content = json.loads(path.read_text(encoding="utf-8-sig"))
    except OSError as error:
        raise StoreError(f"{path} must be a readable file, got: {error.strerror or error}.") from error
    except (ValueError, RecursionError) as error:
        raise FileFormatError(f"{path} must be a JSON file in UTF-8, got: {error}.") from error
    if not isinstance(content, dict) or content.get("format") != FORMAT:
        named = isinstance(content, dict) and "format" in content
        got = f"the format {content['format']!r}" if named else "other JSON"
        raise FileFormatError(
            f"{path} must be curves of `facewright track -o curves.json` (format {FORMAT!r}), got {got}; recordings of "
            "other programs are read as CSV."
        )
    if content.get("version") != VERSION:
        raise FileFormatError(
            f"{path} must be of version {VERSION} of {FORMAT!r}, got {content.get('version')!r}: it was written by "
            "another facewright."
        )
    return content


def _performance(path: Path, content: dict[str, Any]) -> tuple[Performance, NDArray[np.bool_], tuple[str, ...]]:
    times = _numbers(path, content, "times", (None,))
    T = len(times)
    if T == 0:
        raise FileFormatError(f"{path} must hold at least one frame, got none.")
    names = content.get("names")
    if not isinstance(names, list) or not all(isinstance(name, str) for name in names) or len(set(names)) < len(names):
        raise FileFormatError(f"{path} must name every shape once, as a list of texts under 'names'.")
    weights = _numbers(path, content, "weights", (T, len(names)))
    notes: list[str] = []
    known = [k for k, name in enumerate(names) if name in BLENDSHAPE_NAMES]
    if not known:
        raise FileFormatError(
            f"{path} must name shapes of facewright's ({', '.join(BLENDSHAPE_NAMES[:2])}, ...), got none."
        )
    foreign = [name for name in names if name not in BLENDSHAPE_NAMES]
    if foreign:
        several = f"{len(foreign)} shapes of unknown names are left out, such as {foreign[0]!r}."
        notes.append(several if len(foreign) > 1 else f"The shape {foreign[0]!r} is unknown and left out.")
    weights = weights[:, known]
    n = int(((weights < 0) | (weights > 1)).sum())
    if n:
        found = f"(range found: {weights.min():.4g} to {weights.max():.4g})"
        notes.append(f"{n} value{'s' if n > 1 else ''} outside [0, 1] clipped {found}.")
    rotations = _rotations(path, _numbers(path, content, "rotations", (T, 3, 3)))
    performance = Performance(
        times=times,
        names=tuple(names[k] for k in known),
        weights=np.clip(weights, 0.0, 1.0),
        rotations=rotations,
        translations=_numbers(path, content, "translations", (T, 3), absent=True),
        gaze=_numbers(path, content, "gaze", (T, 2, 2), absent=True),
        tracked=_flags(path, content, T),
    )
    if not performance.tracked.all():
        lost = int((~performance.tracked).sum())
        notes.append(f"{lost} of {T} frames {'is' if lost == 1 else 'are'} untracked.")
    return performance, _cuts(path, content, T), tuple(notes)


def _numbers(
    path: Path, content: dict[str, Any], key: str, shape: tuple[int | None, ...], *, absent: bool = False
) -> NDArray[np.float64]:
    """Return finite numbers of a shape (None: any length); zero where they may be absent and are."""
    if absent and key not in content:
        return np.zeros([size or 0 for size in shape])
    try:
        values = np.array(content.get(key, []), dtype=np.float64)
    except (TypeError, ValueError):
        values = np.full(1, np.nan)
    if shape[-1] == 0 and values.size == 0:
        values = values.reshape([size or 0 for size in shape])
    fits = values.ndim == len(shape) and all(b is None or a == b for a, b in zip(values.shape, shape, strict=True))
    if key not in content or not fits or not np.isfinite(values).all():
        wanted = " x ".join("T" if size is None else str(size) for size in shape)
        raise FileFormatError(f"{path} must hold {wanted} finite numbers as {key!r}, got others.")
    return values


def _rotations(path: Path, given: NDArray[np.float64]) -> NDArray[np.float64]:
    error = np.abs(given @ np.swapaxes(given, 1, 2) - np.eye(3)).max(axis=(1, 2))
    bad = (error > _ROTATION_ERROR) | (np.linalg.det(given) < 0)
    if bad.any():
        raise FileFormatError(
            f"{path} must hold rotation matrices, got another in frame {int(np.flatnonzero(bad)[0])}."
        )
    return given if error.max() < _ROUNDING else nearest_rotation(given)


def _flags(path: Path, content: dict[str, Any], T: int) -> NDArray[np.bool_]:
    given = content.get("tracked", [True] * T)
    if not isinstance(given, list) or len(given) != T or not all(isinstance(flag, bool) for flag in given):
        raise FileFormatError(f"{path} must hold {T} times true or false as 'tracked', got others.")
    return np.array(given)


def _cuts(path: Path, content: dict[str, Any], T: int) -> NDArray[np.bool_]:
    given = content.get("cuts", [])
    if not isinstance(given, list) or not all(type(k) is int and 0 <= k < T for k in given):
        raise FileFormatError(f"{path} must hold numbers of its {T} frames as 'cuts', got others.")
    cuts = np.zeros(T, bool)
    cuts[given] = True
    return cuts
