"""The binary side of glTF: the GLB container, buffers, views and accessors, both directions."""

from __future__ import annotations

import base64
import json
import struct
from pathlib import Path
from typing import Any
from urllib.parse import unquote

import numpy as np
from numpy.typing import NDArray

from facewright.errors import FileFormatError

MAGIC = 0x46546C67  # "glTF"
JSON_CHUNK = 0x4E4F534A
BIN_CHUNK = 0x004E4942
ARRAY_BUFFER = 34962
ELEMENT_ARRAY_BUFFER = 34963
DTYPES = {5120: "<i1", 5121: "<u1", 5122: "<i2", 5123: "<u2", 5125: "<u4", 5126: "<f4"}
COMPONENTS = {np.dtype(v): k for k, v in DTYPES.items()}
WIDTHS = {"SCALAR": 1, "VEC2": 2, "VEC3": 3, "VEC4": 4, "MAT2": 4, "MAT3": 9, "MAT4": 16}
KINDS = {1: "SCALAR", 2: "VEC2", 3: "VEC3", 4: "VEC4"}
MAX_COUNT = 50_000_000


class BufferWriter:
    """Collects arrays into one buffer and lists their views and accessors."""

    def __init__(self) -> None:
        self.data = bytearray()
        self.views: list[dict[str, Any]] = []
        self.accessors: list[dict[str, Any]] = []

    def add_view(self, data: bytes, target: int | None = None) -> int:
        """Append bytes, aligned to 4, and return the index of their view."""
        self.data.extend(b"\0" * (-len(self.data) % 4))
        view: dict[str, Any] = {"buffer": 0, "byteOffset": len(self.data), "byteLength": len(data)}
        if target is not None:
            view["target"] = target
        self.data.extend(data)
        self.views.append(view)
        return len(self.views) - 1

    def add_accessor(
        self,
        array: NDArray[Any],
        target: int | None = None,
        *,
        bounds: bool = False,
        normalized: bool = False,
        sparse: bool = False,
    ) -> int:
        """Append an array of shape (N,) or (N, width) and return the index of its accessor.

        `sparse` stores the rows that are not zero, with their numbers, where that is smaller.
        """
        rows = np.ascontiguousarray(array.reshape(len(array), -1))
        rows = rows.astype(rows.dtype.newbyteorder("<"), copy=False)
        accessor: dict[str, Any] = {
            "componentType": COMPONENTS[rows.dtype],
            "count": len(rows),
            "type": KINDS[rows.shape[1]],
        }
        if normalized:
            accessor["normalized"] = True
        if bounds:
            accessor["min"] = rows.min(axis=0).tolist()
            accessor["max"] = rows.max(axis=0).tolist()
        moving = np.flatnonzero(rows.any(axis=1)) if sparse else np.arange(len(rows))
        if sparse and 0 < len(moving) < 0.7 * len(rows):
            accessor["sparse"] = self._sparse(rows, moving)
        elif not (sparse and len(moving) == 0):  # no view at all: zeros
            accessor["bufferView"] = self.add_view(rows.tobytes(), target)
        self.accessors.append(accessor)
        return len(self.accessors) - 1

    def _sparse(self, rows: NDArray[Any], moving: NDArray[np.int64]) -> dict[str, Any]:
        dtype = "<u2" if len(rows) <= 65535 else "<u4"
        return {
            "count": len(moving),
            "indices": {
                "bufferView": self.add_view(moving.astype(dtype).tobytes()),
                "componentType": COMPONENTS[np.dtype(dtype)],
            },
            "values": {"bufferView": self.add_view(rows[moving].tobytes())},
        }


def pack_document(document: dict[str, Any], buffer: bytes, *, binary: bool) -> bytes:
    """Serialise a document with its buffer: a GLB container, or JSON with the buffer embedded as base64."""
    padded = buffer + b"\0" * (-len(buffer) % 4)
    document["buffers"] = [{"byteLength": len(padded)}]
    if not binary:
        document["buffers"][0]["uri"] = "data:application/octet-stream;base64," + base64.b64encode(padded).decode()
        return json.dumps(document, allow_nan=False).encode()
    text = json.dumps(document, separators=(",", ":"), allow_nan=False).encode()
    text += b" " * (-len(text) % 4)
    chunks = struct.pack("<II", len(text), JSON_CHUNK) + text + struct.pack("<II", len(padded), BIN_CHUNK) + padded
    return struct.pack("<III", MAGIC, 2, 12 + len(chunks)) + chunks


def unpack_document(path: Path, data: bytes) -> tuple[dict[str, Any], bytes | None]:
    """Take a .glb or .gltf apart: the JSON document, and the binary chunk if there is one."""
    binary = None
    text = data
    if data[:4] == b"glTF":
        if len(data) < 20:
            raise FileFormatError(f"{path} must be a GLB of at least 20 bytes, got {len(data)}: the file is truncated.")
        _, version, length = struct.unpack_from("<III", data)
        if version != 2:
            raise FileFormatError(f"{path} must be glTF version 2, got version {version}.")
        if length > len(data):
            raise FileFormatError(f"{path} must hold {length} bytes, got {len(data)}: the file is truncated.")
        text, binary = _chunks(path, data[:length])
    try:
        document = json.loads(text)
    except ValueError as error:  # bad JSON or bad UTF-8
        raise FileFormatError(f"{path} must be glTF (JSON or GLB), got: {error}.") from None
    asset = document.get("asset") if isinstance(document, dict) else None
    version = str(asset.get("version", "")) if isinstance(asset, dict) else ""
    if not version.startswith("2."):
        raise FileFormatError(f"{path} must be glTF version 2, got version {version or 'none'}.")
    return document, binary


def _chunks(path: Path, data: bytes) -> tuple[bytes, bytes | None]:
    found: dict[int, bytes] = {}
    at = 12
    while at + 8 <= len(data):
        length, kind = struct.unpack_from("<II", data, at)
        if at + 8 + length > len(data):
            raise FileFormatError(f"{path} must hold a chunk of {length} bytes, got {len(data) - at - 8}: truncated.")
        found.setdefault(kind, data[at + 8 : at + 8 + length])
        at += 8 + length + (-length % 4)
    if JSON_CHUNK not in found:
        raise FileFormatError(f"{path} must hold a JSON chunk, got none.")
    return found[JSON_CHUNK], found.get(BIN_CHUNK)


class BufferReader:
    """Gives the accessors of a document as arrays; every size is checked against the bytes that are there."""

    def __init__(self, path: Path, document: dict[str, Any], binary: bytes | None) -> None:
        self.path = path
        self.document = document
        self.buffers = [
            self._load(entry, binary if number == 0 else None)
            for number, entry in enumerate(document.get("buffers", []))
        ]

    def _load(self, entry: dict[str, Any], binary: bytes | None) -> bytes:
        data = binary if "uri" not in entry and binary is not None else self.resource(entry.get("uri", ""))
        if len(data) < entry["byteLength"]:
            raise FileFormatError(
                f"{self.path} must have a buffer of {entry['byteLength']} bytes, got {len(data)}: truncated."
            )
        return data

    def resource(self, uri: str) -> bytes:
        """Return the bytes behind a data URI or a file name relative to the document."""
        if uri.startswith("data:"):
            return base64.b64decode(uri.partition(",")[2], validate=True)
        if not uri or "://" in uri:
            raise FileFormatError(f"{self.path} must embed its buffers or name files beside it, got {uri[:60]!r}.")
        try:
            return (self.path.parent / unquote(uri)).read_bytes()
        except OSError as error:
            raise FileFormatError(f"{self.path} names the file {uri!r}, got: {error.strerror or error}.") from None

    def view_bytes(self, index: int) -> bytes:
        """Return the bytes of a buffer view."""
        view = _item(self.document["bufferViews"], index)
        data, start = self.buffers[view["buffer"]], view.get("byteOffset", 0)
        if start < 0 or view["byteLength"] < 0 or start + view["byteLength"] > len(data):
            raise FileFormatError(f"{self.path} must have view {index} within its buffer of {len(data)} bytes.")
        return data[start : start + view["byteLength"]]

    def array(self, index: int, kind: str | None = None) -> NDArray[Any]:
        """Return an accessor as an array of shape (N, width); normalised integers become float32 in [-1, 1]."""
        accessor = _item(self.document["accessors"], index)
        if kind is not None and accessor["type"] != kind:
            raise FileFormatError(f"{self.path} must have accessor {index} of type {kind}, got {accessor['type']}.")
        width, dtype, count = WIDTHS[accessor["type"]], np.dtype(DTYPES[accessor["componentType"]]), accessor["count"]
        if not 0 <= count <= MAX_COUNT:
            raise FileFormatError(f"{self.path} must have at most {MAX_COUNT} items in an accessor, got {count}.")
        if "bufferView" in accessor:
            stride = self.document["bufferViews"][accessor["bufferView"]].get("byteStride", 0)
            rows = self._rows(accessor["bufferView"], accessor.get("byteOffset", 0), count, width, dtype, stride)
        else:
            rows = np.zeros((count, width), dtype)
        if "sparse" in accessor:
            rows = self._fill_sparse(rows.copy(), accessor["sparse"])
        if accessor.get("normalized") and dtype.kind in "iu":
            return np.maximum(rows.astype(np.float32) / np.iinfo(dtype).max, -1.0)
        return rows

    def _rows(self, view: int, offset: int, count: int, width: int, dtype: np.dtype, stride: int) -> NDArray[Any]:
        data = self.view_bytes(view)
        item = width * dtype.itemsize
        stride = stride or item
        needed = offset + stride * (count - 1) + item if count else 0
        if offset < 0 or stride < item or needed > len(data):
            raise FileFormatError(f"{self.path} must have {needed} bytes in view {view}, got {len(data)}.")
        if not count:
            return np.zeros((0, width), dtype)
        return np.ndarray((count, width), dtype, data, offset, (stride, dtype.itemsize))

    def _fill_sparse(self, rows: NDArray[Any], sparse: dict[str, Any]) -> NDArray[Any]:
        where, what, count = sparse["indices"], sparse["values"], sparse["count"]
        dtype = np.dtype(DTYPES[where["componentType"]])
        index = self._rows(where["bufferView"], where.get("byteOffset", 0), count, 1, dtype, 0)[:, 0]
        if count and index.max() >= len(rows):
            raise FileFormatError(f"{self.path} must have sparse rows below {len(rows)}, got {index.max()}.")
        rows[index] = self._rows(what["bufferView"], what.get("byteOffset", 0), count, rows.shape[1], rows.dtype, 0)
        return rows


def _item(items: list[Any], index: int) -> Any:
    """Index a list without Python's wrap-around of negative numbers."""
    if index < 0:
        raise IndexError(f"index {index}")
    return items[index]
