"""The project's own file container: a checked header of JSON and named blocks of bytes."""

from __future__ import annotations

import json
import os
import struct
import zlib
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from facewright.errors import FileFormatError, StoreError
from facewright.io.atomic import write_atomically

# 0x89 and the line ends show a file that was sent as text; then version, header bytes, header CRC-32, file bytes.
MAGIC = b"\x89FWRT\r\n\n"
_PREFIX = struct.Struct("<8sIIIQ")
_MAX_HEADER = 64 * 1024 * 1024

_FOREIGN = (
    (b"PK\x03\x04", "a ZIP archive (NumPy .npz files, such as FaceScape's bilinear model, are of this kind)"),
    (b"\x93NUMPY", "a NumPy .npy array"),
    (b"\x80", "a Python pickle, which is never read"),
    (b"\x1f\x8b", "a gzip archive"),
    (b"glTF", "a glTF binary"),
    (b"ply", "a PLY mesh"),
    (b"\x89PNG", "a PNG picture"),
    (b"\xff\xd8\xff", "a JPEG picture"),
    (b"\x89HDF", "an HDF5 file"),
)


@dataclass(frozen=True)
class Container:
    """What a container file holds: `meta` (JSON values) and `blocks` (name -> bytes, checksums verified)."""

    meta: Mapping[str, Any]
    blocks: Mapping[str, memoryview]


def write_container(
    path: str | os.PathLike[str], kind: str, version: int, meta: Mapping[str, Any], blocks: Mapping[str, bytes]
) -> None:
    """Write a container, completely or not at all.

    Parameters
    ----------
    path : str or path
    kind : str
        What the file is, such as ``"bilinear model"``; a reader asks for it.
    version : int
        Version of the kind's content.
    meta : mapping
        JSON values.
    blocks : mapping of str to bytes

    Raises
    ------
    StoreError
        If the file cannot be written (see `write_atomically`).
    """
    table, offset = {}, 0
    for name, block in blocks.items():
        table[name] = [offset, len(block), zlib.crc32(block)]
        offset += len(block)
    content = {"kind": kind, "meta": meta, "blocks": table}
    header = json.dumps(content, separators=(",", ":"), allow_nan=False).encode()
    total = _PREFIX.size + len(header) + offset
    with write_atomically(path) as temporary, temporary.open("wb") as file:
        file.write(_PREFIX.pack(MAGIC, version, len(header), zlib.crc32(header), total))
        file.write(header)
        for block in blocks.values():
            file.write(block)


def read_container(path: str | os.PathLike[str], kind: str, version: int) -> Container:
    """Read a container of `kind`, of content version `version` or older.

    Sizes and checksums are compared with the file before anything is allocated by them.

    Raises
    ------
    StoreError
        If the file is missing or unreadable.
    FileFormatError
        If it is truncated, corrupt, foreign, of another kind or of a newer version.
    """
    path = Path(path)
    try:
        with path.open("rb") as file:
            size = os.fstat(file.fileno()).st_size
            prefix = file.read(_PREFIX.size)
            found, header_size = _check_prefix(path, kind, version, prefix, size)
            header = file.read(header_size)
            if len(header) != header_size or zlib.crc32(header) != found:
                raise FileFormatError(f"{path} is corrupt: its header does not match its checksum; {_REMEDY}")
            content = _parse_header(path, kind, header)
            body = memoryview(file.read(size - _PREFIX.size - header_size))
    except OSError as error:
        raise StoreError(f"{path} cannot be read: {error.strerror or error}.") from error
    blocks = {name: _block(path, name, entry, body) for name, entry in content["blocks"].items()}
    return Container(content["meta"], blocks)


_REMEDY = "build it again, or fetch another copy."


def _check_prefix(path: Path, kind: str, version: int, prefix: bytes, size: int) -> tuple[int, int]:
    """Return the header's checksum and size."""
    if not prefix:
        raise FileFormatError(f"{path} must be a facewright {kind}, got an empty file; {_REMEDY}")
    if not MAGIC.startswith(prefix[: len(MAGIC)]):
        if prefix[:6] == b"\x89FWRT\n":
            what = "one whose line ends were changed by a text-mode transfer"
        else:
            what = next((text for start, text in _FOREIGN if prefix.startswith(start)), "something else")
        raise FileFormatError(f"{path} must be a facewright {kind}, got {what}; give a file saved by facewright.")
    if len(prefix) < _PREFIX.size:
        raise FileFormatError(f"{path} is truncated: expected at least {_PREFIX.size} bytes, got {size}; {_REMEDY}")
    _, found_version, header_size, checksum, total = _PREFIX.unpack(prefix)
    if found_version > version:
        raise FileFormatError(
            f"{path} is a {kind} of format version {found_version}, this facewright reads up to {version}; "
            "upgrade facewright."
        )
    if total != size:
        state = "truncated" if size < total else "too long"
        raise FileFormatError(f"{path} is {state}: expected {total} bytes, got {size}; {_REMEDY}")
    if not 0 < header_size <= min(size - _PREFIX.size, _MAX_HEADER):
        raise FileFormatError(f"{path} is corrupt: it claims a header of {header_size} bytes; {_REMEDY}")
    return checksum, header_size


def _parse_header(path: Path, kind: str, header: bytes) -> dict[str, Any]:
    try:
        content = json.loads(header)
        found = content["kind"]
        good = isinstance(content["meta"], dict) and isinstance(content["blocks"], dict)
    except (ValueError, KeyError, TypeError, RecursionError) as error:
        raise FileFormatError(f"{path} is corrupt: its header is not what a {kind} has; {_REMEDY}") from error
    if found != kind:
        raise FileFormatError(f"{path} must be a facewright {kind}, got a facewright {found}.")
    if not good:
        raise FileFormatError(f"{path} is corrupt: its header is not what a {kind} has; {_REMEDY}")
    return content


def _block(path: Path, name: str, entry: Any, body: memoryview) -> memoryview:
    try:
        offset, length, checksum = (int(value) for value in entry)
    except (TypeError, ValueError) as error:
        raise FileFormatError(f"{path} is corrupt: block {name!r} has no valid entry; {_REMEDY}") from error
    if offset < 0 or length < 0 or offset + length > len(body):
        raise FileFormatError(f"{path} is corrupt: block {name!r} lies outside the file; {_REMEDY}")
    block = body[offset : offset + length]
    if zlib.crc32(block) != checksum:
        raise FileFormatError(f"{path} is corrupt: block {name!r} does not match its checksum; {_REMEDY}")
    return block
