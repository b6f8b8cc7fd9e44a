"""Inner loop of the picture in two layers: the person, looked up elsewhere in the photo, over what lies behind."""

from __future__ import annotations

import numpy as np
from numba import njit

from facewright.imaging.resample import _cubic, _neighbours, _sample


@njit(cache=True, nogil=True)
def compose_layers(  # type: ignore[no-untyped-def]
    photo, displacement, origin, alpha, front, plate, state, hidden, trust, box, fade, out, moved, shares
):
    """Draw the part of a picture at `origin`, see `PhotoLayers.resample`.

    The person's light, looked up, and as much of the plate as their share, looked up, leaves. What both leave of the
    photo where nothing moves (edges are never known well) fades as the motion grows to `fade` pixels: there are no
    jumps. Pixels that see the background alone get the displacement zero. `shares` (h, w) uint8 gets the person's where
    something moves. Where `trust` (of the box, looked up) is less than 255 the photo as it bends takes the rest.
    """
    height, width, _ = photo.shape
    rows, cols = alpha.shape
    left, top = origin
    x_box, y_box = box
    zero, half, white = np.float32(0), np.float32(0.5), np.float32(255)
    right, bottom = np.float32(width - 1), np.float32(height - 1)
    scale = np.float32(1 / 255)
    value, bent = np.zeros(3, np.float32), np.zeros(3, np.float32)
    for y in range(moved.shape[0]):
        for x in range(moved.shape[1]):
            dx, dy = displacement[y, x, 0], displacement[y, x, 1]
            at_x, at_y = left + x, top + y
            if dx == zero and dy == zero:
                for c in range(3):
                    out[y, x, c] = np.int32(photo[at_y, at_x, c])
                continue
            px, py = min(max(at_x + dx, zero), right), min(max(at_y + dy, zero), bottom)
            x0, x1, x2, x3, tx = _neighbours(np.float32(px), width)
            y0, y1, y2, y3, ty = _neighbours(np.float32(py), height)
            u, v = at_x - x_box, at_y - y_box
            in_box = 0 <= u < cols and 0 <= v < rows
            i, j = np.int64(y1) - y_box, np.int64(x1) - x_box
            kind = state[i, j] if 0 <= i < rows and 0 <= j < cols else np.uint8(0)
            sure = scale * trust[min(max(i, 0), rows - 1), min(max(j, 0), cols - 1)]
            if sure == zero:
                kind = np.uint8(1)
            bends = kind != 1 and sure < np.float32(1)
            if bends:
                a, b = _cubic(tx), _cubic(ty)
                for c in range(3):
                    bent[c] = _sample(photo, x0, x1, x2, x3, y0, y1, y2, y3, a, b, np.uint64(c))
            if kind == 0:
                if sure > half:
                    displacement[y, x, 0] = zero
                    displacement[y, x, 1] = zero
                shares[y, x] = np.int32(white * (np.float32(1) - sure) + half)
                if in_box and hidden[v, u]:
                    moved[y, x] = True
                    still = _still(dx, dy, fade)
                    rest = np.float32(1) - scale * alpha[v, u]
                    for c in range(3):
                        behind = np.float32(plate[v, u, c])
                        left_over = photo[at_y, at_x, c] - front[v, u, c] - rest * behind
                        level = behind + still * left_over
                        if bends:
                            level = bent[c] + sure * (min(max(level, zero), white) - bent[c])
                        out[y, x, c] = np.int32(min(max(level + half, zero), white))
                elif bends:
                    moved[y, x] = True
                    for c in range(3):
                        level = bent[c] + sure * (photo[at_y, at_x, c] - bent[c])
                        out[y, x, c] = np.int32(min(max(level + half, zero), white))
                else:
                    for c in range(3):
                        out[y, x, c] = np.int32(photo[at_y, at_x, c])
                continue
            moved[y, x] = True
            a, b = _cubic(tx), _cubic(ty)
            if kind == 1:
                for c in range(3):
                    level = _sample(photo, x0, x1, x2, x3, y0, y1, y2, y3, a, b, np.uint64(c))
                    out[y, x, c] = np.int32(min(max(level + half, zero), white))
                continue
            share = zero
            value[:] = zero
            for k in range(4):
                row = np.int64(y0 if k == 0 else y1 if k == 1 else y2 if k == 2 else y3)
                for m in range(4):
                    col = np.int64(x0 if m == 0 else x1 if m == 1 else x2 if m == 2 else x3)
                    i, j = row - y_box, col - x_box
                    if not (0 <= i < rows and 0 <= j < cols):
                        continue
                    w = b[k] * a[m]
                    share += w * scale * alpha[i, j]
                    for c in range(3):
                        value[c] += w * front[i, j, c]
            rest = np.float32(1) - min(max(share, zero), np.float32(1))
            shares[y, x] = np.int32(white * (np.float32(1) - sure * rest) + half)
            known = in_box and hidden[v, u]
            still = _still(dx, dy, fade) if known else zero
            own = np.float32(1) - scale * alpha[v, u] if known else zero
            for c in range(3):
                behind = np.float32(plate[v, u, c]) if in_box else np.float32(photo[at_y, at_x, c])
                level = value[c] + rest * behind
                if known:
                    level += still * (photo[at_y, at_x, c] - front[v, u, c] - own * behind)
                if bends:
                    level = bent[c] + sure * (min(max(level, zero), white) - bent[c])
                out[y, x, c] = np.int32(min(max(level + half, zero), white))


@njit(cache=True, nogil=True, inline="always")
def _still(dx, dy, fade):  # type: ignore[no-untyped-def]
    """Return 1 where nothing moves, falling to 0 for motions of `fade` pixels."""
    t = min(np.float32(np.sqrt(dx * dx + dy * dy)) / fade, np.float32(1))
    return np.float32(1) - t * t * (np.float32(3) - np.float32(2) * t)
