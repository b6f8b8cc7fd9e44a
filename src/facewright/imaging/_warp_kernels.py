"""Inner loops of the warp: what the skin says, its composition with the field around it, the map's Jacobian."""

from __future__ import annotations

import numpy as np
from numba import njit

from facewright.imaging.source_surface import BODY, HEAD, INNER

_BODY, _HEAD, _INNER = np.uint8(BODY), np.uint8(HEAD), np.uint8(INNER)


@njit(cache=True, nogil=True)
def gather_skin(  # type: ignore[no-untyped-def]
    face_index,
    barycentric,
    origin,
    faces,
    kinds,
    attributes,
    outline,
    table,
    step,
    window,
    cells,
    far,
    firm,
    picture,
    band,
):
    """Look the skin of a target view up in the photo, and sum up per cell of the lattice what it says.

    `attributes` (V, 6): source x, y and `SourceSurface.weights`. `table`: origin x, y and scale of `outline`.
    `window`: first row and column, rows and columns of the lattice's part. `cells` (8, rows, columns): sums of head
    pixels, data weight, weighted x and y displacement, weight of the outline, whose displacement is added to the
    data's; data weight of the neck and its weighted displacement. Returns displacement (h, w, 2), blending weight
    (h, w) and kind (h, w; 0: none, or the neck) of each pixel. Skin that the border of the `picture` (height, width)
    cuts off, or within `band` pixels of it, says less: what lies beyond cannot be looked up.
    """
    height, width = face_index.shape
    motion = np.zeros((height, width, 2), np.float32)
    blend = np.zeros((height, width), np.float32)
    layer = np.zeros((height, width), np.uint8)
    for y in range(height):
        for x in range(width):
            f = face_index[y, x]
            if f >= 0 and kinds[f] != _BODY:
                layer[y, x] = kinds[f]
    t_rows, t_cols = outline.shape[:2]
    known = np.float32(1.5) * max(np.float32(1), 1 / table[2])
    for y in range(height):
        i = (y + origin[1]) // step - window[0]
        for x in range(width):
            f = face_index[y, x]
            if f < 0:
                continue
            a, b, c = faces[f, 0], faces[f, 1], faces[f, 2]
            wa, wb, wc = barycentric[y, x, 0], barycentric[y, x, 1], barycentric[y, x, 2]
            px, py = np.float32(x + origin[0]), np.float32(y + origin[1])
            sx = wa * attributes[a, 0] + wb * attributes[b, 0] + wc * attributes[c, 0]
            sy = wa * attributes[a, 1] + wb * attributes[b, 1] + wc * attributes[c, 1]
            j = (x + origin[0]) // step - window[1]
            data = wa * attributes[a, 3] + wb * attributes[b, 3] + wc * attributes[c, 3]
            if layer[y, x] == 0:
                part = wa * attributes[a, 5] + wb * attributes[b, 5] + wc * attributes[c, 5]
                cells[5, i, j] += data
                cells[6, i, j] += data * part * (sx - px)
                cells[7, i, j] += data * part * (sy - py)
                continue
            motion[y, x, 0], motion[y, x, 1] = sx - px, sy - py
            cells[0, i, j] += 1
            if layer[y, x] == _HEAD:
                edge = min(min(sx, picture[1] - 1 - sx), min(sy, picture[0] - 1 - sy)) / band
                edge = min(max(edge, np.float32(0)), np.float32(1))
                data *= edge
                blend[y, x] = edge * (wa * attributes[a, 2] + wb * attributes[b, 2] + wc * attributes[c, 2])
                cells[1, i, j] += data
                cells[2, i, j] += data * (sx - px)
                cells[3, i, j] += data * (sy - py)
            on_outline = (
                (x > 0 and layer[y, x - 1] == 0)
                or (x < width - 1 and layer[y, x + 1] == 0)
                or (y > 0 and layer[y - 1, x] == 0)
                or (y < height - 1 and layer[y + 1, x] == 0)
            )
            if on_outline:
                tx = min(max(int(np.rint((sx - table[0]) * table[2])), 0), t_cols - 1)
                ty = min(max(int(np.rint((sy - table[1]) * table[2])), 0), t_rows - 1)
                ex, ey = outline[ty, tx, 0], outline[ty, tx, 1]
                slide = (ex - sx) ** 2 + (ey - sy) ** 2
                away = slide / (far * far)
                # an outline is known to a pixel or an entry of its table: what stays on it does not slide
                t = min(max(np.sqrt(slide) / known - np.float32(0.5), np.float32(0)), np.float32(1))
                t *= t * (np.float32(3) - np.float32(2) * t)
                ex, ey = sx + t * (ex - sx), sy + t * (ey - sy)
                ends = wa * attributes[a, 4] + wb * attributes[b, 4] + wc * attributes[c, 4]
                weight = np.float32(np.exp(-away)) * firm * ends
                cells[4, i, j] += weight
                cells[2, i, j] += weight * (ex - px)
                cells[3, i, j] += weight * (ey - py)
    return motion, blend, layer


@njit(cache=True, nogil=True)
def spline_weights(step):  # type: ignore[no-untyped-def]
    """Return the cubic B-spline weights (step, 4) of each pixel of a cell, and where the four cells begin (step,)."""
    weights = np.zeros((step, 4), np.float32)
    first = np.zeros(step, np.int64)
    for p in range(step):
        at = (p + 0.5) / step - 0.5
        base = int(np.floor(at))
        t = at - base
        weights[p, 0] = (1 - t) ** 3 / 6
        weights[p, 1] = (3 * t**3 - 6 * t**2 + 4) / 6
        weights[p, 2] = (-3 * t**3 + 3 * t**2 + 3 * t + 1) / 6
        weights[p, 3] = t**3 / 6
        first[p] = base - 1
    return weights, first


@njit(cache=True, nogil=True)
def compose(field, solid, origin, size, window, step, motion, blend, inner_origin, least):  # type: ignore[no-untyped-def]
    """Blend the skin's own displacement into the field around it.

    `field` (2, rows, columns) and `solid` (rows, columns) on the lattice are interpolated by cubic B-splines; `solid`
    says how far inside the silhouette a pixel is. Displacements below `least` pixels become exactly 0. Returns the
    displacement (h, w, 2) of the picture's part at `origin` of `size`, and the weight that the skin's own had.
    """
    rows, cols = solid.shape
    height, width = size
    weights, first = spline_weights(step)
    out = np.zeros((height, width, 2), np.float32)
    share = np.zeros((height, width), np.float32)
    # two more cells on each side, so that no index needs a bound
    row = np.zeros((cols + 6, 3), np.float32)
    start = np.zeros(width, np.int64)
    phase = np.zeros((width, 4), np.float32)
    cell, within = origin[0] // step - window[1], origin[0] % step
    for x in range(width):
        start[x] = min(max(cell + first[within], -3), cols - 1) + 3
        phase[x] = weights[within]
        within += 1
        if within == step:
            cell, within = cell + 1, 0
    h, w = blend.shape
    tiny = least * least
    for y in range(height):
        gy = y + origin[1]
        py = gy % step
        i0 = gy // step - window[0] + first[py]
        a = weights[py]
        i = (min(max(i0, 0), rows - 1), min(max(i0 + 1, 0), rows - 1))
        k = (min(max(i0 + 2, 0), rows - 1), min(max(i0 + 3, 0), rows - 1))
        moving = False
        for j in range(cols):
            for c in range(2):
                value = a[0] * field[c, i[0], j] + a[1] * field[c, i[1], j]
                value += a[2] * field[c, k[0], j] + a[3] * field[c, k[1], j]
                row[j + 3, c] = value
                moving |= value != 0
            row[j + 3, 2] = (
                a[0] * solid[i[0], j] + a[1] * solid[i[1], j] + a[2] * solid[k[0], j] + a[3] * solid[k[1], j]
            )
        v = gy - inner_origin[1]
        inside = 0 <= v < h
        if not (moving or inside):
            continue
        for c in range(3):
            row[0, c] = row[1, c] = row[2, c] = row[3, c]
            row[cols + 3, c] = row[cols + 4, c] = row[cols + 5, c] = row[cols + 2, c]
        for x in range(width):
            n = np.uint64(start[x])
            p0, p1, p2, p3 = phase[x, 0], phase[x, 1], phase[x, 2], phase[x, 3]
            d0 = p0 * row[n, 0] + p1 * row[n + 1, 0] + p2 * row[n + 2, 0] + p3 * row[n + 3, 0]
            d1 = p0 * row[n, 1] + p1 * row[n + 1, 1] + p2 * row[n + 2, 1] + p3 * row[n + 3, 1]
            u = x + origin[0] - inner_origin[0]
            if inside and 0 <= u < w and blend[v, u] > 0:
                s = p0 * row[n, 2] + p1 * row[n + 1, 2] + p2 * row[n + 2, 2] + p3 * row[n + 3, 2]
                s = s * s * (np.float32(3) - np.float32(2) * s) * blend[v, u]
                d0 += s * (motion[v, u, 0] - d0)
                d1 += s * (motion[v, u, 1] - d1)
                share[y, x] = s
            size2 = d0 * d0 + d1 * d1
            if size2 > tiny:
                scale = np.float32(1)
                if size2 < np.float32(9) * tiny:
                    scale = (np.sqrt(size2) - least) / (np.float32(2) * least)
                out[y, x, 0] = d0 * scale
                out[y, x, 1] = d1 * scale
    return out, share


@njit(cache=True, nogil=True)
def mark_breaks(depth, layer, jump):  # type: ignore[no-untyped-def]
    """Mark the pixels at whose right or lower side one surface ends before another: true occlusions, (h, w) bool."""
    height, width = layer.shape
    out = np.zeros((height, width), np.bool_)
    for y in range(height):
        for x in range(width):
            if layer[y, x] == 0:
                continue
            if layer[y, x] == _INNER:
                out[y, x] = True
                if y > 0:
                    out[y - 1, x] = True
                if x > 0:
                    out[y, x - 1] = True
                if y > 0 and x > 0:
                    out[y - 1, x - 1] = True
                continue
            for k in range(3):
                v, u = y + (k > 0), x + (k != 1)
                if v < height and u < width and layer[v, u] != 0 and abs(depth[v, u] - depth[y, x]) > jump:
                    out[y, x] = True
    return out


@njit(cache=True, nogil=True)
def jacobian_minimum(displacement, breaks, offset, bad):  # type: ignore[no-untyped-def]
    """Return the smallest determinant over pixel cells without a break (1 where there is none), and how many fold.

    `bad` (h, w) gets how nearly folded each cell is: 0 for determinants above 0.2, 1 below 0.02.
    """
    height, width = displacement.shape[:2]
    h, w = breaks.shape
    one = np.float32(1)
    beyond = np.float32(1e30)
    least = beyond
    count = 0
    for y in range(height - 1):
        v = y - offset[1]
        for x in range(width - 1):
            dx = displacement[y, x, 0]
            dy = displacement[y, x, 1]
            xx = one + displacement[y, x + 1, 0] - dx
            xy = displacement[y, x + 1, 1] - dy
            yx = displacement[y + 1, x, 0] - dx
            yy = one + displacement[y + 1, x, 1] - dy
            det = xx * yy - xy * yx
            if det < least or det < np.float32(0.2):
                u = x - offset[0]
                if 0 <= v < h and 0 <= u < w and breaks[v, u]:
                    continue
                least = min(least, det)
                if det < np.float32(0.2):
                    bad[y, x] = min((np.float32(0.2) - det) / np.float32(0.18), one)
                    if det < np.float32(0.02):
                        count += 1
    return (least if least < beyond else one), count


@njit(cache=True, nogil=True)
def soften_breaks(image, touched, displacement, breaks, offset, jump):  # type: ignore[no-untyped-def]
    """Smooth, in place, the pixels of an edge where one surface hides another and the map jumps by `jump` pixels.

    The edge is decided per pixel; a binomial mean over 3 x 3 pixels takes its steps away. `touched` is set there.
    """
    height, width = displacement.shape[:2]
    h, w = breaks.shape
    marked = np.zeros((h, w), np.bool_)
    top, left, bottom, right = h, w, 0, 0
    for v in range(h):
        for u in range(w):
            y, x = v + offset[1], u + offset[0]
            if not breaks[v, u] or not (1 <= y < height - 2 and 1 <= x < width - 2 and v < h - 1 and u < w - 1):
                continue
            for k in range(2):
                b, a = y + k, x + 1 - k
                far = max(
                    abs(displacement[b, a, 0] - displacement[y, x, 0]),
                    abs(displacement[b, a, 1] - displacement[y, x, 1]),
                )
                if far > jump:
                    marked[v, u] = True
                    marked[v + k, u + 1 - k] = True
                    top, left, bottom, right = min(top, v), min(left, u), max(bottom, v + 2), max(right, u + 2)
    if bottom == 0:
        return
    y0, x0 = top + offset[1] - 1, left + offset[0] - 1
    before = image[y0 : bottom + offset[1] + 1, x0 : right + offset[0] + 1].copy()
    for v in range(top, bottom):
        for u in range(left, right):
            if not marked[v, u]:
                continue
            y, x = v + offset[1] - y0, u + offset[0] - x0
            touched[y + y0, x + x0] = True
            for c in range(3):
                total = np.int64(0)
                for k in range(3):
                    row = (
                        np.int64(before[y - 1 + k, x - 1, c])
                        + 2 * np.int64(before[y - 1 + k, x, c])
                        + np.int64(before[y - 1 + k, x + 1, c])
                    )
                    total += row * (2 if k == 1 else 1)
                image[y + y0, x + x0, c] = np.uint8((total + 8) // 16)


@njit(cache=True, nogil=True)
def blocks_with(bad, block):  # type: ignore[no-untyped-def]
    """Return which blocks of `block` x `block` pixels hold a value that is not zero."""
    height, width = bad.shape
    out = np.zeros(((height + block - 1) // block, (width + block - 1) // block), np.bool_)
    for y in range(height):
        row = out[y // block]
        for j in range(row.size):
            if not row[j]:
                for x in range(j * block, min((j + 1) * block, width)):
                    if bad[y, x] != 0:
                        row[j] = True
                        break
    return out
