"""Pictures whose pixels are blocks of a larger one: its means, and the larger one's pixels from them."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from facewright.imaging.wide_blur import block_means

_STRIP = 512  # rows, about, that are read at once


def enlarge(
    small: NDArray[np.floating], n: int, size: tuple[int, ...], rows: slice | None = None
) -> NDArray[np.float32]:
    """Interpolate linearly between the middles of blocks of n x n pixels.

    Parameters
    ----------
    small : ndarray of shape (h, w, C)
        One value a block.
    n : int
        Pixels along a block's side.
    size : (height, width)
        Of the larger picture: at most (n h, n w).
    rows : slice, optional
        Only these rows of it, all where absent.

    Returns
    -------
    ndarray of shape (height, width, C) or as many rows, float32
    """
    first, last = (0, size[0]) if rows is None else (rows.start, rows.stop)
    y = np.clip((np.arange(first, last) + 0.5) / n - 0.5, 0, small.shape[0] - 1)
    x = np.clip((np.arange(size[1]) + 0.5) / n - 0.5, 0, small.shape[1] - 1)
    i, j = y.astype(int), x.astype(int)
    v, u = (y - i).astype(np.float32)[:, None, None], (x - j).astype(np.float32)[None, :, None]
    k, m = np.minimum(i + 1, small.shape[0] - 1), np.minimum(j + 1, small.shape[1] - 1)
    low = np.asarray(small, np.float32)
    lines = low[i] + v * (low[k] - low[i])
    return np.asarray(lines[:, j] + u * (lines[:, m] - lines[:, j]), dtype=np.float32)


def masked_means(
    picture: NDArray[np.generic], mask: NDArray[np.bool_] | None, n: int
) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """Return the means of a mask's pixels over blocks of n x n pixels, and the mask's share of each.

    Parameters
    ----------
    picture : ndarray of shape (H, W, C)
        Any type; the last blocks are smaller where the size is no multiple of n.
    mask : ndarray of shape (H, W), bool, or None
        None for all pixels.
    n : int
        Pixels along a block's side.

    Returns
    -------
    means : ndarray of shape (h, w, C), float32
        Zero where a block has no pixel of the mask.
    share : ndarray of shape (h, w), float32
    """
    means, shares = [], []
    step = max(_STRIP // n, 1) * n
    for top in range(0, len(picture), step):
        part = picture[top : top + step].astype(np.float32)
        if mask is None:
            means.append(block_means(part, n))
            shares.append(np.ones(means[-1].shape[:2], np.float32))
            continue
        inside = mask[top : top + step].astype(np.float32)
        shares.append(block_means(inside, n))
        means.append(block_means(part * inside[..., None], n) / np.maximum(shares[-1], 1e-6)[..., None])
    return np.concatenate(means), np.concatenate(shares)
