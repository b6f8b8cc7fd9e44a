"""Describe the installation and the machine, for bug reports and beside measured numbers."""

from __future__ import annotations

import os
import platform
from importlib import metadata, util
from pathlib import Path
from typing import Any

PACKAGES = (
    "numpy",
    "scipy",
    "numba",
    "pillow",
    "scikit-image",
    "pooch",
    "scikit-learn",
    "threadpoolctl",
    "typer",
    "rich",
)
#: Extra -> the packages it brings, by the name they are imported under.
EXTRAS = {
    "landmarks": ("mediapipe",),
    "video": ("av",),
    "capture": ("open3d", "imagecodecs"),
    "warehouse": ("zarr", "numcodecs", "google_crc32c", "fsspec", "dask", "distributed", "bokeh"),
    "mocap": ("ezc3d",),
    "studio": ("nicegui",),
}
#: Other names under which the same package is installed.
_ALSO = {"open3d": ("open3d-cpu",)}


def describe_installation() -> dict[str, Any]:
    """Return versions, machine, extras, faces and the store's folder, as JSON values.

    `packages` maps names to versions, None where one is not installed; `extras` tells which are complete, and
    `missing` which packages the others lack.
    """
    from facewright import __version__
    from facewright.faces import list_faces
    from facewright.faces.store import face_store

    names = [*PACKAGES, *(name for packages in EXTRAS.values() for name in packages)]
    missing = {extra: [name for name in packages if util.find_spec(name) is None] for extra, packages in EXTRAS.items()}
    return {
        "facewright": __version__,
        "python": platform.python_version(),
        "packages": {name: _version(name) for name in dict.fromkeys(names)},
        "extras": {extra: not packages for extra, packages in missing.items()},
        "missing": {extra: packages for extra, packages in missing.items() if packages},
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
    for installed in (name, *_ALSO.get(name, ())):
        try:
            return metadata.version(installed)
        except metadata.PackageNotFoundError:
            continue
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
