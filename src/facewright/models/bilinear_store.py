"""Save and load bilinear models: one file, compressed, with a stated error bound."""

from __future__ import annotations

import os
import zlib
from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from facewright.errors import FacewrightError, FileFormatError, ValueRangeError
from facewright.io.container import Container, read_container, write_container
from facewright.mesh.topology import Topology
from facewright.models.bilinear import BilinearModel
from facewright.models.core_compression import compress_core, decompress_core

KIND = "bilinear model"
FORMAT_VERSION = 1
_SIGMAS = 3.0
_ARRAYS = (
    "identity_weights",
    "expression_weights",
    "identity_singular_values",
    "expression_singular_values",
    "identity_mean",
    "identity_covariance",
    "expression_mean",
    "expression_covariance",
)
_TOPOLOGY_ARRAYS = ("faces", "quads", "uv", "uv_faces", "mirror")
_DTYPES = ("<f8", "<f4", "<i4")
LABELS_VERSION = 1  # of the labels alone; readers from before there were any do not look for them


def save_bilinear(model: BilinearModel, path: str | os.PathLike[str], *, max_error_mm: float = 0.05) -> float:
    """Save `model` in one file, completely or not at all, and return the error bound that holds for it.

    Parameters
    ----------
    model : BilinearModel
    path : str or path
        By custom with the suffix ``.fwbm``.
    max_error_mm : float
        How far a vertex of a loaded model's face may be from the saved model's, for every weight vector within 3
        standard deviations of the prior's mean, component by component, and for all training weights.

    Returns
    -------
    float
        The bound that was reached, mm, at most `max_error_mm`; also in the file's header.

    Raises
    ------
    StoreError
        If the file cannot be written.
    ValueRangeError
        If `max_error_mm` is not positive, or smaller than float32 can meet.
    """
    limits = (
        _weight_limits(model.identity_weights, model.identity_mean, model.identity_covariance),
        _weight_limits(model.expression_weights, model.expression_mean, model.expression_covariance),
    )
    compressed = compress_core(model.core_rows, *limits, max_error_mm)
    blocks: dict[str, bytes] = {}
    arrays: dict[str, Any] = {}

    def put(name: str, array: Any) -> None:
        array = np.ascontiguousarray(array, dtype=_storage_dtype(array))
        arrays[name] = [array.dtype.str, list(array.shape)]
        blocks[name] = zlib.compress(array.tobytes())

    put("core_steps", compressed.steps)
    for name in _ARRAYS:
        put(name, getattr(model, name))
    topology = model.topology
    for name in _TOPOLOGY_ARRAYS:
        if getattr(topology, name) is not None:
            put(f"topology/{name}", getattr(topology, name))
    for group in ("masks", "landmarks"):
        for name, ids in getattr(topology, group).items():
            put(f"topology/{group}/{name}", ids)
    for number, planes in enumerate(compressed.rows):
        for k, plane in enumerate(planes):
            blocks[f"core/{number}/{k}"] = plane
    meta = {
        "arrays": arrays,
        "planes": [len(planes) for planes in compressed.rows],
        "max_error_mm": compressed.max_error_mm,
        "expression_names": list(model.expression_names),
        "labels": {
            "version": LABELS_VERSION,
            "values": {name: list(values) for name, values in model.labels.items()},
        },
        "provenance": dict(model.provenance) | {"model_id": model.model_id},
        "topology": {
            "name": topology.name,
            "n_vertices": topology.n_vertices,
            "parts": {name: list(span) for name, span in topology.parts.items()},
        },
    }
    try:
        write_container(path, KIND, FORMAT_VERSION, meta, blocks)
    except (TypeError, ValueError) as error:
        if isinstance(error, FacewrightError):
            raise
        raise ValueRangeError(f"provenance and labels must hold JSON values only: {error}.") from error
    return compressed.max_error_mm


def load_bilinear(path: str | os.PathLike[str]) -> BilinearModel:
    """Load a model saved by `save_bilinear`.

    Its provenance tells the error of the storage as ``stored_max_error_mm`` and the model's identity as ``model_id``:
    that of the model that was saved, or, in files that do not state it, that of the stored numbers.

    Raises
    ------
    StoreError
        If the file is missing or unreadable.
    FileFormatError
        If it is truncated, corrupt, foreign or of a newer version; the message says what was found and what to do.
    """
    container = read_container(path, KIND, FORMAT_VERSION)
    try:
        return _model(container, str(path))
    except FileFormatError:
        raise
    except (KeyError, TypeError, ValueError, AttributeError, IndexError) as error:
        found = f"no {error}" if isinstance(error, KeyError) else str(error)
        raise FileFormatError(f"{path} is corrupt: {found.rstrip('.')}; build it again.") from error


def _model(container: Container, path: str) -> BilinearModel:
    meta = container.meta
    arrays = {name: _array(container, name, path) for name in meta["arrays"]}
    steps = arrays["core_steps"]
    V = int(meta["topology"]["n_vertices"])
    counts = [int(count) for count in meta["planes"]]
    if steps.ndim != 2 or len(counts) != len(steps) or V <= 0:
        raise ValueError(f"core of {steps.shape} components and {len(counts)} rows, {V} vertices")
    if not (np.isfinite(steps).all() and (steps > 0).all()):
        raise ValueError("core steps that are not positive numbers")
    rows = [[container.blocks[f"core/{i}/{k}"] for k in range(count)] for i, count in enumerate(counts)]
    names = tuple(str(name) for name in meta["expression_names"])
    for name in _ARRAYS:
        if not np.isfinite(arrays[name]).all():
            raise ValueError(f"{name} that is not finite")
    topology = _topology(meta["topology"], arrays)
    model = BilinearModel(
        core_rows=decompress_core(steps, rows, V, path),
        expression_names=names,
        topology=topology,
        provenance={**meta["provenance"], "stored_max_error_mm": float(meta["max_error_mm"])},
        labels=_labels(meta.get("labels"), len(arrays["identity_weights"]), path),
        **{name: arrays[name] for name in _ARRAYS},
    )
    return replace(model, provenance={**model.provenance, "model_id": model.model_id})


def _labels(
    meta: Mapping[str, Any] | None, n_people: int, path: str
) -> dict[str, tuple[str | int | float | bool | None, ...]]:
    """Read the training people's labels; a file from before there were any has none."""
    if meta is None:
        return {}
    if meta["version"] != LABELS_VERSION:
        raise FileFormatError(
            f"{path} has labels of version {meta['version']}, this program reads version {LABELS_VERSION}; "
            "update facewright."
        )
    labels = {str(name): tuple(values) for name, values in meta["values"].items()}
    for name, values in labels.items():
        if len(values) != n_people or not all(
            value is None or isinstance(value, str | int | float) for value in values
        ):
            raise ValueError(f"label {name!r} that does not hold a value for each of {n_people} people")
    return labels


def _topology(meta: Mapping[str, Any], arrays: Mapping[str, NDArray[Any]]) -> Topology:
    def group(name: str) -> dict[str, NDArray[np.int32]]:
        start = f"topology/{name}/"
        return {key[len(start) :]: array for key, array in arrays.items() if key.startswith(start)}

    return Topology(
        name=str(meta["name"]),
        n_vertices=int(meta["n_vertices"]),
        parts={str(name): (int(span[0]), int(span[1])) for name, span in meta["parts"].items()},
        masks=group("masks"),
        landmarks=group("landmarks"),
        faces=arrays["topology/faces"],
        **{name: arrays.get(f"topology/{name}") for name in _TOPOLOGY_ARRAYS[1:]},
    )


def _array(container: Container, name: str, path: str) -> NDArray[Any]:
    """Inflate one small array, after comparing its declared size with the block's."""
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
        raise FileFormatError(f"{path} is corrupt: array {name}: {error}; build it again.") from error
    if len(data) != n_bytes:
        raise ValueError(f"array {name} of {len(data)} bytes, expected {n_bytes}")
    return np.frombuffer(data, dtype=dtype).reshape(shape).astype(np.dtype(dtype).newbyteorder("="), copy=True)


def _storage_dtype(array: NDArray[Any]) -> str:
    if array.dtype.kind in "iu":
        return "<i4"
    return "<f4" if array.dtype.itemsize <= 4 else "<f8"


def _weight_limits(
    weights: NDArray[np.float64], mean: NDArray[np.float64], covariance: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Largest weights for which the stated error holds."""
    limits = np.abs(mean) + _SIGMAS * np.sqrt(np.maximum(np.diag(covariance), 0.0))
    return np.maximum(limits, np.abs(weights).max(axis=0, initial=0.0))
