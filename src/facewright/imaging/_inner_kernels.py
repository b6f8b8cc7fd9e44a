"""Loops over the samples of mouth and eyes: look-ups, shading, and mixing samples to antialiased pixels."""

from __future__ import annotations

import numpy as np
from numba import njit

from facewright.imaging._shade_kernels import between_lids, between_lips, slit_share, under_lip

# Columns of the vertex attributes that `compose` takes: eyeballs have the place of what they mirror instead of grain,
SOURCE_X, SOURCE_Y, LID, LID_R, LID_G, LID_B, WET, RIM, GRAIN_X, GRAIN_Y = range(10)
N_SKIN_COLUMNS = 10
# and of what is drawn in the mouth: TOOTH counts the teeth of a row along the arch, negative where they are modelled;
# CROWN is 0 at the gum and 1 at the cutting edge.
LIGHT_R, LIGHT_G, LIGHT_B, FLESH, CAVITY, GROOVE, DEPTH, TOOTH, CROWN, SHEEN = range(10)
N_MOUTH_COLUMNS = 10
#: Teeth of a row before its first one, in which the row begins: the built-in face's rows have two sections more.
TOOTH_OFFSET = 2.0


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


@njit(cache=True, nogil=True, inline="always")
def tooth_surface(u, v):  # type: ignore[no-untyped-def]
    """Return what a row of teeth without modelled ones shows at u teeth along the arch and v down the crown.

    Returns its brightness and warmth (share of blue missing), how much of it is gum, how much is the dark between
    teeth, and how strongly it shines.
    """
    t = u - np.floor(u)
    apart = 8.0 * min(t, 1 - t)  # mm from the next tooth, about
    number = abs(np.floor(u) - TOOTH_OFFSET - 5.5) - 0.5  # 0 in the middle
    side = 2 * t - 1
    bright = (1 - 0.045 * number - 0.015 * number * number) * (1 - 0.20 * side * side * side * side)
    warm = 0.05 * min(number, 2.0) + 0.12 * min(max((0.45 - v) / 0.45, 0.0), 1.0)
    dark = 0.45 * np.exp(-((apart / 0.25) ** 2))
    if v > 1:  # the biting edge and the inner side
        return max(bright * (1.08 - 0.2 * min(v - 1, 1.0)), 0.2), warm, max(v - 2.4, 0.0), 0.5 * dark, 0.0
    gum = min(max((-0.03 + 0.27 * np.exp(-apart / 0.7) - v) / 0.08 + 0.5, 0.0), 1.0)
    # crowns are rounded towards the cutting edge, incisors less than canines
    round_mm = 0.45 + 0.3 * min(number, 2.0)
    end = 1.02 - (0.07 + 0.025 * min(number, 2.0)) * np.exp(-((apart / round_mm) ** 2))
    dark = max(dark * min(max(1.2 * v, 0.3), 1.0), min(max((v - end) / 0.04 + 0.5, 0.0), 1.0))
    bright *= 1 - 0.10 * min(max((v - 0.82) / 0.18, 0.0), 1.0)
    shine = np.exp(-(((t - 0.42) / 0.13) ** 2) - ((v - 0.45) / 0.22) ** 2)
    return max(bright, 0.2), warm, gum, dark, shine


@njit(cache=True, nogil=True, inline="always")
def arched_tongue(across, down):  # type: ignore[no-untyped-def]
    """Return how surely a tongue is seen, its brightness and its shine, of a face that has none.

    `across` is -1 to 1 between the corners of the mouth, `down` 0 to 1 from the upper to the lower lip.
    """
    far = np.sqrt((across / 0.80) ** 2 + ((1.12 - down) / 0.66) ** 2)
    rise = min(max((1 - far) / 0.30, 0.0), 1.0)
    rise *= rise * (3 - 2 * rise)
    dome = np.sqrt(max(1 - far * far, 0.0))
    back = min(max((down - 0.45) / 0.5, 0.0), 1.0)  # lit in front, dark towards the throat
    bright = 1.25 * (0.35 + 0.65 * dome) * (0.35 + 0.65 * back) * (1 - 0.14 * np.exp(-((across / 0.05) ** 2)))
    shine = np.exp(-(((abs(across) - 0.22) / 0.13) ** 2) - ((down - 0.84) / 0.07) ** 2)
    return rise, bright, shine


@njit(cache=True, nogil=True)
def unshade(layer, first, last, middle, half, px_per_mm, behind):  # type: ignore[no-untyped-def]
    """Take the lips' shade off a photo's layer (h, w, 5), in place, where rows first to last of a column are open.

    `middle` and `half` are the middle and half the width, pixels, of the open columns.
    """
    for x in range(layer.shape[1]):
        light = between_lips((last[x] - first[x] + 1) / px_per_mm, (half - abs(x - middle)) / px_per_mm, behind)
        light = max(light, 0.5) ** (1 / 2.2)
        for y in range(layer.shape[0]):
            for k in range(3):
                layer[y, x, k] = min(layer[y, x, k] / light, 300.0)


@njit(cache=True, nogil=True)
def compose(  # type: ignore[no-untyped-def]
    image, touched, x0, y0, step, face_index, barycentric, faces, kinds, edges, px_per_mm, mix,
    skin, skin_picture, origin_x, origin_y, shadow, shadow_mm,
    grain, lash_colour, lash_line, eye_picture, eye_x, eye_y, iris, glint, glint_x, glint_y,
    mouth, flesh_colour, tooth_colour, cavity_colour, depth_mm, tongue, key, was_behind, slit,
    skull, skull_map, jaw, jaw_map, encode,
):  # fmt: skip
    """Draw one opening into `image` (H, W, 3) uint8, whose pixel (x0, y0) holds the first step x step samples.

    A pixel is drawn anew only where one of its samples is not plain skin. See `InnerFace.paint` for the arguments.
    """
    rows, columns = face_index.shape[0] // step, face_index.shape[1] // step
    scratch = np.zeros((4, 5), np.float32)
    place = np.zeros(5)
    middle, half = _span(edges)
    per_mm = 1.0 / (step * px_per_mm)
    for py in range(rows):
        for px in range(columns):
            seen, special = _survey(py, px, step, face_index, barycentric, faces, kinds, skin, lash_line, per_mm, place)
            rim = place[2]
            if seen == 0 or (not special and rim <= 0.004):
                continue
            if not special:
                _look_up(skin_picture, place[0] - origin_x, place[1] - origin_y, scratch[0])
                for k in range(3):
                    scratch[3, k] = scratch[0, k] * seen
            else:
                rim = 1.0
                scratch[3, :] = 0.0
                for sy in range(step):
                    for sx in range(step):
                        y, x = py * step + sy, px * step + sx
                        f = face_index[y, x]
                        if f < 0:
                            continue
                        corners, weights, kind = faces[f], barycentric[y, x], kinds[f]
                        colour = scratch[0]
                        below, above, height = 0.0, 0.0, 0.0
                        if edges[0, x] >= 0:
                            below, above = (y - edges[0, x]) * per_mm, (edges[1, x] - y) * per_mm
                            height = (edges[1, x] - edges[0, x] + 1) * per_mm
                        corner = (half - abs(x - middle)) * per_mm
                        if kind <= 2:
                            if kind <= 1:
                                _skin_sample(skin, corners, weights, skin_picture, origin_x, origin_y, grain, scratch)
                            else:
                                light = between_lids(below, above, corner, shadow, shadow_mm)
                                _eye_sample(
                                    skin, corners, weights, light, corner, eye_picture, eye_x, eye_y, iris, glint,
                                    glint_x, glint_y, scratch,
                                )  # fmt: skip
                            dark = _lash(lash_line, x, y, per_mm, lash_colour[4]) * lash_colour[3]
                            if dark > 0.004:
                                for k in range(3):
                                    colour[k] += (lash_colour[k] - colour[k]) * dark
                        else:
                            tx, ty = x0 + (x + 0.5) / step - 0.5, y0 + (y + 0.5) / step - 0.5
                            _look_up_layer(skull, tx, ty, skull_map, scratch[2])
                            _look_up_layer(jaw, tx, ty, jaw_map, scratch[1])
                            light = between_lips(height, corner, shadow_mm)
                            lip = under_lip(below, shadow, shadow_mm)
                            more = min(lip / under_lip(below, shadow, was_behind), 1.0)  # than in the photo
                            _mouth_sample(
                                mouth, corners, weights, kind, light * lip, light * more, (x - middle) / half,
                                below / max(height, 1e-3), flesh_colour, tooth_colour, cavity_colour, depth_mm, tongue,
                                key, encode, scratch,
                            )  # fmt: skip
                            dark = slit_share(height, below, above, slit[3], slit[4])
                            for k in range(3):
                                colour[k] += (slit[k] - colour[k]) * dark
                        for k in range(3):
                            scratch[3, k] += colour[k]
            iy, ix = y0 + py, x0 + px
            share = mix * rim * (seen / (step * step))
            for k in range(3):
                image[iy, ix, k] = _mixed(image[iy, ix, k], scratch[3, k] / seen, share)
            touched[iy, ix] = True


@njit(cache=True, nogil=True)
def _survey(  # type: ignore[no-untyped-def]
    py, px, step, face_index, barycentric, faces, kinds, skin, lash_line, per_mm, place
):
    """Count a pixel's samples and tell whether any is more than skin; `place`: mean place in the photo and rim."""
    seen, bare, special = 0, 0, False
    place[:] = 0.0
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
            place[0] += u * skin[a, SOURCE_X] + v * skin[b, SOURCE_X] + w * skin[c, SOURCE_X]
            place[1] += u * skin[a, SOURCE_Y] + v * skin[b, SOURCE_Y] + w * skin[c, SOURCE_Y]
            place[2] += u * skin[a, RIM] + v * skin[b, RIM] + w * skin[c, RIM]
            if skin[a, LID] + skin[b, LID] + skin[c, LID] > 0.01 or skin[a, WET] + skin[b, WET] + skin[c, WET] > 0.02:
                special = True
            if lash_line[1, x] > 0.004 and abs(y - lash_line[0, x]) * per_mm < 3.0:
                special = True
    if bare > 0:
        for k in range(3):
            place[k] /= bare
    return seen, special


@njit(cache=True, nogil=True, inline="always")
def _at(values, column, corners, weights):  # type: ignore[no-untyped-def]
    return (
        weights[0] * values[corners[0], column]
        + weights[1] * values[corners[1], column]
        + weights[2] * values[corners[2], column]
    )


@njit(cache=True, nogil=True, inline="always")
def _lash(line, x, y, per_mm, width_mm):  # type: ignore[no-untyped-def]
    """Return how much of a sample lashes cover: `line` (3, columns) is their row, strength and width."""
    if line[1, x] <= 0.004:
        return 0.0
    off = (y - line[0, x]) * per_mm / (width_mm * max(line[2, x], 1e-3))
    if off < 0:  # the lid darkens towards its edge, which is sharp
        off *= 0.5
    return line[1, x] * np.exp(-off * off)


@njit(cache=True, nogil=True)
def _skin_sample(skin, corners, weights, picture, origin_x, origin_y, grain, scratch):  # type: ignore[no-untyped-def]
    """Colour of skin into scratch[0]: the photo's, clean lid skin, the wet inside of lips."""
    colour, fine = scratch[0], scratch[1]
    at_x = _at(skin, SOURCE_X, corners, weights) - origin_x
    at_y = _at(skin, SOURCE_Y, corners, weights) - origin_y
    lid, wet = _at(skin, LID, corners, weights), _at(skin, WET, corners, weights)
    _look_up(picture, at_x, at_y, colour)
    if lid > 0.004:
        grain_x = _at(skin, GRAIN_X, corners, weights) - origin_x
        grain_y = _at(skin, GRAIN_Y, corners, weights) - origin_y
        _look_up(grain, grain_x, grain_y, fine)
        for k in range(3):
            colour[k] += (_at(skin, LID_R + k, corners, weights) + fine[k] - colour[k]) * lid
    if wet > 0.01:
        colour[0] *= 1 - 0.25 * wet
        colour[1] *= 1 - 0.36 * wet
        colour[2] *= 1 - 0.34 * wet


@njit(cache=True, nogil=True)
def _eye_sample(  # type: ignore[no-untyped-def]
    skin, corners, weights, light, corner, picture, eye_x, eye_y, iris, glint, glint_x, glint_y, scratch
):
    """Colour of an eyeball into scratch[0]: its picture in the shade of the lids, and what the cornea mirrors."""
    colour, mirrored = scratch[0], scratch[1]
    at_x, at_y = _at(skin, SOURCE_X, corners, weights), _at(skin, SOURCE_Y, corners, weights)
    _look_up(picture, at_x - eye_x, at_y - eye_y, colour)
    pink = 0.10 * np.exp(-max(corner, 0.0) / 1.5)
    colour[0] *= light
    colour[1] *= light * (1 - pink)
    colour[2] *= light * (1 - pink)
    mirror_x = _at(skin, GRAIN_X, corners, weights) - glint_x
    mirror_y = _at(skin, GRAIN_Y, corners, weights) - glint_y
    if 0 <= mirror_x <= glint.shape[1] - 1 and 0 <= mirror_y <= glint.shape[0] - 1:
        on = np.sqrt((at_x - iris[0]) ** 2 + (at_y - iris[1]) ** 2) / iris[2]
        on = min(max((1.2 - on) / 0.25, 0.0), 1.0)  # only the cornea mirrors so clearly
        if on > 0:
            _look_up(glint, mirror_x, mirror_y, mirrored)
            for k in range(3):
                colour[k] += on * max(mirrored[k], 0.0)


@njit(cache=True, nogil=True)
def _mouth_sample(  # type: ignore[no-untyped-def]
    mouth, corners, weights, kind, light, light_on_layers, across, down, flesh_colour, tooth_colour, cavity_colour,
    depth_mm, tongue, key, encode, scratch,
):  # fmt: skip
    """Colour inside the mouth into scratch[0]: drawn, or from the photo's layers in scratch[2] (skull), [1] (jaw)."""
    colour, over, under = scratch[0], scratch[2], scratch[1]
    flesh = min(max((_at(mouth, FLESH, corners, weights) - 0.35) / 0.3, 0.0), 1.0)
    cavity, groove = _at(mouth, CAVITY, corners, weights), _at(mouth, GROOVE, corners, weights)
    depth, shine = max(_at(mouth, DEPTH, corners, weights), 0.0), _at(mouth, SHEEN, corners, weights)
    bright, warm, dark = 1 - 0.55 * groove * np.sqrt(max(groove, 0.0)), 0.0, 0.0
    if kind == 5 and tongue > 0:  # of a face without one: an arch over the mouth's floor
        rise, lit, shine = arched_tongue(across, down)
        flesh, cavity = 1.0, cavity * (1 - tongue * rise)
        bright = 1 + tongue * rise * (lit - 1)
        shine *= 0.5 * tongue * rise
        depth *= 1 - 0.45 * tongue * rise
    hole = 0.0
    if kind < 5:
        hole = min(max(over[4] if kind == 3 else under[4], 0.0), 1.0)  # drawn teeth give way to those of the photo
        if _at(mouth, TOOTH, corners, weights) >= 0:
            bright, warm, flesh, dark, shine = tooth_surface(
                _at(mouth, TOOTH, corners, weights), _at(mouth, CROWN, corners, weights)
            )
        far = max(depth - 17.0, 0.0) / 10.0  # cheeks lie close to the molars, in the dark
        cavity = max(cavity, 0.97 * (1 - np.exp(-far * far)))
    dim = np.exp(-depth / depth_mm) * light
    shine *= (1 - max(cavity, hole)) * (1 - dark)
    for k in range(3):
        albedo = tooth_colour[k] * bright * (1 - warm * 0.5 * k)
        albedo += (flesh_colour[k] * min(bright, 1.0) - albedo) * flesh
        albedo += (cavity_colour[k] - albedo) * max(cavity, hole)
        lit = _at(mouth, k, corners, weights)
        value = albedo * lit * dim * (1 - 0.7 * hole) * (1 - 0.9 * dark * (1 - flesh))
        value = _encode(value + 0.16 * shine * key * dim, encode)
        # what little light there is comes off lips and gums
        shade = light_on_layers ** (1 / 2.2) * (1 - (0.16 + 0.03 * k) * min(k, 1) * (1 - light_on_layers))
        value += (under[k] * shade - value) * min(max(under[3], 0.0), 1.0)
        colour[k] = value + (over[k] * shade - value) * min(max(over[3], 0.0), 1.0)


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
