"""What a recording says about its camera in a JSON file of its own: intrinsics, depth unit, which way is up."""

from __future__ import annotations

import json
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from facewright.camera.pinhole import Intrinsics
from facewright.capture.quarter_turns import check_quarter_turns
from facewright.errors import FileFormatError, ValueRangeError
from facewright.io.atomic import write_atomically
from facewright.io.frame_image import read_bytes

_NAME = "camera.json"
# What Open3D's recorders and its playback tools write beside the folders color and depth.
_OPEN3D_NAMES = ("camera_intrinsic.json", "intrinsic.json")


@dataclass(frozen=True)
class CameraFile:
    """Contents of a camera file; None for what it does not say.

    Parameters
    ----------
    intrinsics : Intrinsics or None
        Camera of the depth pictures as stored.
    size : (height, width) or None
        Of the depth pictures as stored.
    depth_per_metre : float or None
        Numbers of the depth pictures per metre.
    quarter_turns : int or None
        Counter-clockwise quarter turns that make the heads upright.
    """

    intrinsics: Intrinsics | None = None
    size: tuple[int, int] | None = None
    depth_per_metre: float | None = None
    quarter_turns: int | None = None


def camera_path(recording: Path) -> Path:
    """Return where a recording's camera file belongs: inside a folder, beside a file (``smile.camera.json``)."""
    return recording / _NAME if recording.is_dir() else recording.with_name(f"{recording.stem}.{_NAME}")


def read_camera_file(recording: Path) -> CameraFile:
    """Read the camera file of a recording; everything is None where there is no file.

    Raises
    ------
    FileFormatError, StoreError
        If the file is damaged or cannot be read.
    """
    own = camera_path(recording)
    others = [recording / name for name in _OPEN3D_NAMES] if recording.is_dir() else []
    file = next((path for path in (own, *others) if path.is_file()), None)
    if file is None:
        return CameraFile()
    try:
        values = _load(file)
        intrinsics = _intrinsics(values)
        size = (int(values["height"]), int(values["width"])) if intrinsics is not None else None
        stated = values.get("depth_per_metre", values.get("depth_scale"))
        per_metre = None if stated is None else float(stated)
        if per_metre is not None and not 0 < per_metre < np.inf:
            raise ValueRangeError(f"depth_per_metre must be positive, got {per_metre}.")
        turns = values.get("quarter_turns")
        return CameraFile(intrinsics, size, per_metre, None if turns is None else check_quarter_turns(turns))
    except (ValueError, OverflowError, KeyError, TypeError, IndexError) as error:
        if isinstance(error, FileFormatError):
            raise
        found = f"no {error}" if isinstance(error, KeyError) else str(error)
        raise FileFormatError(
            f"{file} must be JSON with width, height, fx, fy, cx, cy (pixels) and depth_per_metre, got {found}."
        ) from error


def save_quarter_turns(recording: Path, turns: int) -> Path:
    """Note in a recording's camera file which way is up; what else it says stays. Returns the file.

    Raises
    ------
    FileFormatError, StoreError
        If the file that is there is damaged, or it cannot be written.
    """
    file = camera_path(recording)
    values = _load(file) if file.is_file() else {}
    values["quarter_turns"] = check_quarter_turns(turns)
    with write_atomically(file) as temporary:
        temporary.write_text(json.dumps(values, indent=2) + "\n", encoding="utf-8")
    return file


def _load(file: Path) -> dict[str, Any]:
    try:
        values = json.loads(read_bytes(file))
    except (ValueError, RecursionError) as error:
        raise FileFormatError(f"{file} must be JSON, got {error}.") from error
    if not isinstance(values, dict):
        raise FileFormatError(f"{file} must be one JSON object, got a {type(values).__name__}.")
    return values


def _intrinsics(values: dict[str, Any]) -> Intrinsics | None:
    if "intrinsic_matrix" in values:  # Open3D writes the columns one after the other
        m = values["intrinsic_matrix"]
        return Intrinsics(float(m[0]), float(m[4]), float(m[6]), float(m[7]))
    keys = ("fx", "fy", "cx", "cy")
    if not any(key in values for key in keys):
        return None
    return Intrinsics(*(float(values[key]) for key in keys))
