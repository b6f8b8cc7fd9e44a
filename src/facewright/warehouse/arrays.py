"""Arrays as Zarr objects: compressed chunks with checksums in one shard each, and back."""

from __future__ import annotations

import hashlib
import json
import math
from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from facewright.errors import FileFormatError, MissingExtraError

if TYPE_CHECKING:
    from facewright.warehouse.objects import Objects

ALLOWED_DTYPES = ("float32", "float64", "uint8", "int32")
_MAX_BYTES = 64 * 2**30


def encode_array(array: NDArray[Any], chunks: tuple[int, ...], *, dense: bool = False) -> dict[str, bytes]:
    """Encode an array as the objects of a Zarr v3 array.

    Chunks are shuffled by byte and compressed without loss, with LZ4 for meshes and Zstandard where `dense` asks for
    small size over speed, carry a CRC-32C each, and lie in one shard.

    Returns
    -------
    dict of str to bytes
        ``"zarr.json"`` and the shard, ``"c.0.0..."``.
    """
    zarr = import_zarr()
    from zarr.codecs import BloscCodec, Crc32cCodec
    from zarr.storage import MemoryStore

    values = np.ascontiguousarray(array)
    objects: dict[str, Any] = {}
    kind = {"cname": "zstd", "clevel": 3} if dense else {"cname": "lz4", "clevel": 5}
    codec = BloscCodec(**kind, shuffle="shuffle", typesize=values.dtype.itemsize)  # type: ignore[arg-type]
    shards = tuple(-(-size // chunk) * chunk for size, chunk in zip(values.shape, chunks))
    target = zarr.create_array(
        MemoryStore(objects),
        shape=values.shape,
        dtype=values.dtype,
        chunks=chunks,
        shards=shards,
        compressors=[codec, Crc32cCodec()],
        filters=None,
        fill_value=math.nan if values.dtype.kind == "f" else 0,
        chunk_key_encoding={"name": "default", "separator": "."},
        config={"write_empty_chunks": True},
        zarr_format=3,
    )
    target[...] = values
    return {key: buffer.to_bytes() for key, buffer in objects.items()}


def shard_name(n_axes: int) -> str:
    """Return the name of an array's only shard."""
    return ".".join(["c"] + ["0"] * n_axes)


def describe_array(array: NDArray[Any]) -> dict[str, Any]:
    """Return what a document says of an array: shape, dtype and the SHA-256 of its little-endian C-ordered bytes."""
    values = np.ascontiguousarray(array, dtype=array.dtype.newbyteorder("<"))
    checksum = hashlib.sha256(values.data if values.size else b"").hexdigest()
    return {"shape": list(array.shape), "dtype": array.dtype.name, "sha256": checksum}


def checked_description(entry: Any, where: str) -> tuple[tuple[int, ...], np.dtype[Any], str]:
    """Return shape, dtype and checksum of a document's entry, after looking whether they can be true."""
    try:
        shape = tuple(int(size) for size in entry["shape"])
        dtype, checksum = str(entry["dtype"]), str(entry["sha256"])
    except (KeyError, TypeError, ValueError) as error:
        raise FileFormatError(f"{where} must be described by shape, dtype and sha256, got {entry!r}.") from error
    n_bytes = math.prod(float(size) for size in shape) * 8
    if dtype not in ALLOWED_DTYPES or not shape or min(shape) < 1 or n_bytes > _MAX_BYTES:
        raise FileFormatError(f"{where} must be a numeric array of a usable size, got {dtype} {shape}.")
    return shape, np.dtype(dtype), checksum


def decode_array(metadata: bytes, shard: bytes, entry: Any, where: str) -> NDArray[Any]:
    """Decode what `encode_array` made and compare it with what its document says.

    Parameters
    ----------
    metadata, shard : bytes
        The array's two objects.
    entry : object
        What the document says of it, see `describe_array`.
    where : str
        Names the array in messages.

    Raises
    ------
    FileFormatError
        If the array is truncated, corrupt or another one.
    """
    zarr = import_zarr()
    from zarr.core.buffer import cpu
    from zarr.storage import MemoryStore

    shape, dtype, checksum = checked_description(entry, where)
    try:
        declared = json.loads(metadata)
        if tuple(declared["shape"]) != shape or declared["data_type"] != dtype.name:
            found = f"{declared['data_type']} {tuple(declared['shape'])}"
            raise FileFormatError(f"{where} is corrupt: it must be {dtype.name} {shape}, got {found}; {REMEDY}")
        buffer = cpu.Buffer.from_bytes
        store = MemoryStore({"zarr.json": buffer(metadata), shard_name(len(shape)): buffer(shard)})
        array = np.asarray(zarr.open_array(store, mode="r")[...])
    except FileFormatError:
        raise
    except Exception as error:  # truncated shards make Zarr and its codecs raise what they like
        what = " ".join(str(error).split())[:160].rstrip(".") or type(error).__name__
        raise FileFormatError(f"{where} is corrupt: {what}; {REMEDY}") from error
    if describe_array(array)["sha256"] != checksum:
        raise FileFormatError(f"{where} is corrupt: its values do not match their checksum; {REMEDY}")
    return array


REMEDY = "facewright warehouse check finds all such, and takes them out to be made again."


def read_array(objects: Objects, folder: str, entry: Any, where: str) -> NDArray[Any]:
    """Read and check one array, whole.

    Raises
    ------
    StoreError
        If the store cannot be read.
    FileFormatError
        If the array is missing, truncated or corrupt.
    """
    shape, _, _ = checked_description(entry, where)
    metadata, shard = objects.get([f"{folder}/zarr.json", f"{folder}/{shard_name(len(shape))}"])
    if metadata is None or shard is None:
        raise FileFormatError(f"{where} is missing; {REMEDY}")
    return decode_array(metadata, shard, entry, where)


def encode_group(folder: str, arrays: Mapping[str, NDArray[Any]], chunks: Mapping[str, Any]) -> dict[str, bytes]:
    """Encode named arrays below `folder`, with the documents of all groups on the way."""
    from facewright.warehouse.layout import RAW_FIELDS, group_document

    objects: dict[str, bytes] = {f"{folder}/zarr.json": group_document()}
    for name, array in arrays.items():
        parts = name.split("/")
        for depth in range(1, len(parts)):
            objects[f"{folder}/{'/'.join(parts[:depth])}/zarr.json"] = group_document()
        encoded = encode_array(array, chunks.get(name, array.shape), dense=name in RAW_FIELDS)
        objects |= {f"{folder}/{name}/{key}": value for key, value in encoded.items()}
    return objects


def import_zarr() -> Any:
    """Return the module zarr, version 3.

    Raises
    ------
    MissingExtraError
        If it is not installed.
    """
    try:
        import zarr
    except ImportError as error:
        raise MissingExtraError('a warehouse needs Zarr: install it by pip install "facewright[warehouse]".') from error
    if int(zarr.__version__.partition(".")[0]) < 3:
        raise MissingExtraError(
            f'a warehouse needs Zarr 3, got {zarr.__version__}: pip install --upgrade "facewright[warehouse]".'
        )
    return zarr
