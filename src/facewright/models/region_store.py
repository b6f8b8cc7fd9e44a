"""Save and load region-based models: one file (.fwrm), whole or not at all."""

from __future__ import annotations

import hashlib
import json
import os
import zlib
from typing import Any

import numpy as np
from numpy.typing import NDArray

from facewright.errors import FacewrightError, FileFormatError, ValueRangeError
from facewright.io.container import Container, read_container, write_container
from facewright.models.region_model import RegionModel
from facewright.models.regions import Regions

KIND = "region model"
FORMAT_VERSION = 1
SUFFIX = ".fwrm"

_PER_REGION = ("means", "bases", "deviations", "units", "lower", "upper")
_DTYPES = ("<f8", "<i4")


def region_fingerprint(model: RegionModel) -> str:
    """Return 16 hex digits that change with mesh, neutral, regions, bases, bounds and names, not with provenance.

    Coefficients belong to the model of one fingerprint.
    """
    digest = hashlib.sha256()
    for name, array in _arrays(model).items():
        digest.update(f"{name} {array.dtype.str} {array.shape}".encode())
        digest.update(array.tobytes())
    digest.update(json.dumps([model.regions.names, model.coefficient_names]).encode())
    return digest.hexdigest()[:16]


def save_region_model(model: RegionModel, path: str | os.PathLike[str]) -> None:
    """Save a model, completely or not at all; exact to the last bit.

    Parameters
    ----------
    model : RegionModel
    path : str or path
        By custom with the suffix ``.fwrm``.

    Raises
    ------
    StoreError
        If the file cannot be written.
    ValueRangeError
        If the provenance holds other than JSON values.
    """
    arrays = _arrays(model)
    meta = {
        "n_vertices": model.n_vertices,
        "region_names": list(model.regions.names),
        "coefficient_names": [list(names) for names in model.coefficient_names],
        "provenance": dict(model.provenance),
        "fingerprint": region_fingerprint(model),
        "arrays": {name: [array.dtype.str, list(array.shape)] for name, array in arrays.items()},
    }
    blocks = {name: zlib.compress(array.tobytes(), 6) for name, array in arrays.items()}
    try:
        write_container(path, KIND, FORMAT_VERSION, meta, blocks)
    except (TypeError, ValueError) as error:
        if isinstance(error, FacewrightError):
            raise
        raise ValueRangeError(f"provenance must hold JSON values only: {error}.") from error


def load_region_model(path: str | os.PathLike[str]) -> RegionModel:
    """Load a model saved by `save_region_model`.

    Raises
    ------
    StoreError
        If the file is missing or unreadable.
    FileFormatError
        If it is truncated, corrupt, foreign, of another kind or of a newer version.
    """
    container = read_container(path, KIND, FORMAT_VERSION)
    name = os.fspath(path)
    try:
        model = _model(container, name)
        said = str(container.meta["fingerprint"])
    except FileFormatError:
        raise
    except (KeyError, TypeError, ValueError, FacewrightError) as error:
        raise FileFormatError(
            f"{name} is corrupt: it does not hold a region model ({error}); train it again."
        ) from error
    if region_fingerprint(model) != said:
        raise FileFormatError(f"{name} is corrupt: its model does not match its fingerprint; train it again.")
    return model


def _model(container: Container, path: str) -> RegionModel:
    meta = container.meta
    arrays = {name: _array(container, name, path) for name in meta["arrays"]}
    names = tuple(str(name) for name in meta["region_names"])
    lists = {key: tuple(arrays[f"{key}/{i}"] for i in range(len(names))) for key in (*_PER_REGION, "members")}
    return RegionModel(
        faces=arrays["faces"],
        neutral=arrays["neutral"],
        regions=Regions(int(meta["n_vertices"]), lists["members"], names),
        **{key: lists[key] for key in _PER_REGION},
        coefficient_names=tuple(tuple(str(name) for name in group) for group in meta["coefficient_names"]),
        provenance=dict(meta["provenance"]),
    )


def _arrays(model: RegionModel) -> dict[str, NDArray[Any]]:
    arrays: dict[str, NDArray[Any]] = {
        "faces": np.ascontiguousarray(model.faces, dtype="<i4"),
        "neutral": np.ascontiguousarray(model.neutral, dtype="<f8"),
    }
    for i, ids in enumerate(model.regions.members):
        arrays[f"members/{i}"] = np.ascontiguousarray(ids, dtype="<i4")
        for key in _PER_REGION:
            arrays[f"{key}/{i}"] = np.ascontiguousarray(getattr(model, key)[i], dtype="<f8")
    return arrays


def _array(container: Container, name: str, path: str) -> NDArray[Any]:
    """Inflate one array, after comparing its declared size with the block's."""
    dtype, shape = container.meta["arrays"][name]
    block = container.blocks[name]
    if dtype not in _DTYPES or not all(isinstance(size, int) and size >= 0 for size in shape):
        raise ValueError(f"array {name} of type {dtype} and shape {shape}")
    n_bytes = int(np.prod([float(size) for size in shape]) * np.dtype(dtype).itemsize)
    if n_bytes > 1100 * len(block):
        raise ValueError(f"array {name} of {n_bytes} bytes in a block of {len(block)}")
    try:
        data = zlib.decompressobj().decompress(block, n_bytes + 1)
    except zlib.error as error:
        raise FileFormatError(f"{path} is corrupt: array {name}: {error}; train it again.") from error
    if len(data) != n_bytes:
        raise ValueError(f"array {name} of {len(data)} bytes, expected {n_bytes}")
    return np.frombuffer(data, dtype=dtype).reshape(shape).astype(np.dtype(dtype).newbyteorder("="), copy=True)
