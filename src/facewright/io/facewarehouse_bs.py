"""FaceWarehouse's own files: blendshapes (.bs), landmarks (.land) and tensors (.tensor).

No real file was at hand: what is read here is what public readers agree on. Every size is compared with the file's
before anything is allocated by it.
"""

from __future__ import annotations

import os
import struct
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from facewright.errors import FileFormatError, StoreError, ValueRangeError
from facewright.io.atomic import write_atomically
from facewright.numeric.check import check_finite, check_shape

N_LAND_POINTS = 74
_BS_HEADER = struct.Struct("<iii")
_MAX_LAND_BYTES = 1024 * 1024


@dataclass(frozen=True, eq=False)
class BsShapes:
    """Content of a ``shape.bs`` file.

    Parameters
    ----------
    shapes : ndarray of shape (B + 1, V, 3), float32
        Absolute positions in the file's unit, the neutral first.
    n_faces : int
        Number of polygons of the mesh, as the file states it; the polygons themselves are not in the file.
    """

    shapes: NDArray[np.float32]
    n_faces: int


def read_bs(path: str | os.PathLike[str]) -> BsShapes:
    """Read a ``shape.bs`` file.

    Little-endian int32 number of shapes without the neutral, vertices, faces; then a block of float32 (x, y, z) for
    the neutral and for each shape.

    Raises
    ------
    StoreError
        If the file cannot be read.
    FileFormatError
        If the sizes it states are not those of the file, or a position is not finite.
    """
    path = Path(path)
    data = _read(path, "a FaceWarehouse .bs file")
    if len(data) < _BS_HEADER.size:
        raise FileFormatError(f"{path} must be a FaceWarehouse .bs file of at least 12 bytes, got {len(data)}.")
    n_shapes, n_vertices, n_faces = _BS_HEADER.unpack_from(data)
    expected = _BS_HEADER.size + (n_shapes + 1) * n_vertices * 12
    if n_shapes < 1 or n_vertices < 1 or n_faces < 0 or expected != len(data):
        raise FileFormatError(
            f"{path} must be a FaceWarehouse .bs file of {n_shapes} + 1 shapes of {n_vertices} vertices in {expected} "
            f"bytes, as it states, got {len(data)} bytes."
        )
    values = np.frombuffer(data, dtype="<f4", offset=_BS_HEADER.size).reshape(n_shapes + 1, n_vertices, 3)
    bad = values.size - int(np.isfinite(values).sum())
    if bad:
        raise FileFormatError(f"{path} must hold finite positions, got {bad} NaN or infinite values.")
    return BsShapes(values.astype(np.float32), n_faces)


def write_bs(path: str | os.PathLike[str], shapes: NDArray[np.floating], n_faces: int) -> None:
    """Write a ``shape.bs`` file, whole or not at all.

    Parameters
    ----------
    path : str or path
    shapes : ndarray of shape (B + 1, V, 3)
        Absolute positions, the neutral first.
    n_faces : int
        Number of polygons of the mesh.

    Raises
    ------
    ShapeError, ValueRangeError
        If `shapes` is of another shape, or not finite.
    StoreError
        If the file cannot be written.
    """
    sizes = check_shape("shapes", shapes, "B", "V", 3)
    check_finite("shapes", shapes)
    with write_atomically(path) as temporary, temporary.open("wb") as file:
        file.write(_BS_HEADER.pack(sizes["B"] - 1, sizes["V"], n_faces))
        file.write(np.ascontiguousarray(shapes, dtype="<f4").tobytes())


def read_land(path: str | os.PathLike[str], size: tuple[int, int]) -> NDArray[np.float64]:
    """Read a ``.land`` file: 74 points on a picture.

    Parameters
    ----------
    path : str or path
    size : (height, width)
        Of the picture in pixels: the file counts from 0 to 1 across it, y upwards.

    Returns
    -------
    ndarray of shape (74, 2), float64, pixels
        x right, y down, the centre of the first pixel is (0, 0).

    Raises
    ------
    StoreError
        If the file cannot be read.
    FileFormatError
        If it does not hold 74 points near the picture.
    """
    path = Path(path)
    data = _read(path, "a FaceWarehouse .land file", _MAX_LAND_BYTES)
    try:
        numbers = np.array(data.decode("ascii").split(), dtype=np.float64)
    except ValueError as error:
        raise FileFormatError(f"{path} must be a FaceWarehouse .land file, numbers as text, got other text.") from error
    if not len(numbers) or numbers[0] != N_LAND_POINTS or len(numbers) != 1 + 2 * N_LAND_POINTS:
        raise FileFormatError(
            f"{path} must hold the number 74 and 74 points, got {len(numbers)} numbers"
            + (f" beginning with {numbers[0]:g}." if len(numbers) else ".")
        )
    points = numbers[1:].reshape(-1, 2)
    if not ((points > -1) & (points < 2)).all():
        raise FileFormatError(f"{path} must hold points as shares of the picture, in [0, 1] or near, got others.")
    height, width = size
    return np.stack([points[:, 0] * width - 0.5, (1.0 - points[:, 1]) * height - 0.5], axis=1)


def write_land(path: str | os.PathLike[str], points: NDArray[np.floating], size: tuple[int, int]) -> None:
    """Write a ``.land`` file of 74 points (74, 2) in pixels of a picture of `size` (height, width).

    Raises
    ------
    ShapeError, ValueRangeError
        If the points are not 74, or one is missing: the format cannot say that.
    StoreError
        If the file cannot be written.
    """
    check_shape("points", points, N_LAND_POINTS, 2)
    check_finite("points", points)
    height, width = size
    if height < 1 or width < 1:
        raise ValueRangeError(f"size must be (height, width) of a picture, got {size}.")
    shares = np.stack([(points[:, 0] + 0.5) / width, 1.0 - (points[:, 1] + 0.5) / height], axis=1)
    text = f"{N_LAND_POINTS}\n" + "".join(f"{x:.9f} {y:.9f}\n" for x, y in shares.tolist())
    with write_atomically(path) as temporary:
        temporary.write_text(text, encoding="ascii")


# Kinds of .tensor files: number of sizes in the header, and the type of the values.
_TENSOR_KINDS = ((2, "<f4"), (3, "<f4"), (2, "<f8"), (3, "<f8"))


def read_face_tensor(path: str | os.PathLike[str]) -> NDArray[np.floating]:
    """Read a ``.tensor`` file of either generation.

    The older one has 2 or 3 int32 sizes and float32 values in row-major order; the newer one 2 or 3 int32 sizes and
    float64 values, each matrix in column-major order. Nothing but the size of the file tells which it is.

    Returns
    -------
    ndarray of shape (m, n) or (l, m, n), float32 or float64

    Raises
    ------
    StoreError
        If the file cannot be read.
    FileFormatError
        If its size fits none of the kinds, or more than one.
    """
    path = Path(path)
    try:
        n_bytes = path.stat().st_size
        with path.open("rb") as file:
            head = file.read(12)
    except OSError as error:
        raise StoreError(f"{path} must be a readable .tensor file, got: {error.strerror or error}.") from error
    fitting = []
    for rank, dtype in _TENSOR_KINDS:
        if len(head) < 4 * rank:
            continue
        shape = struct.unpack_from(f"<{rank}i", head)
        count = 1
        for axis in shape:
            count *= axis
        if min(shape) > 0 and n_bytes == 4 * rank + count * np.dtype(dtype).itemsize:
            fitting.append((shape, dtype))
    if len(fitting) != 1:
        found = "none" if not fitting else " and ".join(f"{dtype[1:]} {shape}" for shape, dtype in fitting)
        raise FileFormatError(
            f"{path} must be a FaceWarehouse .tensor file whose {n_bytes} bytes fit one kind of it, got {found}."
        )
    shape, dtype = fitting[0]
    values = np.frombuffer(_read(path, "a .tensor file"), dtype=dtype, offset=4 * len(shape))
    if dtype == "<f4":
        return values.reshape(shape).astype(np.float32)
    columns = values.reshape(*shape[:-2], shape[-1], shape[-2])
    return np.ascontiguousarray(columns.swapaxes(-1, -2), dtype=np.float64)


def _read(path: Path, what: str, most: int = 2**33) -> bytes:
    try:
        n_bytes = path.stat().st_size
        if n_bytes > most:
            raise FileFormatError(f"{path} must be {what}, got one of {n_bytes} bytes, which is too large.")
        return path.read_bytes()
    except OSError as error:
        raise StoreError(f"{path} must be {what} that can be read, got: {error.strerror or error}.") from error
