"""Bicubic look-up of a picture at places between its pixels: the inner loop of every warp."""

from __future__ import annotations

from typing import Any

import numpy as np
from numba import njit, types
from numba.extending import overload
from numpy.typing import NDArray

from facewright.errors import ShapeError, ValueRangeError
from facewright.numeric.check import check_shape


def resample(
    image: NDArray[Any],
    x: NDArray[np.floating],
    y: NDArray[np.floating],
    *,
    where: NDArray[np.bool_] | None = None,
    out: NDArray[Any] | None = None,
) -> NDArray[Any]:
    """Look a picture up at places between its pixels by cubic convolution.

    At whole pixels the result is the picture's own value to the last bit. Beyond the border the border's pixels go on.

    Parameters
    ----------
    image : ndarray of shape (H, W) or (H, W, C), uint8 or float32
        The picture. Other float types are read as float32.
    x, y : ndarray of any shape (...), pixels
        Where to look: x to the right, y down, the centre of the first pixel is (0, 0).
    where : ndarray of shape (...), bool, optional
        Look only here; the rest of `out` stays as it is.
    out : ndarray of shape (...) or (..., C), optional
        C-contiguous array of the result's type to write to; zeros where absent.

    Returns
    -------
    ndarray of shape (...) or (..., C), uint8 or float32
        The values, of the picture's type: uint8 is rounded and clipped to [0, 255], float32 may overshoot a little
        beside edges. `out` itself where given.

    Raises
    ------
    ShapeError
        If `image` is neither (H, W) nor (H, W, C), is empty, or `y`, `where` or `out` do not match `x`.
    ValueRangeError
        If a place to look at is NaN, or `out` has another type or layout.

    Notes
    -----
    Cubic convolution with a = -1/2 [1]_ reproduces polynomials of degree two. It does not smooth: where the map shrinks
    the picture to less than about half its size, fine texture aliases.

    References
    ----------
    .. [1] Keys, IEEE Trans. ASSP 29(6), 1981, doi:10.1109/TASSP.1981.1163711.

    Examples
    --------
    >>> ramp = np.arange(8, dtype=np.float32)[None].repeat(8, axis=0)
    >>> float(resample(ramp, np.array(2.25), np.array(3.5)))
    2.25
    """
    pixels = np.asarray(image)
    if pixels.ndim not in (2, 3) or pixels.size == 0:
        raise ShapeError(f"image must have shape (H, W) or (H, W, C) and hold pixels, got {pixels.shape}.")
    if pixels.dtype != np.uint8:
        pixels = np.asarray(pixels, dtype=np.float32)
    x, y = np.asarray(x), np.asarray(y)
    shape = x.shape
    check_shape("y", y, *shape)
    values = shape + pixels.shape[2:]
    if out is None:
        out = np.zeros(values, pixels.dtype)
    else:
        check_shape("out", out, *values)
        if out.dtype != pixels.dtype or not out.flags.c_contiguous:
            layout = "contiguous" if out.flags.c_contiguous else "strided"
            raise ValueRangeError(f"out must be contiguous {pixels.dtype}, got {layout} {out.dtype}.")
    if where is None:
        mask = np.ones(1, np.bool_)
    else:
        check_shape("where", where, *shape)
        mask = np.ascontiguousarray(where, dtype=np.bool_).ravel()
    channels = pixels.shape[2] if pixels.ndim == 3 else 1
    bad = _resample(
        np.ascontiguousarray(pixels).reshape(*pixels.shape[:2], channels),
        np.ascontiguousarray(x, dtype=np.float32).ravel(),
        np.ascontiguousarray(y, dtype=np.float32).ravel(),
        mask,
        where is None,
        out.reshape(-1, channels),
    )
    if bad:
        raise ValueRangeError(f"x and y must be numbers, got {bad} places of {x.size} that are NaN.")
    return out


def resample_displaced(
    image: NDArray[Any], displacement: NDArray[np.floating], origin: tuple[int, int] = (0, 0)
) -> tuple[NDArray[np.uint8], NDArray[np.bool_]]:
    """Return the part of a picture whose pixel p is the picture's at p + displacement(p), bicubic as `resample`.

    Parameters
    ----------
    image : ndarray of shape (H, W, 3), uint8 or float32
        The picture, in [0, 255]. float32 is a third faster, for who draws the same picture many times.
    displacement : ndarray of shape (h, w, 2), pixels
        In x and y. Pixels where it is exactly zero keep their bits.
    origin : (x, y)
        Where the part begins in the picture.

    Returns
    -------
    part : ndarray of shape (h, w, 3), uint8
        Beyond the picture's border its border's pixels go on.
    moved : ndarray of shape (h, w), bool
        Where the displacement is not zero.

    Raises
    ------
    ShapeError
        If shapes do not match.
    ValueRangeError
        If the part leaves the picture, or a displacement is NaN.
    """
    sizes = check_shape("image", image, "H", "W", 3)
    found = check_shape("displacement", displacement, "h", "w", 2)
    pixels = np.ascontiguousarray(image, dtype=None if image.dtype == np.uint8 else np.float32)
    (x, y), h, w = origin, found["h"], found["w"]
    if x < 0 or y < 0 or x + w > sizes["W"] or y + h > sizes["H"]:
        raise ValueRangeError(
            f"the part must lie in the picture of {sizes['W']} x {sizes['H']} pixels, "
            f"got {w} x {h} pixels at ({x}, {y})."
        )
    part, moved = np.empty((h, w, 3), np.uint8), np.empty((h, w), np.bool_)
    steps = np.ascontiguousarray(displacement, dtype=np.float32)
    bad = _resample_displaced(pixels, steps, np.uint64(x), np.uint64(y), part, moved)
    if bad:
        raise ValueRangeError(f"displacement must hold numbers, got NaN at {bad} of {h * w} pixels.")
    return part, moved


@njit(cache=True, nogil=True, inline="always")
def _cubic(t):  # type: ignore[no-untyped-def]
    """Weights of the pixels at -1, 0, 1, 2 for the place t in [0, 1): Keys, eq. (15)."""
    half, two, three, four, five = np.float32(0.5), np.float32(2), np.float32(3), np.float32(4), np.float32(5)
    t2 = t * t
    t3 = t2 * t
    return (
        half * (two * t2 - t3 - t),
        np.float32(1) + half * (three * t3 - five * t2),
        half * (four * t2 - three * t3 + t),
        half * (t3 - t2),
    )


@njit(cache=True, nogil=True, inline="always")
def _neighbours(place, size):  # type: ignore[no-untyped-def]
    """Return the four indices round a place, repeated at the border, and the place's fraction."""
    # unsigned: no test for indices that count from the end
    i1 = np.uint64(place)
    i0 = np.uint64(max(i1, np.uint64(1)) - np.uint64(1))
    last = np.uint64(size - 1)
    i2, i3 = min(np.uint64(i1 + np.uint64(1)), last), min(np.uint64(i1 + np.uint64(2)), last)
    return i0, i1, i2, i3, place - np.float32(i1)


@njit(cache=True, nogil=True, inline="always")
def _sample(image, x0, x1, x2, x3, y0, y1, y2, y3, a, b, c):  # type: ignore[no-untyped-def]
    """Weigh 4 x 4 pixels of channel c."""
    top = a[0] * image[y0, x0, c] + a[1] * image[y0, x1, c] + a[2] * image[y0, x2, c] + a[3] * image[y0, x3, c]
    upper = a[0] * image[y1, x0, c] + a[1] * image[y1, x1, c] + a[2] * image[y1, x2, c] + a[3] * image[y1, x3, c]
    lower = a[0] * image[y2, x0, c] + a[1] * image[y2, x1, c] + a[2] * image[y2, x2, c] + a[3] * image[y2, x3, c]
    bottom = a[0] * image[y3, x0, c] + a[1] * image[y3, x1, c] + a[2] * image[y3, x2, c] + a[3] * image[y3, x3, c]
    return b[0] * top + b[1] * upper + b[2] * lower + b[3] * bottom


@njit(cache=True, nogil=True)
def _resample(image, x, y, where, everywhere, out):  # type: ignore[no-untyped-def]
    height, width, channels = image.shape
    zero, right, bottom = np.float32(0), np.float32(width - 1), np.float32(height - 1)
    bad = 0
    for i in range(x.size):
        if not (everywhere or where[i]):
            continue
        if np.isnan(x[i]) or np.isnan(y[i]):
            bad += 1
            continue
        x0, x1, x2, x3, tx = _neighbours(min(max(x[i], zero), right), width)
        y0, y1, y2, y3, ty = _neighbours(min(max(y[i], zero), bottom), height)
        a, b = _cubic(tx), _cubic(ty)
        if channels == 3:  # a count known to the compiler is faster
            for c in range(3):
                _store(out, i, c, _sample(image, x0, x1, x2, x3, y0, y1, y2, y3, a, b, np.uint64(c)))
        else:
            for c in range(channels):
                _store(out, i, c, _sample(image, x0, x1, x2, x3, y0, y1, y2, y3, a, b, np.uint64(c)))
    return bad


@njit(cache=True, nogil=True)
def _resample_displaced(image, displacement, left, top, out, moved):  # type: ignore[no-untyped-def]
    height, width, _ = image.shape
    zero, right, bottom = np.float32(0), np.float32(width - 1), np.float32(height - 1)
    half, white = np.float32(0.5), np.float32(255)
    bad = 0
    for y in range(np.uint64(moved.shape[0])):
        for x in range(np.uint64(moved.shape[1])):
            dx, dy = displacement[y, x, 0], displacement[y, x, 1]
            at_x, at_y = np.uint64(left + x), np.uint64(top + y)
            moved[y, x] = dx != zero or dy != zero
            if not moved[y, x]:
                for c in range(3):
                    out[y, x, c] = np.int32(image[at_y, at_x, np.uint64(c)])
                continue
            px, py = np.float32(at_x) + dx, np.float32(at_y) + dy
            if np.isnan(px) or np.isnan(py):
                bad += 1
                continue
            x0, x1, x2, x3, tx = _neighbours(min(max(px, zero), right), width)
            y0, y1, y2, y3, ty = _neighbours(min(max(py, zero), bottom), height)
            a, b = _cubic(tx), _cubic(ty)
            for c in range(3):
                value = _sample(image, x0, x1, x2, x3, y0, y1, y2, y3, a, b, np.uint64(c))
                out[y, x, c] = np.int32(min(max(value + half, zero), white))
    return bad


def _store(out, i, c, value):  # type: ignore[no-untyped-def]
    """Write a value to out[i, c]; rounded and clipped where `out` holds bytes."""
    out[i, c] = min(max(int(value + 0.5), 0), 255) if out.dtype == np.uint8 else value


@overload(_store, inline="always")
def _store_by_type(out, i, c, value):  # type: ignore[no-untyped-def]
    if out.dtype == types.uint8:

        def store(out, i, c, value):  # type: ignore[no-untyped-def]
            out[i, c] = np.int32(min(max(value + np.float32(0.5), np.float32(0)), np.float32(255)))

    else:

        def store(out, i, c, value):  # type: ignore[no-untyped-def]
            out[i, c] = value

    return store
