"""Where everything lies in a warehouse: keys, chunks, codecs, and the small JSON documents of its groups.

A warehouse is a Zarr v3 hierarchy that any Zarr library can walk::

    zarr.json                               the store: version, face, names; written last when a store is made
    topology/<token>/...                    triangles, uv, masks, landmarks
    subjects/<name>/zarr.json               a subject; it exists when this object does, which names the token
    subjects/<name>/<token>/<array>/...     its arrays, each one ``zarr.json`` and one shard ``c.0.0...``
    labels/<name>/zarr.json                 attributes that were set later; they win over those of the subject
    failures/<quoted name>/zarr.json        why a subject could not be made

A token is the time it was drawn and a random part, so that two writers never share one.
"""

from __future__ import annotations

import json
import math
import re
import secrets
import time
from collections.abc import Mapping
from typing import Any
from urllib.parse import quote

import numpy as np

from facewright.errors import FileFormatError, ValueRangeError

KIND = "facewright warehouse"
VERSION = 1
ROOT = "zarr.json"
OUR_KEY = "facewright"
GROUPS = ("topology", "subjects", "labels", "failures")

FIELDS: tuple[str, ...] = (
    "meshes",
    "blendshapes",
    "expression_weights",
    "depth",
    "color",
    "raw_depth",
    "intrinsics",
    "camera_from_model",
    "landmarks",
    "landmarks_3d",
)
"""Arrays of a `Subject`, by their names there."""
RAW_FIELDS = ("depth", "color", "raw_depth")
DTYPES: dict[str, str] = {
    "meshes": "float32",
    "blendshapes": "float32",
    "depth": "float32",
    "color": "uint8",
    "raw_depth": "float32",
}
"""What arrays are stored as; all others are float64. Nothing is rounded: what is read equals what was written."""

BLOCK_VERTICES = 128
"""Vertices in one chunk of the blendshapes: 47 x 128 x 3 floats are 72 KB, so that a block of vertices of 1,000
people takes 72 MB."""

SECONDS_UNTIL_LEFT = 3600.0
"""Age after which arrays that no document names count as left by a killed writer."""

_TOKEN = re.compile(r"[0-9a-f]{8,10}-[0-9a-f]{12}")
_MAX_DOCUMENT = 64 * 1024 * 1024


def subject_key(name: str) -> str:
    """Return the key of a subject's document."""
    return f"subjects/{name}/zarr.json"


def label_key(name: str) -> str:
    """Return the key of the document of attributes that were set later."""
    return f"labels/{name}/zarr.json"


def failure_folder(name: str) -> str:
    """Return the folder of a failure; any text can be a name here, since an unusable name may be the failure."""
    safe = quote(name, safe="") or "%"
    return "failures/" + (safe if len(safe) <= 128 and not safe.startswith(".") else f"%{safe[:64]}%{_crc(name):08x}")


def new_token() -> str:
    """Draw a token: seconds since 1970 and 48 random bits."""
    return f"{int(time.time()):x}-{secrets.token_hex(6)}"


def is_token(name: str) -> bool:
    """Tell whether a name is a token."""
    return _TOKEN.fullmatch(name) is not None


def token_age(token: str) -> float:
    """Return the seconds since a token was drawn."""
    return time.time() - int(token.partition("-")[0], 16)


def array_chunks(field: str, shape: tuple[int, ...]) -> tuple[int, ...]:
    """Return the chunk in which an array of a subject can be read: one expression, or a block of vertices."""
    if field == "blendshapes":
        return (shape[0], min(BLOCK_VERTICES, shape[1]), shape[2])
    if field == "meshes" or field in RAW_FIELDS:
        return (1, *shape[1:])
    return shape


def group_document(content: Mapping[str, Any] | None = None) -> bytes:
    """Return the metadata object of a Zarr group that carries `content` of ours."""
    attributes = {} if content is None else {OUR_KEY: content}
    document = {"zarr_format": 3, "node_type": "group", "attributes": attributes}
    return json.dumps(document, ensure_ascii=False, allow_nan=False).encode()


def group_content(document: bytes, where: str) -> dict[str, Any]:
    """Return what `group_document` was given.

    Raises
    ------
    FileFormatError
        If the object is not such a document.
    """
    try:
        if len(document) > _MAX_DOCUMENT:
            raise ValueError(f"{len(document)} bytes")
        content = json.loads(document)["attributes"][OUR_KEY]
    except (ValueError, KeyError, TypeError, RecursionError) as error:
        raise FileFormatError(
            f"{where} must be a document of a facewright warehouse, got something else or a part of one; "
            "facewright warehouse check finds all such, and takes them out to be made again."
        ) from error
    if not isinstance(content, dict):
        raise FileFormatError(f"{where} must hold an object {OUR_KEY!r}, got {type(content).__name__}.")
    return content


def json_value(name: str, value: Any) -> Any:
    """Turn NumPy values, tuples and paths into what JSON has; NaN and infinity become null.

    Raises
    ------
    ValueRangeError
        If there is a value that JSON cannot hold.
    """
    if isinstance(value, Mapping):
        return {str(key): json_value(f"{name}.{key}", item) for key, item in value.items()}
    if isinstance(value, np.ndarray | np.generic):
        return json_value(name, value.tolist())
    if isinstance(value, list | tuple):
        return [json_value(name, item) for item in value]
    if isinstance(value, float):
        return value if math.isfinite(value) else None
    if value is None or isinstance(value, str | int | bool):
        return value
    if hasattr(value, "__fspath__"):
        return str(value)
    raise ValueRangeError(f"{name} must hold what JSON can hold, got {type(value).__name__}.")


def _crc(text: str) -> int:
    import zlib

    return zlib.crc32(text.encode())
