"""A plain twin of the kernel that draws mouth and eyes: one sample after another, nothing shared or skipped."""

import numpy as np


def keys(t):
    """Cubic convolution of Keys (1981), a = -1/2, as a function of the distance."""
    t = abs(t)
    if t < 1:
        return 1.5 * t**3 - 2.5 * t**2 + 1
    return -0.5 * t**3 + 2.5 * t**2 - 4 * t + 2 if t < 2 else 0.0


def look_up(picture, x, y):
    h, w = picture.shape[:2]
    x, y = np.clip(x, 0, w - 1), np.clip(y, 0, h - 1)
    total = np.zeros(picture.shape[2])
    for j in range(int(y) - 1, int(y) + 3):
        for i in range(int(x) - 1, int(x) + 3):
            total += keys(x - i) * keys(y - j) * picture[np.clip(j, 0, h - 1), np.clip(i, 0, w - 1)]
    return total


def layer_at(layer, x, y, terms):
    dx, dy = (x - terms[6, 0]) * terms[7, 0], (y - terms[6, 1]) * terms[7, 1]
    at_x, at_y = np.array([1, dx, dy, dx * dx, dx * dy, dy * dy]) @ terms[:6]
    if layer.size == 0 or not (0 <= at_x < layer.shape[1] - 1 and 0 <= at_y < layer.shape[0] - 1):
        return np.zeros(5)
    corner = layer[int(at_y) : int(at_y) + 2, int(at_x) : int(at_x) + 2]
    return look_up(layer, at_x, at_y) if (corner[0, 0, 3:].sum() + corner[1, 1, 3:].sum()) > 0 else np.zeros(5)


def skin_colour(s, a):
    x, y = a[:2] - s["origin"]
    colour = look_up(s["skin_picture"], x, y)
    lid, wet = a[2], a[6]
    if lid > 0.004:
        drawn = a[3:6] + look_up(s["grain"], *(a[8:10] - s["origin"]))
        colour = colour + (drawn - colour) * lid
    return colour * (1 - np.array([0.25, 0.36, 0.34]) * wet) if wet > 0.01 else colour


def lashes(s, x, y):
    row, strength, width = s["lash_line"][:, x]
    if strength <= 0.004:
        return 0.0
    off = (y - row) / (s["step"] * s["px_per_mm"]) / (s["lash_colour"][4] * max(width, 1e-3))
    return s["lash_colour"][3] * strength * np.exp(-((off * (0.5 if off < 0 else 1.0)) ** 2))


def eye_colour(s, a, below, above, corner):
    light = (1 - s["shadow"] * np.exp(-max(below, 0) / s["shadow_mm"])) * (1 - 0.15 * np.exp(-max(above, 0) / 0.8))
    light *= 1 - 0.22 * np.exp(-max(corner, 0) / 2)
    pink = 0.10 * np.exp(-max(corner, 0) / 1.5)
    colour = look_up(s["eye_picture"], *(a[:2] - s["eye"])) * light * np.array([1, 1 - pink, 1 - pink])
    x, y = a[8:10] - s["glint_at"]
    h, w = s["glint"].shape[:2]
    on = np.clip((1.2 - np.hypot(*(a[:2] - s["iris"][:2])) / s["iris"][2]) / 0.25, 0, 1)
    if 0 <= x <= w - 1 and 0 <= y <= h - 1 and on > 0:
        colour = colour + on * np.maximum(look_up(s["glint"], x, y), 0)
    return colour


def tooth(u, v):
    t = u - np.floor(u)
    apart, number, side = 8 * min(t, 1 - t), abs(np.floor(u) - 7.5) - 0.5, 2 * t - 1
    bright = (1 - 0.045 * number - 0.015 * number**2) * (1 - 0.20 * side**4)
    warm = 0.05 * min(number, 2) + 0.12 * np.clip((0.45 - v) / 0.45, 0, 1)
    dark = 0.45 * np.exp(-((apart / 0.25) ** 2))
    if v > 1:
        return max(bright * (1.08 - 0.2 * min(v - 1, 1)), 0.2), warm, max(v - 2.4, 0), 0.5 * dark, 0.0
    gum = np.clip((-0.03 + 0.27 * np.exp(-apart / 0.7) - v) / 0.08 + 0.5, 0, 1)
    end = 1.02 - (0.07 + 0.025 * min(number, 2)) * np.exp(-((apart / (0.45 + 0.3 * min(number, 2))) ** 2))
    dark = max(dark * np.clip(1.2 * v, 0.3, 1), np.clip((v - end) / 0.04 + 0.5, 0, 1))
    bright *= 1 - 0.10 * np.clip((v - 0.82) / 0.18, 0, 1)
    shine = np.exp(-(((t - 0.42) / 0.13) ** 2) - ((v - 0.45) / 0.22) ** 2)
    return max(bright, 0.2), warm, gum, dark, shine


def tongue_at(across, down):
    far = np.hypot(across / 0.80, (1.12 - down) / 0.66)
    rise = np.clip((1 - far) / 0.30, 0, 1)
    bright = 1.25 * (0.35 + 0.65 * np.sqrt(max(1 - far**2, 0))) * (0.35 + 0.65 * np.clip((down - 0.45) / 0.5, 0, 1))
    bright *= 1 - 0.14 * np.exp(-((across / 0.05) ** 2))
    shine = np.exp(-(((abs(across) - 0.22) / 0.13) ** 2) - ((down - 0.84) / 0.07) ** 2)
    return 3 * rise**2 - 2 * rise**3, bright, shine


def mouth_colour(s, m, kind, x, y, below, above, height, corner, across):
    place = s["x0"] + (x + 0.5) / s["step"] - 0.5, s["y0"] + (y + 0.5) / s["step"] - 0.5
    over, under = layer_at(s["skull"], *place, s["skull_map"]), layer_at(s["jaw"], *place, s["jaw_map"])
    behind, gap = s["shadow_mm"], max(height, 0)
    light = min(1, 1.08 * gap**2 / (gap**2 + (1.2 + 0.5 * max(behind, 0)) ** 2))
    light *= 1 - 0.28 * np.exp(-max(corner, 0) / 3)
    lip, was = (1 - s["shadow"] * np.exp(-max(below, 0) / np.clip(0.5 * d, 0.8, 3)) for d in (behind, s["was_behind"]))
    layers, light = light * min(lip / was, 1), light * lip
    flesh, cavity, groove, depth, shine = np.clip((m[3] - 0.35) / 0.3, 0, 1), m[4], m[5], max(m[6], 0), m[9]
    bright, warm, dark, hole = 1 - 0.55 * groove * np.sqrt(max(groove, 0)), 0.0, 0.0, 0.0
    if kind == 5 and s["tongue"] > 0:
        rise, lit, shine = tongue_at(across, below / max(height, 1e-3))
        share = s["tongue"] * rise
        flesh, cavity, bright, shine = 1.0, cavity * (1 - share), 1 + share * (lit - 1), shine * 0.5 * share
        depth *= 1 - 0.45 * share
    if kind < 5:
        hole = np.clip({3: over[4], 4: under[4]}[kind], 0, 1)
        if m[7] >= 0:
            bright, warm, flesh, dark, shine = tooth(m[7], m[8])
        cavity = max(cavity, 0.97 * (1 - np.exp(-((max(depth - 17, 0) / 10) ** 2))))
    dim, shine = np.exp(-depth / s["depth_mm"]) * light, shine * (1 - max(cavity, hole)) * (1 - dark)
    k = np.arange(3)
    albedo = s["tooth"] * bright * (1 - warm * 0.5 * k)
    albedo = albedo + (s["flesh"] * min(bright, 1) - albedo) * flesh
    albedo = albedo + (s["cavity"] - albedo) * max(cavity, hole)
    linear = albedo * m[:3] * dim * (1 - 0.7 * hole) * (1 - 0.9 * dark * (1 - flesh)) + 0.16 * shine * s["key"] * dim
    value = s["encode"][(np.clip(linear, 0, 1) * (len(s["encode"]) - 1) + 0.5).astype(int)]
    shade = layers ** (1 / 2.2) * (1 - (0.16 + 0.03 * k) * np.minimum(k, 1) * (1 - layers))
    value = value + (under[:3] * shade - value) * np.clip(under[3], 0, 1)
    value = value + (over[:3] * shade - value) * np.clip(over[3], 0, 1)
    seen = np.clip((height - s["slit"][3]) / (s["slit"][4] - s["slit"][3]), 0, 1)
    edge = 0.45 * np.exp(-((below / 0.7) ** 2)) + 0.30 * np.exp(-((above / 0.5) ** 2))
    edge = min(edge, 1) * (1 - np.clip(height / s["slit"][4] - 1, 0, 1))
    return value + (s["slit"][:3] - value) * (1 - (3 * seen**2 - 2 * seen**3) * (1 - edge))


def compose_pixel(s, image, py, px):
    """Return the pixel's new colour, float, or None where nothing is drawn."""
    samples = []
    for y in range(py * s["step"], (py + 1) * s["step"]):
        for x in range(px * s["step"], (px + 1) * s["step"]):
            f = s["face_index"][y, x]
            if f >= 0:
                corners = s["faces"][f]
                weights = s["barycentric"][y, x]
                samples.append(
                    (y, x, s["kinds"][f], corners, weights @ s["skin"][corners], weights @ s["mouth"][corners])
                )
    if not samples:
        return None
    skin = [a for _, _, kind, _, a, _ in samples if kind <= 1]
    plain = len(skin) == len(samples) and not any(
        s["skin"][c, 2].sum() > 0.01
        or s["skin"][c, 6].sum() > 0.02
        or (s["lash_line"][1, x] > 0.004 and abs(y - s["lash_line"][0, x]) / (s["step"] * s["px_per_mm"]) < 3)
        for y, x, _, c, _, _ in samples
    )
    rim = np.mean([a[7] for a in skin]) if plain else 1.0
    if rim <= 0.004:
        return None
    if plain:
        x, y = np.mean([a[:2] for a in skin], axis=0) - s["origin"]
        colours = [look_up(s["skin_picture"], x, y)]
    else:
        colours = []
        opened = np.flatnonzero(s["edges"][0] >= 0)
        middle, half = -1.0, 1.0
        if len(opened):
            middle, half = (opened[0] + opened[-1]) / 2, (opened[-1] - opened[0] + 1) / 2
        mm = 1 / (s["step"] * s["px_per_mm"])
        for y, x, kind, _, a, m in samples:
            top, bottom = s["edges"][:, x]
            below, above, height = (
                ((y - top) * mm, (bottom - y) * mm, (bottom - top + 1) * mm) if top >= 0 else (0, 0, 0)
            )
            corner, across = (half - abs(x - middle)) * mm, (x - middle) / half
            if kind > 2:
                colours.append(mouth_colour(s, m, kind, x, y, below, above, height, corner, across))
                continue
            colour = skin_colour(s, a) if kind <= 1 else eye_colour(s, a, below, above, corner)
            colours.append(colour + (s["lash_colour"][:3] - colour) * lashes(s, x, y))
    before = image[s["y0"] + py, s["x0"] + px].astype(float)
    share = s["mix"] * rim * len(samples) / s["step"] ** 2
    return np.clip(before + (np.mean(colours, axis=0) - before) * share, 0, 255)
