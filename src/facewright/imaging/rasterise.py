"""A z-buffer on the CPU: which triangle each pixel sees, and where in it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numba import njit
from numpy.typing import NDArray

from facewright.numeric.check import check_finite, check_indices, check_shape


@dataclass(frozen=True, eq=False)
class Fragments:
    """What every pixel of a picture sees.

    Parameters
    ----------
    face_index : ndarray of shape (H, W), int32
        Row of the nearest triangle; -1 where the pixel sees none.
    barycentric : ndarray of shape (H, W, 3), float32
        Weights of the triangle's corners at the pixel centre (perspective-correct); 0 where it sees none.
    depth : ndarray of shape (H, W), float32, millimetres
        Depth at the pixel centre; infinity where it sees none.
    """

    face_index: NDArray[np.int32]
    barycentric: NDArray[np.float32]
    depth: NDArray[np.float32]

    @property
    def covered(self) -> NDArray[np.bool_]:
        """Pixels that see a triangle, shape (H, W)."""
        return self.face_index >= 0

    def interpolate(self, faces: NDArray[np.integer], attributes: NDArray[np.floating]) -> NDArray[np.float32]:
        """Interpolate vertex attributes (V, C), or corner attributes through their own `faces`, to (H, W, C).

        Pixels that see no triangle get 0.
        """
        check_shape("attributes", attributes, "V", "C")
        check_shape("faces", faces, "F", 3)
        return _interpolate(
            self.face_index,
            self.barycentric,
            np.ascontiguousarray(faces, dtype=np.int32),
            np.ascontiguousarray(attributes, dtype=np.float32),
        )


def rasterise(
    pixels: NDArray[np.floating],
    depth: NDArray[np.floating],
    faces: NDArray[np.integer],
    size: tuple[int, int],
    *,
    perspective: bool = True,
    cull_back_faces: bool = False,
) -> Fragments:
    """Find the nearest triangle at every pixel centre.

    Parameters
    ----------
    pixels : ndarray of shape (V, 2), pixels
        Projected vertices; x right, y down, the centre of the first pixel is (0, 0).
    depth : ndarray of shape (V,), millimetres
        Distance along the optical axis; smaller is nearer. With `perspective`, triangles with a corner at depth <= 0
        are skipped.
    faces : ndarray of shape (F, 3)
        Triangles, counter-clockwise seen from outside (clockwise on screen, whose y points down).
    size : (height, width)
        Size of the picture in pixels.
    perspective : bool
        Interpolate 1/depth (pinhole) rather than depth (weak perspective).
    cull_back_faces : bool
        Skip triangles that are seen from behind.

    Returns
    -------
    Fragments
        Triangle, barycentric weights and depth for every pixel.

    Raises
    ------
    ShapeError, ValueRangeError
        If shapes do not match, a coordinate is not finite or an index is out of range.
    """
    sizes = check_shape("pixels", pixels, "V", 2)
    check_shape("depth", depth, "V", **sizes)
    check_shape("faces", faces, "F", 3)
    check_indices("faces", faces, sizes["V"])
    check_finite("pixels", pixels)
    check_finite("depth", depth)
    height, width = int(size[0]), int(size[1])
    return Fragments(
        *_rasterise(
            np.ascontiguousarray(pixels, dtype=np.float64),
            np.ascontiguousarray(depth, dtype=np.float64),
            np.ascontiguousarray(faces, dtype=np.int32),
            height,
            width,
            perspective,
            cull_back_faces,
        )
    )


# A weight this close to constant along a row (per pixel) never ends the row's span: the inside test decides instead.
_FLAT = 1e-7
# Pixels by which a row's span is widened before the inside test; more than the test's tolerance 1e-9 / _FLAT.
_MARGIN = 0.02


@njit(cache=True, nogil=True, fastmath=False)
def _rasterise(pixels, depth, faces, height, width, perspective, cull):  # type: ignore[no-untyped-def]
    face_index = np.full((height, width), -1, np.int32)
    barycentric = np.zeros((height, width, 3), np.float32)
    nearest = np.full((height, width), np.inf, np.float32)
    for f in range(faces.shape[0]):
        # unsigned here and below: no test for indices that count from the end
        a, b, c = np.uint32(faces[f, 0]), np.uint32(faces[f, 1]), np.uint32(faces[f, 2])
        ax, ay = pixels[a, 0], pixels[a, 1]
        bx, by = pixels[b, 0], pixels[b, 1]
        cx, cy = pixels[c, 0], pixels[c, 1]
        # clipped before they become integers: corners may lie anywhere
        x0 = int(np.ceil(min(max(min(ax, bx, cx), 0.0), width)))
        x1 = int(np.floor(max(min(max(ax, bx, cx), width - 1.0), -1.0)))
        y0 = int(np.ceil(min(max(min(ay, by, cy), 0.0), height)))
        y1 = int(np.floor(max(min(max(ay, by, cy), height - 1.0), -1.0)))
        if x0 > x1 or y0 > y1:
            continue  # before anything else: most triangles of a small face hold no pixel's centre
        area = (bx - ax) * (cy - ay) - (by - ay) * (cx - ax)
        # y points down, so that a triangle seen from outside has negative area
        if not 1e-30 < abs(area) < 1e30 or (cull and area > 0.0):
            continue
        za, zb, zc = depth[a], depth[b], depth[c]
        if perspective:
            if za <= 0.0 or zb <= 0.0 or zc <= 0.0:
                continue
            # 1/depth is affine on the screen, as depth is without perspective
            za, zb, zc = 1.0 / za, 1.0 / zb, 1.0 / zc
        inv = 1.0 / area
        # weights are affine in x and y: step them along the row
        wa_dx, wb_dx = (by - cy) * inv, (cy - ay) * inv
        a_zero, b_zero, c_zero = _pixels_to_zero(wa_dx), _pixels_to_zero(wb_dx), _pixels_to_zero(-wa_dx - wb_dx)
        for y in range(np.uint64(y0), np.uint64(y1 + 1)):
            wa = ((bx - x0) * (cy - y) - (by - y) * (cx - x0)) * inv
            wb = ((cx - x0) * (ay - y) - (cy - y) * (ax - x0)) * inv
            first, last = _row_span(wa * a_zero, wb * b_zero, (1.0 - wa - wb) * c_zero, a_zero, b_zero, c_zero, x1 - x0)
            wa += first * wa_dx
            wb += first * wb_dx
            for x in range(np.uint64(x0 + first), np.uint64(x0 + last + 1)):
                wc = 1.0 - wa - wb
                if min(wa, wb, wc) >= -1e-9:
                    z = wa * za + wb * zb + wc * zc
                    if perspective:
                        z = 1.0 / z
                    if z < nearest[y, x]:
                        nearest[y, x] = z
                        face_index[y, x] = f
                        if perspective:
                            barycentric[y, x, 0] = wa * za * z
                            barycentric[y, x, 1] = wb * zb * z
                            barycentric[y, x, 2] = wc * zc * z
                        else:
                            barycentric[y, x, 0] = wa
                            barycentric[y, x, 1] = wb
                            barycentric[y, x, 2] = wc
                wa += wa_dx
                wb += wb_dx
    return face_index, barycentric, nearest


@njit(cache=True, nogil=True, inline="always")
def _pixels_to_zero(step):  # type: ignore[no-untyped-def]
    """Return the pixels along a row that take a weight of 1 to zero; 0 for a weight that hardly changes."""
    return -1.0 / step if abs(step) > _FLAT else 0.0


@njit(cache=True, nogil=True, inline="always")
def _row_span(a, b, c, a_zero, b_zero, c_zero, last):  # type: ignore[no-untyped-def]
    """Return the first and the last of a row's pixels 0..last that may lie inside; a, b, c: where each weight is 0."""
    # a weight that rises along the row (negative *_zero) opens the span where it is 0, one that falls closes it
    end = float(last)
    opens = max(0.0, a if a_zero < 0.0 else 0.0, b if b_zero < 0.0 else 0.0, c if c_zero < 0.0 else 0.0)
    closes = min(end, a if a_zero > 0.0 else end, b if b_zero > 0.0 else end, c if c_zero > 0.0 else end)
    return int(min(opens, end + 1.0) + (1.0 - _MARGIN)), int(closes + _MARGIN) if closes > -_MARGIN else -1


@njit(cache=True, nogil=True)
def _interpolate(face_index, barycentric, faces, attributes):  # type: ignore[no-untyped-def]
    height, width = face_index.shape
    channels = attributes.shape[1]
    out = np.zeros((height, width, channels), np.float32)
    for y in range(height):
        for x in range(width):
            if face_index[y, x] < 0:
                continue
            f = np.uint32(face_index[y, x])
            a, b, c = np.uint32(faces[f, 0]), np.uint32(faces[f, 1]), np.uint32(faces[f, 2])
            wa, wb, wc = barycentric[y, x, 0], barycentric[y, x, 1], barycentric[y, x, 2]
            if channels == 3:  # a count known to the compiler is twice as fast
                for k in range(3):
                    out[y, x, k] = wa * attributes[a, k] + wb * attributes[b, k] + wc * attributes[c, k]
            else:
                for k in range(channels):
                    out[y, x, k] = wa * attributes[a, k] + wb * attributes[b, k] + wc * attributes[c, k]
    return out
