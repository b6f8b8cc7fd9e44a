"""What a result was made with and from: plain values for JSON, no times, so that equal input gives equal contents."""

from __future__ import annotations

import os
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any

import numpy as np

_PACKAGES = ("numpy", "scipy", "numba", "open3d", "mediapipe")
#: Other names under which the same package is installed.
_ALSO = {"open3d": ("open3d-cpu",)}


def package_versions() -> dict[str, str]:
    """Return the versions of facewright and of the packages that its results depend on, where installed."""
    from facewright import __version__

    versions = {"facewright": __version__}
    for name in _PACKAGES:
        for installed in (name, *_ALSO.get(name, ())):
            try:
                versions[name] = version(installed)
            except PackageNotFoundError:
                continue
            break
    return versions


def plain(value: Any) -> Any:
    """Return a value with arrays as lists, numbers as Python's own to six digits, and NaN as None.

    Examples
    --------
    >>> plain({"rms": np.float32(0.5), "frames": (1, 2), "best": np.array([1.0, np.nan])})
    {'rms': 0.5, 'frames': [1, 2], 'best': [1.0, None]}
    """
    if isinstance(value, dict):
        return {str(key): plain(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [plain(item) for item in value]
    if isinstance(value, np.ndarray):
        return plain(value.tolist())
    if isinstance(value, bool | np.bool_):
        return bool(value)
    if isinstance(value, int | np.integer):
        return int(value)
    if isinstance(value, float | np.floating):
        return float(f"{value:.6g}") if np.isfinite(value) else None
    return value


def without_folder(value: Any, folder: Path) -> Any:
    """Return a value in which no text names `folder`: moved captures make equal subjects.

    Examples
    --------
    >>> without_folder({"reason": "frame 3 of /data/anna/smile is damaged."}, Path("/data/anna"))
    {'reason': 'frame 3 of smile is damaged.'}
    """
    if isinstance(value, dict):
        return {key: without_folder(item, folder) for key, item in value.items()}
    if isinstance(value, list):
        return [without_folder(item, folder) for item in value]
    if isinstance(value, str):
        return value.replace(f"{folder}{os.sep}", "").replace(str(folder), folder.name)
    return value
