"""Poisson's equation on the pixels of a mask: conjugate gradients, preconditioned by a multigrid cycle."""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor
from typing import Any

import numpy as np
from numba import njit
from numpy.typing import NDArray

from facewright.errors import DegenerateError
from facewright.numeric.check import check_shape

_Grid = tuple[NDArray[np.float32], NDArray[np.float32]]

#: Below this size a level is solved by relaxation alone.
_COARSEST = 8
#: Smaller masks are solved in one thread.
_WORTH_THREADS = 40_000
_MAX_ITERATIONS = 80


def solve_poisson(
    values: NDArray[np.floating],
    unknown: NDArray[np.bool_],
    *,
    source: NDArray[np.floating] | None = None,
    free: NDArray[np.bool_] | None = None,
    tolerance: float = 1e-4,
) -> NDArray[np.float32]:
    r"""Fill the pixels of a mask so that each is the mean of its neighbours, or departs from it by a given amount.

    Solves :math:`\sum_j (u_i - u_j) = s_i` for every pixel i of the mask, where j runs over the (up to four) neighbours
    that lie in the picture and are not `free`. Known neighbours keep their value (Dirichlet), the picture's border and
    free pixels let it float (Neumann).

    Parameters
    ----------
    values : ndarray of shape (H, W, C)
        Known values; what it holds inside the mask is not read.
    unknown : ndarray of shape (H, W), bool
        The mask.
    source : ndarray of shape (H, W, C), optional
        s; zero where absent (a membrane stretched over the mask). Only read inside the mask.
    free : ndarray of shape (H, W), bool, optional
        Known pixels that shall not pull at the mask.
    tolerance : float
        Relative error, in the energy norm, at which to stop.

    Returns
    -------
    ndarray of shape (H, W, C), float32
        `values` outside the mask, the solution inside.

    Raises
    ------
    ShapeError
        If shapes do not match.
    DegenerateError
        If no known pixel touches the mask, so that the values have no level.

    Notes
    -----
    The grid hierarchy is that of [1]_: a coarse cell is known if any of its four cells is, and part of the mask if any
    of them is and none is known. Cost is linear in the size of the mask's bounding box.

    References
    ----------
    .. [1] McAdams, Sifakis, Teran, A parallel multigrid Poisson solver for fluids simulation on large grids, SCA 2010.
    """
    sizes = check_shape("values", values, "H", "W", "C")
    check_shape("unknown", unknown, "H", "W", **sizes)
    if source is not None:
        check_shape("source", source, "H", "W", "C", **sizes)
    if free is not None:
        check_shape("free", free, "H", "W", **sizes)
    out = np.array(values, dtype=np.float32)
    mask = np.asarray(unknown, dtype=np.bool_)
    if not mask.any():
        return out
    box = mask_box(mask)
    mask = mask[box]
    open_pixels = np.zeros_like(mask) if free is None else np.asarray(free[box], dtype=np.bool_) & ~mask
    held = ~mask & ~open_pixels
    if not (_neighbour_count(held)[mask] > 0).any():
        raise DegenerateError("unknown must leave a known, not free, pixel beside it to hold the values, got none.")
    levels = _hierarchy(mask, open_pixels)
    picture = out[box]

    def fill(channel: int) -> None:
        right = _right_hand_side(picture[..., channel], held, mask)
        if source is not None:
            right += np.where(mask, source[box][..., channel], 0.0).astype(np.float32)
        picture[..., channel][mask] = _conjugate_gradients(levels, right, tolerance)[mask]

    channels = range(sizes["C"])
    if mask.size > _WORTH_THREADS and len(channels) > 1:
        with ThreadPoolExecutor(2) as threads:
            list(threads.map(fill, channels))
    else:
        for channel in channels:
            fill(channel)
    return out


def mask_box(mask: NDArray[np.bool_]) -> tuple[slice, slice]:
    """Return the bounding box of a mask that is not empty, with one pixel around it where the picture goes on."""
    rows, columns = np.flatnonzero(mask.any(axis=1)), np.flatnonzero(mask.any(axis=0))
    return (
        slice(max(rows[0] - 1, 0), min(rows[-1] + 2, mask.shape[0])),
        slice(max(columns[0] - 1, 0), min(columns[-1] + 2, mask.shape[1])),
    )


def _neighbour_count(pixels: NDArray[np.bool_]) -> NDArray[np.float32]:
    """Count the neighbours of each pixel that are set."""
    padded = np.pad(pixels, 1).astype(np.float32)
    return padded[:-2, 1:-1] + padded[2:, 1:-1] + padded[1:-1, :-2] + padded[1:-1, 2:]


def _right_hand_side(
    values: NDArray[np.float32], held: NDArray[np.bool_], mask: NDArray[np.bool_]
) -> NDArray[np.float32]:
    """Sum the known neighbours of every pixel of the mask."""
    padded = np.pad(np.where(held, values, np.float32(0)), 1)
    total = padded[:-2, 1:-1] + padded[2:, 1:-1] + padded[1:-1, :-2] + padded[1:-1, 2:]
    return np.where(mask, total, np.float32(0))


def _hierarchy(mask: NDArray[np.bool_], outside: NDArray[np.bool_]) -> list[NDArray[np.float32]]:
    """Return, per level, the diagonal of the equations (0 where a cell is not unknown), with a rim of one cell."""
    levels = []
    while True:
        diagonal = np.where(mask, _neighbour_count(~outside), np.float32(0))
        levels.append(np.pad(diagonal, 1))
        if min(mask.shape) <= _COARSEST or not mask.any():
            return levels
        odd = [(0, n % 2) for n in mask.shape]
        mask, outside = np.pad(mask, odd), np.pad(outside, odd, constant_values=True)
        fours = (mask.shape[0] // 2, 2, mask.shape[1] // 2, 2)
        known = (~mask & ~outside).reshape(fours).any(axis=(1, 3))
        mask = mask.reshape(fours).any(axis=(1, 3)) & ~known
        outside = ~mask & ~known


def _conjugate_gradients(
    levels: list[NDArray[np.float32]], right: NDArray[np.float32], tolerance: float
) -> NDArray[np.float32]:
    """Solve for one channel; returns (H, W), zero outside the mask."""
    diagonal = levels[0]
    # the mean of what pulls at the mask is the start: a constant picture needs no iteration
    level = float(right.sum(dtype=np.float64)) / max(float(_known_pull(diagonal)), 1.0)
    solution = np.where(diagonal > 0, np.float32(level), np.float32(0))
    residual = np.pad(right, 1)
    product = np.zeros_like(residual)
    _apply_dot(diagonal, solution, product)
    residual -= product
    grids: list[_Grid] = [(np.zeros_like(d), np.zeros_like(d)) for d in levels]
    step = _cycle(levels, grids, residual, 0).copy()
    error = _dot(residual, step)
    target = tolerance * tolerance * error
    direction = step.copy()
    for _ in range(_MAX_ITERATIONS):
        if error <= target or error <= 0.0:
            break
        length = error / _apply_dot(diagonal, direction, product)
        _advance(solution, residual, direction, product, np.float32(length))
        step = _cycle(levels, grids, residual, 0)
        previous, error = error, _dot(residual, step)
        _turn(direction, step, np.float32(error / previous))
    return solution[1:-1, 1:-1]


def _known_pull(diagonal: NDArray[np.float32]) -> Any:
    """Count the pairs of an unknown and a known pixel."""
    inside = diagonal[1:-1, 1:-1] > 0
    return (diagonal[1:-1, 1:-1] - np.where(inside, _neighbour_count(inside), 0.0)).sum(dtype=np.float64)


def _cycle(
    levels: list[NDArray[np.float32]], grids: list[_Grid], right: NDArray[np.float32], level: int
) -> NDArray[np.float32]:
    """Approximate the solution by one symmetric V-cycle from zero; the result is overwritten by the next call."""
    diagonal, (first, second) = levels[level], grids[level]
    if level == len(levels) - 1:
        _relax_zero(diagonal, right, first, _WEIGHTS[0])
        for k in range(1, 16):
            _relax(diagonal, right, first, second, _WEIGHTS[k % 2])
            first, second = second, first
        return first
    _relax_zero(diagonal, right, first, _WEIGHTS[0])
    _relax(diagonal, right, first, second, _WEIGHTS[1])
    coarse_right = np.zeros_like(levels[level + 1])
    _residual(diagonal, right, second, first)
    _restrict(first, levels[level + 1], coarse_right)
    _prolong(_cycle(levels, grids, coarse_right, level + 1), diagonal, second)
    _relax(diagonal, right, second, first, _WEIGHTS[0])
    _relax(diagonal, right, first, second, _WEIGHTS[1])
    return second


#: Two Jacobi steps that damp the upper three quarters of the spectrum best (Chebyshev on [0.5, 2]).
_WEIGHTS = (np.float32(1 / (1.25 + 0.75 * np.sqrt(0.5))), np.float32(1 / (1.25 - 0.75 * np.sqrt(0.5))))


@njit(cache=True, nogil=True)
def _relax_zero(diagonal, right, out, weight):  # type: ignore[no-untyped-def]
    """Jacobi step from zero."""
    height, width = diagonal.shape
    for y in range(np.uint64(1), np.uint64(height - 1)):
        for x in range(np.uint64(1), np.uint64(width - 1)):
            d = diagonal[y, x]
            out[y, x] = weight * right[y, x] / max(d, np.float32(1)) if d > 0 else np.float32(0)


@njit(cache=True, nogil=True)
def _relax(diagonal, right, u, out, weight):  # type: ignore[no-untyped-def]
    """Jacobi step from `u` to `out`."""
    height, width = diagonal.shape
    one = np.uint64(1)
    for y in range(one, np.uint64(height - 1)):
        for x in range(one, np.uint64(width - 1)):
            d = diagonal[y, x]
            around = u[y - one, x] + u[y + one, x] + u[y, x - one] + u[y, x + one]
            step = weight * (right[y, x] + around - d * u[y, x]) / max(d, np.float32(1))
            out[y, x] = u[y, x] + step if d > 0 else np.float32(0)


@njit(cache=True, nogil=True)
def _residual(diagonal, right, u, out):  # type: ignore[no-untyped-def]
    height, width = diagonal.shape
    one = np.uint64(1)
    for y in range(one, np.uint64(height - 1)):
        for x in range(one, np.uint64(width - 1)):
            d = diagonal[y, x]
            around = u[y - one, x] + u[y + one, x] + u[y, x - one] + u[y, x + one]
            out[y, x] = right[y, x] + around - d * u[y, x] if d > 0 else np.float32(0)


@njit(cache=True, nogil=True, fastmath={"reassoc"})
def _apply_dot(diagonal, u, out):  # type: ignore[no-untyped-def]
    """Write A u and return u . A u; `u` must be 0 outside the mask."""
    height, width = diagonal.shape
    one = np.uint64(1)
    total = 0.0
    for y in range(one, np.uint64(height - 1)):
        row = np.float32(0)
        for x in range(one, np.uint64(width - 1)):
            d = diagonal[y, x]
            around = u[y - one, x] + u[y + one, x] + u[y, x - one] + u[y, x + one]
            value = d * u[y, x] - around if d > 0 else np.float32(0)
            out[y, x] = value
            row += value * u[y, x]
        total += float(row)
    return total


@njit(cache=True, nogil=True, fastmath={"reassoc"})
def _dot(a, b):  # type: ignore[no-untyped-def]
    total = 0.0
    for y in range(a.shape[0]):
        row = np.float32(0)
        for x in range(a.shape[1]):
            row += a[y, x] * b[y, x]
        total += float(row)
    return total


@njit(cache=True, nogil=True)
def _advance(solution, residual, direction, product, length):  # type: ignore[no-untyped-def]
    for y in range(solution.shape[0]):
        for x in range(solution.shape[1]):
            solution[y, x] += length * direction[y, x]
            residual[y, x] -= length * product[y, x]


@njit(cache=True, nogil=True)
def _turn(direction, step, ratio):  # type: ignore[no-untyped-def]
    for y in range(direction.shape[0]):
        for x in range(direction.shape[1]):
            direction[y, x] = step[y, x] + ratio * direction[y, x]


@njit(cache=True, nogil=True)
def _restrict(fine, coarse_diagonal, out):  # type: ignore[no-untyped-def]
    """Sum fine cells to coarse ones by the transpose of `_prolong`."""
    height, width = coarse_diagonal.shape
    fine_height, fine_width = fine.shape
    for y in range(1, height - 1):
        for x in range(1, width - 1):
            if coarse_diagonal[y, x] == 0:
                continue
            total = np.float32(0)
            # with the rim, the children of cell y are 2 y - 1 and 2 y
            for j in range(4):
                fine_y = np.uint64(min(2 * y - 2 + j, fine_height - 1))
                row = np.float32(0)
                for i in range(4):
                    fine_x = np.uint64(min(2 * x - 2 + i, fine_width - 1))
                    row += (np.float32(0.75) if i == 1 or i == 2 else np.float32(0.25)) * fine[fine_y, fine_x]
                total += (np.float32(0.75) if j == 1 or j == 2 else np.float32(0.25)) * row
            out[y, x] = total


@njit(cache=True, nogil=True)
def _prolong(coarse, diagonal, u):  # type: ignore[no-untyped-def]
    """Add the coarse solution, interpolated between cell centres, to `u` inside the mask."""
    height, width = diagonal.shape
    near, far = np.float32(0.75), np.float32(0.25)
    for y in range(1, height - 1):
        y0 = np.uint64((y + 1) // 2)
        y1 = np.uint64((y + 1) // 2 + (1 if y % 2 == 0 else -1))
        for x in range(1, width - 1):
            if diagonal[y, x] == 0:
                continue
            x0 = np.uint64((x + 1) // 2)
            x1 = np.uint64((x + 1) // 2 + (1 if x % 2 == 0 else -1))
            u[y, x] += near * (near * coarse[y0, x0] + far * coarse[y0, x1]) + far * (
                near * coarse[y1, x0] + far * coarse[y1, x1]
            )
