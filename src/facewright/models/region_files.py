"""Regions as a JSON file that a person can edit: names and vertex numbers."""

from __future__ import annotations

import json
import os
from pathlib import Path
from typing import Any

import numpy as np

from facewright.errors import FileFormatError, ValueRangeError
from facewright.io.atomic import write_atomically
from facewright.models.regions import Regions

_FORMAT = "facewright regions"
_VERSION = 1


def write_regions(regions: Regions, path: str | os.PathLike[str]) -> None:
    """Write regions as JSON, completely or not at all; a vertex that several list is shared by them.

    Raises
    ------
    StoreError
        If the file cannot be written.
    """
    entries = [
        {"name": name, "vertices": ids.tolist()} for name, ids in zip(regions.names, regions.members, strict=True)
    ]
    lines = ",\n  ".join(json.dumps(entry) for entry in entries)
    head = f'"format": "{_FORMAT}", "version": {_VERSION}, "n_vertices": {regions.n_vertices}'
    with write_atomically(path) as place:
        place.write_text(f'{{{head}, "regions": [\n  {lines}\n]}}\n', encoding="utf-8")


def read_regions(path: str | os.PathLike[str]) -> Regions:
    """Read regions from JSON.

    Raises
    ------
    FileFormatError
        If it is not such a file, or its regions do not cover the mesh and share vertices as they must.
    """
    path = Path(path)
    try:
        content = json.loads(path.read_text(encoding="utf-8"))
    except OSError as error:
        raise FileFormatError(f"{path}: cannot be read: {error.strerror}.") from error
    except ValueError as error:
        raise FileFormatError(f"{path}: expected JSON with regions, got text that is not JSON ({error}).") from error
    if not isinstance(content, dict) or content.get("format") != _FORMAT:
        raise FileFormatError(f'{path}: expected a JSON object with "format": "{_FORMAT}", got another content.')
    if content.get("version") != _VERSION:
        raise FileFormatError(
            f"{path}: expected version {_VERSION}, got {content.get('version')!r}: use a newer facewright."
        )
    n_vertices, entries = content.get("n_vertices"), content.get("regions")
    if not isinstance(n_vertices, int) or not _is_count(n_vertices) or not isinstance(entries, list) or not entries:
        raise FileFormatError(f'{path}: expected "n_vertices" and a list "regions", got other values.')
    members, names = [], []
    for number, entry in enumerate(entries, 1):
        ids = entry.get("vertices") if isinstance(entry, dict) else None
        name = entry.get("name") if isinstance(entry, dict) else None
        if not isinstance(ids, list) or not all(_is_count(i) for i in ids) or not isinstance(name, str):
            raise FileFormatError(f'{path}: region {number} must have a "name" and whole numbers as "vertices".')
        members.append(np.unique(np.array([min(i, 2**31 - 1) for i in ids], dtype=np.int32)))
        names.append(name)
    try:
        return Regions(n_vertices, tuple(members), tuple(names))
    except ValueRangeError as error:
        raise FileFormatError(f"{path}: {error}") from error


def _is_count(value: Any) -> bool:
    return isinstance(value, int) and not isinstance(value, bool) and value >= 0
