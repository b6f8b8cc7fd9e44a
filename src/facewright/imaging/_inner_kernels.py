"""Loops over the samples of mouth and eyes: look-ups, shading, and mixing samples to antialiased pixels."""

from __future__ import annotations

import numpy as np
from numba import njit

# Columns of the vertex attributes that `compose` takes.
SOURCE_X, SOURCE_Y, LID, LID_R, LID_G, LID_B, LASH, WET, RIM, GRAIN_X, GRAIN_Y = range(11)
N_SKIN_COLUMNS = 11
# and of what is drawn in the mouth
LIGHT_R, LIGHT_G, LIGHT_B, FLESH, CAVITY, GROOVE, DEPTH = range(7)
N_MOUTH_COLUMNS = 7


@njit(cache=True, nogil=True, inline="always")
def _cubic(t):  # type: ignore[no-untyped-def]
    """Weights of the pixels at -1, 0, 1, 2 for the place t in [0, 1): Keys (1981), a = -1/2."""
    t2 = t * t
    t3 = t2 * t
    return 0.5 * (2 * t2 - t3 - t), 1 + 0.5 * (3 * t3 - 5 * t2), 0.5 * (4 * t2 - 3 * t3 + t), 0.5 * (t3 - t2)


@njit(cache=True, nogil=True)
def _look_up(picture, x, y, out):  # type: ignore[no-untyped-def]
    """Bicubic look-up of a float32 picture (h, w, C); the border goes on; `out` (C or longer) is filled."""
    h, w, channels = picture.shape
    x = min(max(x, 0.0), w - 1.0)
    y = min(max(y, 0.0), h - 1.0)
    x1, y1 = int(x), int(y)
    x0, x2, x3 = max(x1 - 1, 0), min(x1 + 1, w - 1), min(x1 + 2, w - 1)
    y0, y2, y3 = max(y1 - 1, 0), min(y1 + 1, h - 1), min(y1 + 2, h - 1)
    a0, a1, a2, a3 = _cubic(x - x1)
    b0, b1, b2, b3 = _cubic(y - y1)
    for c in range(channels):
        p, q = picture[y0], picture[y1]
        total = b0 * (a0 * p[x0, c] + a1 * p[x1, c] + a2 * p[x2, c] + a3 * p[x3, c])
        total += b1 * (a0 * q[x0, c] + a1 * q[x1, c] + a2 * q[x2, c] + a3 * q[x3, c])
        p, q = picture[y2], picture[y3]
        total += b2 * (a0 * p[x0, c] + a1 * p[x1, c] + a2 * p[x2, c] + a3 * p[x3, c])
        total += b3 * (a0 * q[x0, c] + a1 * q[x1, c] + a2 * q[x2, c] + a3 * q[x3, c])
        out[c] = total


@njit(cache=True, nogil=True)
def upper_edges(face_index, kinds, least):  # type: ignore[no-untyped-def]
    """Return for each column of samples the row where the opening begins and where it ends, -1 where it is shut."""
    height, width = face_index.shape
    edges = np.full((2, width), -1.0, np.float32)
    for x in range(width):
        for y in range(height):
            f = face_index[y, x]
            if f >= 0 and kinds[f] >= least:
                if edges[0, x] < 0:
                    edges[0, x] = y
                edges[1, x] = y
    return edges


@njit(cache=True, nogil=True, inline="always")
def _encode(value, table):  # type: ignore[no-untyped-def]
    """Linear light to sRGB in [0, 255], by table."""
    k = int(min(max(value, 0.0), 1.0) * (table.size - 1) + 0.5)
    return table[k]


@njit(cache=True, nogil=True, inline="always")
def _look_up_layer(layer, x, y, terms, out):  # type: ignore[no-untyped-def]
    """Look a layer (h, w, 5) up where the map (6, 2) takes the pixel; see `InnerFace` for the map."""
    out[3] = 0.0
    out[4] = 0.0
    if layer.shape[0] == 0:
        return
    dx, dy = (x - terms[6, 0]) * terms[7, 0], (y - terms[6, 1]) * terms[7, 1]
    at_x = terms[0, 0] + terms[1, 0] * dx + terms[2, 0] * dy
    at_y = terms[0, 1] + terms[1, 1] * dx + terms[2, 1] * dy
    at_x += terms[3, 0] * dx * dx + terms[4, 0] * dx * dy + terms[5, 0] * dy * dy
    at_y += terms[3, 1] * dx * dx + terms[4, 1] * dx * dy + terms[5, 1] * dy * dy
    if not (0 <= at_x < layer.shape[1] - 1 and 0 <= at_y < layer.shape[0] - 1):
        return
    j, i = int(at_y), int(at_x)
    if layer[j, i, 3] + layer[j, i, 4] + layer[j + 1, i + 1, 3] + layer[j + 1, i + 1, 4] > 0:
        _look_up(layer, at_x, at_y, out)


@njit(cache=True, nogil=True)
def compose(  # type: ignore[no-untyped-def]
    image, touched, x0, y0, step, face_index, barycentric, faces, kinds, edges, px_per_mm, mix,
    skin, skin_picture, origin_x, origin_y, shadow, shadow_mm,
    grain, lash_colour, eye_picture, eye_x, eye_y,
    mouth, flesh_colour, tooth_colour, cavity_colour, depth_mm, tongue,
    skull, skull_map, jaw, jaw_map, encode,
):  # fmt: skip
    """Draw one opening into `image` (H, W, 3) uint8, whose pixel (x0, y0) holds the first step x step samples.

    A pixel is drawn anew only where one of its samples is not plain skin. See `InnerFace.paint` for the arguments.
    """
    rows, columns = face_index.shape[0] // step, face_index.shape[1] // step
    scratch = np.zeros((4, 5), np.float32)
    middle, half = _span(edges)
    for py in range(rows):
        for px in range(columns):
            _compose_pixel(
                image, touched, x0, y0, py, px, step, face_index, barycentric, faces, kinds, edges, px_per_mm, mix,
                skin, skin_picture, origin_x, origin_y, shadow, shadow_mm,
                grain, lash_colour, eye_picture, eye_x, eye_y,
                mouth, flesh_colour, tooth_colour, cavity_colour, depth_mm, tongue, middle, half,
                skull, skull_map, jaw, jaw_map, encode, scratch,
            )  # fmt: skip


@njit(cache=True, nogil=True)
def _compose_pixel(  # type: ignore[no-untyped-def]
    image, touched, x0, y0, py, px, step, face_index, barycentric, faces, kinds, edges, px_per_mm, mix,
    skin, skin_picture, origin_x, origin_y, shadow, shadow_mm,
    grain, lash_colour, eye_picture, eye_x, eye_y,
    mouth, flesh_colour, tooth_colour, cavity_colour, depth_mm, tongue, middle, half,
    skull, skull_map, jaw, jaw_map, encode, scratch,
):  # fmt: skip
    colour, fine, over, under = scratch[0], scratch[1], scratch[2], scratch[3]
    total_r, total_g, total_b = 0.0, 0.0, 0.0
    seen, bare = 0, 0
    place_x, place_y, rim, special = 0.0, 0.0, 0.0, False
    # skin alone is looked up once, at the middle of its samples
    for sy in range(step):
        for sx in range(step):
            y, x = py * step + sy, px * step + sx
            f = face_index[y, x]
            if f < 0:
                continue
            seen += 1
            if kinds[f] > 1:
                special = True
                continue
            a, b, c = faces[f, 0], faces[f, 1], faces[f, 2]
            u, v, w = barycentric[y, x, 0], barycentric[y, x, 1], barycentric[y, x, 2]
            bare += 1
            place_x += u * skin[a, 0] + v * skin[b, 0] + w * skin[c, 0]
            place_y += u * skin[a, 1] + v * skin[b, 1] + w * skin[c, 1]
            rim += u * skin[a, 8] + v * skin[b, 8] + w * skin[c, 8]
            if skin[a, 2] + skin[b, 2] + skin[c, 2] > 0.01 or skin[a, 7] + skin[b, 7] + skin[c, 7] > 0.02:
                special = True
    if seen == 0:
        return
    if bare > 0:
        rim /= bare
        place_x = place_x / bare - origin_x
        place_y = place_y / bare - origin_y
        if rim <= 0.004 and not special:
            return
    if not special:
        _look_up(skin_picture, place_x, place_y, colour)
        total_r, total_g, total_b = colour[0] * seen, colour[1] * seen, colour[2] * seen
    else:
        rim = 1.0
        for sy in range(step):
            for sx in range(step):
                y, x = py * step + sy, px * step + sx
                f = face_index[y, x]
                if f < 0:
                    continue
                a, b, c = faces[f, 0], faces[f, 1], faces[f, 2]
                u, v, w = barycentric[y, x, 0], barycentric[y, x, 1], barycentric[y, x, 2]
                kind = kinds[f]
                below = (y - edges[0, x]) / (step * px_per_mm) if edges[0, x] >= 0 else 0.0
                if kind <= 1:
                    at_x = u * skin[a, 0] + v * skin[b, 0] + w * skin[c, 0] - origin_x
                    at_y = u * skin[a, 1] + v * skin[b, 1] + w * skin[c, 1] - origin_y
                    lid = u * skin[a, 2] + v * skin[b, 2] + w * skin[c, 2]
                    wet = u * skin[a, 7] + v * skin[b, 7] + w * skin[c, 7]
                    _look_up(skin_picture, at_x, at_y, colour)
                    if lid > 0.004:
                        lash = u * skin[a, 6] + v * skin[b, 6] + w * skin[c, 6]
                        dark = np.exp(-((max(lash - 0.4, 0.0) / lash_colour[4]) ** 2)) * lash_colour[3]
                        grain_x = u * skin[a, 9] + v * skin[b, 9] + w * skin[c, 9] - origin_x
                        grain_y = u * skin[a, 10] + v * skin[b, 10] + w * skin[c, 10] - origin_y
                        _look_up(grain, grain_x, grain_y, fine)
                        for k in range(3):
                            lid_colour = u * skin[a, 3 + k] + v * skin[b, 3 + k] + w * skin[c, 3 + k] + fine[k]
                            lid_colour += (lash_colour[k] - lid_colour) * dark
                            colour[k] += (lid_colour - colour[k]) * lid
                    if wet > 0.01:
                        colour[0] *= 1 - 0.25 * wet
                        colour[1] *= 1 - 0.36 * wet
                        colour[2] *= 1 - 0.34 * wet
                elif kind == 2:
                    at_x = u * skin[a, 0] + v * skin[b, 0] + w * skin[c, 0] - eye_x
                    at_y = u * skin[a, 1] + v * skin[b, 1] + w * skin[c, 1] - eye_y
                    _look_up(eye_picture, at_x, at_y, colour)
                    dim = 1 - shadow * np.exp(-below / shadow_mm)
                    for k in range(3):
                        colour[k] *= dim
                else:
                    tx, ty = x0 + (x + 0.5) / step - 0.5, y0 + (y + 0.5) / step - 0.5
                    _look_up_layer(skull, tx, ty, skull_map, over)
                    _look_up_layer(jaw, tx, ty, jaw_map, under)
                    flesh = u * mouth[a, 3] + v * mouth[b, 3] + w * mouth[c, 3]
                    flesh = min(max((flesh - 0.35) / 0.3, 0.0), 1.0)
                    cavity = u * mouth[a, 4] + v * mouth[b, 4] + w * mouth[c, 4]
                    groove = u * mouth[a, 5] + v * mouth[b, 5] + w * mouth[c, 5]
                    depth = u * mouth[a, 6] + v * mouth[b, 6] + w * mouth[c, 6]
                    height = (edges[1, x] - edges[0, x] + 1) / (step * px_per_mm)
                    if kind == 5 and tongue > 0:  # of a face without one: an arch over the mouth's floor
                        across = (x - middle) / half
                        rise = (y - edges[0, x]) / (edges[1, x] - edges[0, x] + 1) - 0.4 - 0.6 * across * across
                        rise = min(max(rise / 0.3, 0.0), 1.0)
                        rise *= tongue * rise * (3 - 2 * rise)
                        flesh = max(flesh, rise)
                        cavity *= 1 - rise * (1 - 0.12 * np.exp(-((across / 0.06) ** 2)))
                        depth *= 1 - 0.45 * rise
                    slit = min(max((height + 0.3) / 2.0, 0.2), 1.0)  # little light gets between lips
                    dim = np.exp(-max(depth, 0.0) / depth_mm) * (1 - shadow * np.exp(-below / shadow_mm))
                    dim *= slit * height / (height + 0.6)
                    if kind == 3:  # drawn teeth give way to those of the photo
                        hole = over[4]
                    elif kind == 4:
                        hole = under[4]
                    else:
                        hole = 0.0
                    hole = min(max(hole, 0.0), 1.0)
                    if kind < 5:  # cheeks lie close to the molars, in the dark
                        far = max(depth - 18.0, 0.0) / 10.0
                        cavity = max(cavity, 0.95 * (1 - np.exp(-far * far)))
                    elif tongue > 0:
                        flesh = 1.0
                    tooth = 1 - 0.55 * groove * np.sqrt(max(groove, 0.0))
                    for k in range(3):
                        light = u * mouth[a, k] + v * mouth[b, k] + w * mouth[c, k]
                        albedo = tooth_colour[k] * tooth
                        albedo += (flesh_colour[k] - albedo) * flesh
                        albedo += (cavity_colour[k] - albedo) * max(cavity, hole)
                        value = _encode(albedo * light * dim * (1 - 0.7 * hole), encode)
                        value += (under[k] * slit - value) * min(max(under[3], 0.0), 1.0)
                        value += (over[k] * slit - value) * min(max(over[3], 0.0), 1.0)
                        colour[k] = value
                total_r += colour[0]
                total_g += colour[1]
                total_b += colour[2]
    iy, ix = y0 + py, x0 + px
    share = mix * rim * (seen / (step * step))
    image[iy, ix, 0] = _mixed(image[iy, ix, 0], total_r / seen, share)
    image[iy, ix, 1] = _mixed(image[iy, ix, 1], total_g / seen, share)
    image[iy, ix, 2] = _mixed(image[iy, ix, 2], total_b / seen, share)
    touched[iy, ix] = True


@njit(cache=True, nogil=True)
def _span(edges):  # type: ignore[no-untyped-def]
    """Return the middle and half the width, samples, of the columns in which an opening is open."""
    first, last = -1, -1
    for x in range(edges.shape[1]):
        if edges[0, x] >= 0:
            if first < 0:
                first = x
            last = x
    return 0.5 * (first + last), max(0.5 * (last - first + 1), 1.0)


@njit(cache=True, nogil=True, inline="always")
def _mixed(before, after, share):  # type: ignore[no-untyped-def]
    return np.uint8(min(max(before + (after - before) * share + 0.5, 0.0), 255.0))
