"""A topology as arrays and a small document, so that a warehouse stands alone."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from facewright.errors import FacewrightError, FileFormatError
from facewright.mesh.topology import Topology
from facewright.warehouse.arrays import describe_array, encode_group, read_array
from facewright.warehouse.layout import is_token
from facewright.warehouse.objects import Objects

_ARRAYS = ("faces", "quads", "uv", "uv_faces", "mirror")
_GROUPS = ("masks", "landmarks")


def encode_topology(topology: Topology, token: str) -> tuple[dict[str, bytes], dict[str, Any]]:
    """Return a topology's objects, and what the store's document says of it."""
    arrays: dict[str, NDArray[Any]] = {}
    for name in _ARRAYS:
        if getattr(topology, name) is not None:
            arrays[name] = _stored(getattr(topology, name))
    for group in _GROUPS:
        for name, ids in getattr(topology, group).items():
            arrays[f"{group}/{name}"] = _stored(ids)
    full = {name: array for name, array in arrays.items() if array.size}
    document = {
        "token": token,
        "name": topology.name,
        "fingerprint": topology.fingerprint,
        "n_vertices": int(topology.n_vertices),
        "parts": {name: [int(start), int(stop)] for name, (start, stop) in topology.parts.items()},
        "arrays": {name: describe_array(array) for name, array in full.items()},
        "empty": sorted(set(arrays) - set(full)),
    }
    return encode_group(f"topology/{token}", full, {}), document


def read_topology(objects: Objects, document: Mapping[str, Any]) -> Topology:
    """Read the topology that a store's document describes.

    Raises
    ------
    StoreError
        If the store cannot be read.
    FileFormatError
        If a part is missing or corrupt.
    """
    where = f"{objects.url}: topology"
    try:
        token = str(document["token"])
        if not is_token(token):
            raise ValueError(f"token {token!r}")
        arrays = {
            str(name): read_array(objects, f"topology/{token}/{name}", entry, f"{where} {name}")
            for name, entry in document["arrays"].items()
        }
        arrays |= {str(name): np.empty(0, np.int32) for name in document["empty"] if "/" in name}
        topology = Topology(
            name=str(document["name"]),
            n_vertices=int(document["n_vertices"]),
            parts={str(name): (int(span[0]), int(span[1])) for name, span in document["parts"].items()},
            masks=_group(arrays, "masks"),
            landmarks=_group(arrays, "landmarks"),
            faces=arrays["faces"],
            **{name: arrays.get(name) for name in _ARRAYS[1:]},
        )
        if topology.fingerprint != document["fingerprint"]:
            raise ValueError("triangles of another fingerprint")
    except FileFormatError:
        raise
    except FacewrightError as error:
        if isinstance(error, OSError):
            raise
        raise FileFormatError(f"{where} is corrupt: {error}") from error
    except (KeyError, TypeError, ValueError, AttributeError, IndexError) as error:
        found = f"no {error}" if isinstance(error, KeyError) else str(error)
        raise FileFormatError(f"{where} is corrupt: {found.rstrip('.')}; make the store again.") from error
    return topology


def _group(arrays: Mapping[str, NDArray[Any]], group: str) -> dict[str, NDArray[np.int32]]:
    start = f"{group}/"
    return {name[len(start) :]: array for name, array in arrays.items() if name.startswith(start)}


def _stored(array: NDArray[Any]) -> NDArray[Any]:
    return np.ascontiguousarray(array, dtype=np.int32 if array.dtype.kind in "iu" else np.float32)
