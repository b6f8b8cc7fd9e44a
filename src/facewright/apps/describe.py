"""Describe the installation and the machine, for bug reports and beside measured numbers."""

from __future__ import annotations

import os
import platform
from importlib import metadata, util
from pathlib import Path
from typing import Any

PACKAGES = ("numpy", "scipy", "numba", "pillow", "scikit-image", "pooch", "typer", "rich", "mediapipe")
EXTRAS = {"landmarks": "mediapipe"}


def describe_installation() -> dict[str, Any]:
    """Return versions, machine, extras, faces and the store's folder, as JSON values."""
    from facewright import __version__
    from facewright.faces import list_faces
    from facewright.faces.store import face_store

    return {
        "facewright": __version__,
        "python": platform.python_version(),
        "packages": {name: _version(name) for name in PACKAGES},
        "extras": {extra: util.find_spec(module) is not None for extra, module in EXTRAS.items()},
        "faces": [{"name": face.name, "installed": face.installed} for face in list_faces()],
        "store": str(face_store()),
        "machine": describe_machine(),
    }


def describe_machine() -> dict[str, Any]:
    """Return what timings depend on: processor, cores, memory, system, and the versions that compute."""
    return {
        "processor": _processor(),
        "cores": usable_cores(),
        "memory_gb": _memory_gb(),
        "system": f"{platform.system()} {platform.machine()}",
        "python": platform.python_version(),
        "numpy": _version("numpy"),
        "scipy": _version("scipy"),
        "numba": _version("numba"),
    }


def usable_cores() -> int:
    """Return the number of cores that this process may use."""
    if hasattr(os, "sched_getaffinity"):
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1


def _version(name: str) -> str | None:
    try:
        return metadata.version(name)
    except metadata.PackageNotFoundError:
        return None


def _processor() -> str:
    try:
        for line in Path("/proc/cpuinfo").read_text().splitlines():
            if line.startswith("model name"):
                return line.split(":", 1)[1].strip()
    except OSError:
        pass
    return platform.processor() or "unknown"


def _memory_gb() -> float | None:
    try:
        return round(os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES") / 2**30, 1)
    except (AttributeError, ValueError, OSError):
        return None
