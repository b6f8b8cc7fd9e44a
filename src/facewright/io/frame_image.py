"""Pictures of depth cameras: 16-bit depth and 8-bit colour, from and to the bytes of PNG and JPEG files."""

from __future__ import annotations

import io
import struct
import warnings
import zlib
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from facewright.errors import FileFormatError, ShapeError, StoreError
from facewright.io.image import MAX_PIXELS

_PNG_SIGNATURE = b"\x89PNG\r\n\x1a\n"


def read_bytes(path: str | Path) -> bytes:
    """Return the whole file; raises StoreError with one sentence where that is not possible."""
    try:
        return Path(path).read_bytes()
    except FileNotFoundError as error:
        raise StoreError(f"{path} does not exist.") from error
    except OSError as error:
        raise StoreError(f"{path} cannot be read: {error.strerror or error}.") from error


def decode_depth(data: bytes, name: str | Path) -> NDArray[np.uint16] | NDArray[np.float32]:
    """Return the stored numbers of a depth picture.

    Parameters
    ----------
    data : bytes
        A PNG or TIFF file of one channel: 16 or 32 bits, or float.
    name : str or Path
        What it is called in messages.

    Returns
    -------
    ndarray of shape (H, W), uint16 or float32
        As stored, in the unit of the file; float values may be NaN.

    Raises
    ------
    FileFormatError
        If the picture is truncated, corrupt, or has no depth: 8 bits or colour.
    """
    values = _decoded(data, name, None)
    if values.ndim != 2 or values.dtype.itemsize < 2:
        found = f"{values.shape[2]} channels" if values.ndim == 3 else "8 bits"
        raise FileFormatError(f"{name} must be a depth picture of one channel and 16 bits, got {found}.")
    if values.dtype.kind == "f":
        return values.astype(np.float32)
    if values.min(initial=0) < 0 or values.max(initial=0) > 65535:
        return np.clip(values, 0, None).astype(np.float32)
    return values.astype(np.uint16, copy=False)


def decode_color(data: bytes, name: str | Path) -> NDArray[np.uint8]:
    """Return a colour picture as stored: sRGB (H, W, 3) uint8, without the turn that EXIF data may ask for.

    The pixels of colour and depth must stay where the camera saw them.

    Raises
    ------
    FileFormatError
        If the picture is truncated, corrupt or of more than 8 bits.
    """
    values = _decoded(data, name, "RGB")
    if values.ndim != 3 or values.dtype != np.uint8:
        raise FileFormatError(f"{name} must be a colour picture of 8 bits, got {values.dtype} of shape {values.shape}.")
    return values


def encode_depth(counts: NDArray[np.uint16]) -> bytes:
    """Return a 16-bit PNG file of a depth picture (H, W), uint16.

    Rows are stored unfiltered: noisy depth gains nothing from PNG's filters, and without them writing takes a third
    and reading half of the time.

    Raises
    ------
    ShapeError
        If `counts` is not (H, W) of uint16, or empty.
    """
    if counts.ndim != 2 or counts.dtype != np.uint16 or counts.size == 0:
        raise ShapeError(f"counts must be (H, W) of uint16, got {counts.shape} of {counts.dtype}.")
    height, width = counts.shape
    rows = np.zeros((height, 1 + 2 * width), np.uint8)  # each begins with the number of its filter, 0
    rows[:, 1:] = np.ascontiguousarray(counts, dtype=">u2").view(np.uint8)
    header = struct.pack(">IIBBBBB", width, height, 16, 0, 0, 0, 0)  # 16 bits, grey
    body = zlib.compress(rows.tobytes(), level=1)
    return _PNG_SIGNATURE + _chunk(b"IHDR", header) + _chunk(b"IDAT", body) + _chunk(b"IEND", b"")


def _chunk(kind: bytes, data: bytes) -> bytes:
    return struct.pack(">I", len(data)) + kind + data + struct.pack(">I", zlib.crc32(kind + data))


def _decoded(data: bytes, name: str | Path, mode: str | None) -> NDArray[Any]:
    from PIL import Image

    if not data:
        raise FileFormatError(f"{name} must be a picture, got an empty file.")
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # our own limit is stated below
            picture = Image.open(io.BytesIO(data))
        width, height = picture.size
        if width * height > MAX_PIXELS:
            raise FileFormatError(f"{name} must have at most {MAX_PIXELS} pixels, got {width} x {height}.")
        deep = picture.mode.startswith(("I", "F"))
        return np.asarray(picture if mode is None or deep or picture.mode == mode else picture.convert(mode))
    except (FileFormatError, MemoryError):
        raise
    except Exception as error:  # decoders raise OSError, SyntaxError, ValueError, struct.error, zlib.error, ...
        raise FileFormatError(f"{name} must be a whole picture, got one that is truncated or corrupt.") from error
