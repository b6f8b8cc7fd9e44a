"""Registered data of a performer in one file: clips of a coarse mesh, no pickle."""

from __future__ import annotations

import os
from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from facewright.errors import FacewrightError, FileFormatError, ValueRangeError
from facewright.io.container import Container, read_container, write_container
from facewright.models.performer_data import PerformerClip, PerformerData

KIND = "performer's registered motion"
FORMAT_VERSION = 1
_DTYPES = ("<f8", "<f4", "<i4")
_CLIP_ARRAYS = {"times": "<f8", "vertices": "<f4", "rotations": "<f8", "translations": "<f8"}
_ARRAYS = {"faces": "<i4", "neutral": "<f4", "reference": "<f4", "vertex_ids": "<i4"}


def save_performer(data: PerformerData, path: str | os.PathLike[str]) -> None:
    """Save a performer's data in one file, completely or not at all; by custom with the suffix ``.fwms``.

    Raises
    ------
    StoreError
        If the file cannot be written.
    ValueRangeError
        If the statistics hold anything but JSON values.
    """
    blocks: dict[str, bytes] = {}
    arrays: dict[str, Any] = {}

    def put(name: str, array: NDArray[Any], dtype: str) -> None:
        arrays[name] = [dtype, list(array.shape)]
        blocks[name] = np.ascontiguousarray(array, dtype=dtype).tobytes()

    for name, dtype in _ARRAYS.items():
        put(name, getattr(data, name), dtype)
    if data.mirror is not None:
        put("mirror", data.mirror, "<i4")
    for number, clip in enumerate(data.clips):
        for name, dtype in _CLIP_ARRAYS.items():
            put(f"clips/{number}/{name}", getattr(clip, name), dtype)
    meta = {
        "name": data.name,
        "template": data.template,
        "clips": list(data.clip_names),
        "arrays": arrays,
        "statistics": dict(data.statistics),
    }
    try:
        write_container(path, KIND, FORMAT_VERSION, meta, blocks)
    except (TypeError, ValueError) as error:
        if isinstance(error, FacewrightError):
            raise
        raise ValueRangeError(f"statistics must hold JSON values only: {error}.") from error


def load_performer(path: str | os.PathLike[str]) -> PerformerData:
    """Load a performer's data saved by `save_performer`.

    Raises
    ------
    StoreError
        If the file is missing or unreadable.
    FileFormatError
        If it is truncated, corrupt, foreign or of a newer version.
    """
    container = read_container(path, KIND, FORMAT_VERSION)
    try:
        return _data(container)
    except FileFormatError:
        raise
    except (KeyError, TypeError, ValueError, AttributeError) as error:
        found = f"no {error}" if isinstance(error, KeyError) else str(error)
        raise FileFormatError(f"{path} is corrupt: {found.rstrip('.')}; import the performer again.") from error


def _data(container: Container) -> PerformerData:
    meta = container.meta
    arrays = {name: _array(container, name, entry) for name, entry in meta["arrays"].items()}
    names = [str(name) for name in meta["clips"]]
    clips = tuple(
        PerformerClip(name, **{key: arrays[f"clips/{number}/{key}"] for key in _CLIP_ARRAYS})
        for number, name in enumerate(names)
    )
    statistics: Mapping[str, Any] = meta["statistics"]
    return PerformerData(
        name=str(meta["name"]),
        clips=clips,
        template=str(meta["template"]),
        mirror=arrays.get("mirror"),
        statistics=dict(statistics),
        **{name: arrays[name] for name in _ARRAYS},
    )


def _array(container: Container, name: str, entry: Any) -> NDArray[Any]:
    dtype, shape = entry
    if dtype not in _DTYPES or not all(isinstance(size, int) and size >= 0 for size in shape):
        raise ValueError(f"array {name} of type {dtype} and shape {shape}")
    block = container.blocks[name]
    if float(np.prod([float(size) for size in shape])) * np.dtype(dtype).itemsize != len(block):
        raise ValueError(f"array {name} of shape {shape} in {len(block)} bytes")
    return np.frombuffer(block, dtype=dtype).reshape(shape).astype(np.dtype(dtype).newbyteorder("="), copy=True)
