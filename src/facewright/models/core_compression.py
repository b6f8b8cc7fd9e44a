"""Quantise and compress a bilinear core with a bound on the error of every face it can make."""

from __future__ import annotations

import zlib
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from facewright.errors import FileFormatError, ValueRangeError

_MAX_DEFLATE_RATIO = 1100  # deflate cannot expand more than 1032 : 1
_THREADS = 2


class CompressedCore(NamedTuple):
    """A core as compressed identity rows.

    Attributes
    ----------
    steps : ndarray of shape (I, E), float32, millimetres
        Quantisation step of each component: core = steps * integers.
    rows : list of list of bytes
        For each identity component its byte planes (2 or 4), lowest first, deflated. The planes hold zigzag-coded
        differences between successive vertices.
    max_error_mm : float
        No vertex of any face with weights within the limits is off by more than this.
    """

    steps: NDArray[np.float32]
    rows: list[list[bytes]]
    max_error_mm: float


def compress_core(
    core_rows: NDArray[np.float32],
    identity_limits: NDArray[np.float64],
    expression_limits: NDArray[np.float64],
    max_error_mm: float,
) -> CompressedCore:
    r"""Compress a core so that every face with |w_id| and |w_exp| within limits is exact to `max_error_mm`.

    A face's error is :math:`\sum_{ie} w_i w_e \delta_{ie}`, so components with large weights get small steps and all
    contribute alike. The returned bound is computed from the actual rounding errors, as the largest vertex distance
    of :math:`\sum_{ie} \hat w_i \hat w_e |\delta_{ie}|`, and holds for all weights within the limits at once.

    Parameters
    ----------
    core_rows : ndarray of shape (I, E, V, 3), float32, millimetres
    identity_limits, expression_limits : ndarray of shape (I,) and (E,)
        Largest absolute weights.
    max_error_mm : float

    Raises
    ------
    ValueRangeError
        If the bound cannot be met in float32 (the error asked for is below about 1e-4 mm).
    """
    if not max_error_mm > 0:
        raise ValueRangeError(f"max_error_mm must be positive, got {max_error_mm}.")
    weights = np.outer(identity_limits, expression_limits)
    weights = np.maximum(weights, 1e-6 * weights.max())
    # A coordinate's rounding error is on average a quarter of the step; a vertex has three coordinates.
    steps = (4 / np.sqrt(3) * max_error_mm / (weights.size * weights)).astype(np.float32)
    for _ in range(8):
        bound = _error_bound(core_rows, steps, weights)
        if bound <= max_error_mm:
            break
        steps *= np.float32(0.98 * max_error_mm / bound)
    else:
        raise ValueRangeError(f"max_error_mm must be reachable in float32, got {max_error_mm}.")
    with ThreadPoolExecutor(_THREADS) as pool:
        rows = list(pool.map(_compress_row, core_rows, steps))
    return CompressedCore(steps, rows, bound)


def decompress_core(
    steps: NDArray[np.float32], rows: Sequence[Sequence[Any]], n_vertices: int, source: str
) -> NDArray[np.float32]:
    """Return the core (I, E, V, 3) of `compress_core`; sizes are checked before the array is made.

    Raises
    ------
    FileFormatError
        If the planes do not hold what the sizes promise; the message names `source`.
    """
    I, E = steps.shape
    n_values = E * n_vertices * 3
    for number, planes in enumerate(rows):
        if len(planes) not in (2, 4) or any(n_values > _MAX_DEFLATE_RATIO * len(plane) for plane in planes):
            raise FileFormatError(
                f"{source} is corrupt: component {number} cannot hold {E} x {n_vertices} vertices; build it again, "
                "or fetch another copy."
            )
    core = np.empty((I, E, n_vertices, 3), dtype=np.float32)

    def fill(number: int) -> None:
        _decompress_row(rows[number], steps[number], core[number], f"{source}, component {number},")

    with ThreadPoolExecutor(_THREADS) as pool:
        list(pool.map(fill, range(I)))
    return core


def _quantise(row: NDArray[np.float32], step: NDArray[np.float32]) -> NDArray[np.int32]:
    return np.rint(row / step[:, None, None]).astype(np.int32)


def _error_bound(core_rows: NDArray[np.float32], steps: NDArray[np.float32], weights: NDArray[np.float64]) -> float:
    total = np.zeros(core_rows.shape[2:])
    for row, step, weight in zip(core_rows, steps, weights):
        if not np.abs(row / step[:, None, None]).max() < 2.0**30:  # also if NaN
            raise ValueRangeError("max_error_mm is too small for float32, or the core is not finite.")
        decoded = _quantise(row, step).astype(np.float32) * step[:, None, None]
        total += np.tensordot(weight, np.abs(row - decoded), 1)
    return float(np.linalg.norm(total, axis=-1).max())


def _compress_row(row: NDArray[np.float32], step: NDArray[np.float32]) -> list[bytes]:
    q = _quantise(row, step)
    width = 2 if np.abs(q).max() < 2**15 else 4
    q = q.astype(f"<i{width}")
    # Neighbours in the vertex order are mostly neighbours on the face; differences wrap around and so does their sum.
    difference = np.diff(q, axis=1, prepend=q.dtype.type(0))
    zigzag = (difference << 1) ^ (difference >> (8 * width - 1))  # small magnitudes to small codes
    planes = zigzag.reshape(-1).view(np.uint8).reshape(-1, width)
    return [_deflate(np.ascontiguousarray(planes[:, k]).tobytes()) for k in range(width)]


def _deflate(data: bytes) -> bytes:
    """Deflate with runs and Huffman codes only.

    Longer matches in rounding noise are spurious; measured against levels 1 and 6: smaller and faster both ways.
    """
    packer = zlib.compressobj(6, zlib.DEFLATED, 15, 9, zlib.Z_RLE)
    return packer.compress(data) + packer.flush()


def _decompress_row(planes: Sequence[Any], step: NDArray[np.float32], out: NDArray[np.float32], label: str) -> None:
    width = len(planes)
    code = np.empty((out.size, width), dtype=np.uint8)
    for k, plane in enumerate(planes):
        try:
            inflater = zlib.decompressobj()
            values = inflater.decompress(plane, out.size + 1)
        except zlib.error as error:
            raise FileFormatError(f"{label} is corrupt: {error}; build it again, or fetch another copy.") from error
        if len(values) != out.size:
            raise FileFormatError(f"{label} is corrupt: expected {out.size} values, got {len(values)}.")
        code[:, k] = np.frombuffer(values, dtype=np.uint8)
    zigzag = code.reshape(-1).view(f"<u{width}")
    difference = ((zigzag >> 1) ^ -(zigzag & 1)).view(f"<i{width}").reshape(out.shape)
    q = np.cumsum(difference, axis=1, dtype=difference.dtype)
    np.multiply(q, step[:, None, None], out=out, casting="unsafe", dtype=np.float32)
