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
    lid, wet = a[2], a[7]
    if lid > 0.004:
        lash = s["lash_colour"]
        dark = np.exp(-((max(a[6] - 0.4, 0) / lash[4]) ** 2)) * lash[3]
        drawn = a[3:6] + look_up(s["grain"], *(a[9:11] - s["origin"]))
        drawn = drawn + (lash[:3] - drawn) * dark
        colour = colour + (drawn - colour) * lid
    return colour * (1 - np.array([0.25, 0.36, 0.34]) * wet) if wet > 0.01 else colour


def mouth_colour(s, m, kind, x, y, below):
    step, edges = s["step"], s["edges"]
    place = s["x0"] + (x + 0.5) / step - 0.5, s["y0"] + (y + 0.5) / step - 0.5
    over, under = layer_at(s["skull"], *place, s["skull_map"]), layer_at(s["jaw"], *place, s["jaw_map"])
    flesh, cavity, groove, depth = np.clip((m[3] - 0.35) / 0.3, 0, 1), m[4], m[5], max(m[6], 0)
    rows = edges[1, x] - edges[0, x] + 1
    height = rows / (step * s["px_per_mm"])
    if kind == 5 and s["tongue"] > 0:
        opened = np.flatnonzero(edges[0] >= 0)
        across = (x - (opened[0] + opened[-1]) / 2) / ((opened[-1] - opened[0] + 1) / 2)
        t = np.clip(((y - edges[0, x]) / rows - 0.4 - 0.6 * across**2) / 0.3, 0, 1)
        rise = s["tongue"] * (3 * t**2 - 2 * t**3)
        cavity, depth, flesh = cavity * (1 - rise * (1 - 0.12 * np.exp(-((across / 0.06) ** 2)))), 0, 1.0
        depth = max(m[6] * (1 - 0.45 * rise), 0)
    slit = np.clip((height + 0.3) / 2, 0.2, 1)
    dim = np.exp(-depth / s["depth_mm"]) * (1 - s["shadow"] * np.exp(-below / s["shadow_mm"]))
    dim *= slit * height / (height + 0.6)
    hole = np.clip({3: over[4], 4: under[4]}.get(kind, 0.0), 0, 1)
    if kind < 5:
        cavity = max(cavity, 0.95 * (1 - np.exp(-((max(depth - 18, 0) / 10) ** 2))))
    albedo = s["tooth"] * (1 - 0.55 * groove * np.sqrt(max(groove, 0)))
    albedo = albedo + (s["flesh"] - albedo) * flesh
    albedo = albedo + (s["cavity"] - albedo) * max(cavity, hole)
    linear = np.clip(albedo * m[:3] * dim * (1 - 0.7 * hole), 0, 1)
    value = s["encode"][(linear * (len(s["encode"]) - 1) + 0.5).astype(int)]
    value = value + (under[:3] * slit - value) * np.clip(under[3], 0, 1)
    return value + (over[:3] * slit - value) * np.clip(over[3], 0, 1)


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
        s["skin"][c, 2].sum() > 0.01 or s["skin"][c, 7].sum() > 0.02 for _, _, _, c, _, _ in samples
    )
    rim = np.mean([a[8] for a in skin]) if plain else 1.0
    if rim <= 0.004:
        return None
    if plain:
        x, y = np.mean([a[:2] for a in skin], axis=0) - s["origin"]
        colours = [look_up(s["skin_picture"], x, y)]
    else:
        colours = []
        for y, x, kind, _, a, m in samples:
            top = s["edges"][0, x]
            below = (y - top) / (s["step"] * s["px_per_mm"]) if top >= 0 else 0.0
            if kind <= 1:
                colours.append(skin_colour(s, a))
            elif kind == 2:
                dim = 1 - s["shadow"] * np.exp(-below / s["shadow_mm"])
                colours.append(look_up(s["eye_picture"], *(a[:2] - s["eye"])) * dim)
            else:
                colours.append(mouth_colour(s, m, kind, x, y, below))
    before = image[s["y0"] + py, s["x0"] + px].astype(float)
    share = s["mix"] * rim * len(samples) / s["step"] ** 2
    return np.clip(before + (np.mean(colours, axis=0) - before) * share, 0, 255)
