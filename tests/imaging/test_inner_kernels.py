"""The kernel that draws mouth and eyes beside its plain twin."""

import importlib.util
from pathlib import Path

import numpy as np
import pytest

from facewright.imaging._inner_kernels import N_MOUTH_COLUMNS, N_SKIN_COLUMNS, compose, upper_edges

_spec = importlib.util.spec_from_file_location("reference_compose", Path(__file__).with_name("reference_compose.py"))
reference = importlib.util.module_from_spec(_spec)
_spec.loader.exec_module(reference)


def scene(rng, step, kinds, tongue, modelled=False):
    """Samples of random triangles of the given kinds, in columns of some samples of skin above and below."""
    rows, columns, n = 9, 12, 14
    faces = np.array([rng.choice(n, 3, replace=False) for _ in range(20)], np.int32)
    kind = rng.choice(kinds, 20).astype(np.uint8)
    face_index = rng.integers(-1, 20, (rows * step, columns * step)).astype(np.int32)
    weights = rng.random((*face_index.shape, 3)).astype(np.float32)
    skin = rng.random((n, N_SKIN_COLUMNS)).astype(np.float32)
    skin[:, :2], skin[:, 8:] = 3 + 12 * rng.random((n, 2)), 3 + 12 * rng.random((n, 2))
    skin[:, 3:6] *= 200
    skin[:5, [2, 6]] = 0
    mouth = rng.random((n, N_MOUTH_COLUMNS)).astype(np.float32)
    mouth[:, 6] *= 30
    mouth[:, 7], mouth[:, 8] = (12 * rng.random() + 0.9 * mouth[:, 7], 1.6 * mouth[:, 8]) if modelled else (-1.0, 0.0)
    lash_line = np.stack([9 * step * rng.random(12 * step), rng.random(12 * step), 0.6 + rng.random(12 * step)])
    lash_line[1, :4] = 0.0
    layers = [255 * rng.random((14, 16, 5)).astype(np.float32) for _ in range(2)]
    maps = []
    for layer in layers:
        layer[..., 3:] /= 255
        layer[:6, :, 3:] = 0
        terms = rng.normal(0, 0.4, (8, 2))
        terms[0], terms[1], terms[2], terms[6], terms[7] = (7, 6), (4, 0.3), (0.2, 4), (7, 6), (0.16, 0.2)
        maps.append(terms)
    return {
        "x0": 2, "y0": 1, "step": step, "face_index": face_index, "faces": faces, "kinds": kind,
        "barycentric": weights / weights.sum(axis=-1, keepdims=True),
        "edges": upper_edges(face_index, kind, 2), "px_per_mm": 1.3, "mix": np.float32(0.8),
        "skin": skin, "skin_picture": (255 * rng.random((15, 17, 3))).astype(np.float32),
        "origin": np.array([1.0, 2.0], np.float32), "shadow": np.float32(0.4), "shadow_mm": np.float32(1.6),
        "grain": rng.normal(0, 5, (15, 17, 3)).astype(np.float32),
        "lash_colour": np.array([40, 30, 20, 0.8, 0.5], np.float32),
        "lash_line": lash_line.astype(np.float32), "iris": np.array([9.0, 8.0, 6.0]),
        "glint": (60 * rng.random((9, 11, 3))).astype(np.float32), "glint_at": np.array([4.0, 3.0], np.float32),
        "key": np.float32(0.6), "was_behind": np.float32(0.5), "slit": np.array([50, 30, 25, 1.0, 4.5], np.float32),
        "eye_picture": (255 * rng.random((13, 18, 3))).astype(np.float32), "eye": np.array([2.0, 1.0], np.float32),
        "mouth": mouth, "flesh": np.array([0.4, 0.1, 0.1], np.float32), "tooth": np.array([0.8, 0.7, 0.6], np.float32),
        "cavity": np.array([0.1, 0.02, 0.02], np.float32), "depth_mm": np.float32(14), "tongue": np.float32(tongue),
        "skull": layers[0], "skull_map": maps[0], "jaw": layers[1], "jaw_map": maps[1],
        "encode": np.linspace(0, 255, 4096).astype(np.float32),
    }  # fmt: skip


@pytest.mark.parametrize("step", [1, 2, 3])
@pytest.mark.parametrize(
    ("kinds", "tongue", "modelled"),
    [
        ([0, 1], 0.0, False),
        ([0, 0, 1, 2], 0.0, False),
        ([0, 3, 4, 5], 0.0, False),
        ([3, 4, 5], 0.7, False),
        ([3, 4], 0.0, True),
    ],
)
def test_the_kernel_and_its_plain_twin_draw_the_same(rng, step, kinds, tongue, modelled):
    s = scene(rng, step, kinds, tongue, modelled)
    before = rng.integers(0, 256, (12, 16, 3)).astype(np.uint8)
    image, touched = before.copy(), np.zeros(before.shape[:2], bool)
    compose(
        image, touched, s["x0"], s["y0"], step, s["face_index"], s["barycentric"], s["faces"], s["kinds"], s["edges"],
        s["px_per_mm"], s["mix"], s["skin"], s["skin_picture"], *s["origin"], s["shadow"], s["shadow_mm"],
        s["grain"], s["lash_colour"], s["lash_line"], s["eye_picture"], *s["eye"],
        s["iris"], s["glint"], *s["glint_at"],
        s["mouth"], s["flesh"], s["tooth"], s["cavity"], s["depth_mm"], s["tongue"], s["key"],
        s["was_behind"], s["slit"],
        s["skull"], s["skull_map"], s["jaw"], s["jaw_map"], s["encode"],
    )  # fmt: skip
    expected, drawn = before.astype(float), np.zeros_like(touched)
    for py in range(9):
        for px in range(12):
            colour = reference.compose_pixel(s, before, py, px)
            if colour is not None:
                expected[1 + py, 2 + px], drawn[1 + py, 2 + px] = colour, True
    np.testing.assert_array_equal(touched, drawn)
    assert touched.sum() > 40
    assert np.abs(image - expected).max() < 0.75  # rounding, and the table's steps


def test_edges_of_an_opening_by_column():
    face_index = np.array([[-1, 0, 0], [1, 1, 0], [0, 1, 0], [1, -1, -1]], np.int32)
    edges = upper_edges(face_index, np.array([0, 2], np.uint8), 2)
    np.testing.assert_array_equal(edges, [[1, 1, -1], [3, 2, -1]])
