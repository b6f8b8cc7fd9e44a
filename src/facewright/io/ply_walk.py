"""Walking rows of differing length in binary PLY files: where each property of each row lies."""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray


@njit(cache=True)
def walk_rows(
    raw: NDArray[np.uint8],
    start: int,
    n_rows: int,
    sizes: NDArray[np.int64],
    is_list: NDArray[np.bool_],
    little_endian: bool,
) -> tuple[NDArray[np.int64], NDArray[np.int64], int]:
    """Find start and count of each property of each row.

    Parameters
    ----------
    raw : ndarray of shape (N,), uint8
        The file.
    start : int
        Position of the first row.
    n_rows : int
        Number of rows.
    sizes : ndarray of shape (P, 2), int64
        Bytes of a list's count and of one value, per property.
    is_list : ndarray of shape (P,), bool
        Whether the property is a list.
    little_endian : bool
        Byte order of the counts.

    Returns
    -------
    starts, counts : ndarray of shape (n_rows, P), int64
        Position of the first value and number of values.
    stop : int
        Position after the last row; -1 if the file ends before it.
    """
    P = len(is_list)
    starts = np.zeros((n_rows, P), dtype=np.int64)
    counts = np.ones((n_rows, P), dtype=np.int64)
    at = start
    for row in range(n_rows):
        for k in range(P):
            if is_list[k]:
                width = sizes[k, 0]
                if at + width > len(raw):
                    return starts, counts, -1
                count = np.int64(0)
                for byte in range(width):
                    place = byte if little_endian else width - 1 - byte
                    count += np.int64(raw[at + byte]) << (8 * place)
                counts[row, k] = count
                at += width
            starts[row, k] = at
            at += counts[row, k] * sizes[k, 1]
            if at > len(raw):
                return starts, counts, -1
    return starts, counts, at
