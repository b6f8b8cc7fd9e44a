"""Measure which ICT-FaceKit vertices are FaceWarehouse's 74 points; writes them into faces/data/ict_landmarks.json.

The real detector looks at a rendered mean face; its points are made symmetric and snapped to the vertices of the
right kind: the middle line, the jaw line, the lash lines, the lip border, the line where the lips touch.
Needs the landmarks extra and an installed ICT-FaceKit: ``python tools/measure_ict_landmarks.py``.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

from facewright.faces.ict import ict_face, read_compact_arrays
from facewright.faces.ict_rings import polygon_adjacency, shortest_path
from facewright.faces.store import stored_face_path
from facewright.imaging.portrait import portrait_view, render_portrait
from facewright.landmarks.mediapipe_detector import MediaPipeDetector
from facewright.landmarks.scheme import load_scheme

OUT = Path(__file__).parents[1] / "src/facewright/faces/data/ict_landmarks.json"
SIZE = (1200, 1200)
VIEW = {"height_mm": 300.0, "centre_mm": (0.0, -10.0, 60.0), "distance_mm": 1500.0}


def main() -> None:
    face = ict_face(read_compact_arrays(stored_face_path("ict")))
    topology, mean = face.topology, face.mean_shape.astype(float)
    seen = topology.faces[(topology.faces < topology.parts["lacrimal_left"][0]).all(axis=1)]
    # A few colourings and sizes, so that no single picture decides.
    found = np.mean([detect(face, seen, colours) for colours in plain_colours(face)], axis=0)
    swap = load_scheme("fw74").mirror
    pixels = portrait_view(mean, SIZE, **VIEW)[1]
    centre = 0.5 * (SIZE[1] - 1)
    found[:, 0] -= centre
    found = 0.5 * (found + found[swap] * [-1, 1]) + [centre, 0.0]
    vertices = snap(found, pixels, face)
    text = OUT.read_text(encoding="utf-8")
    start = text.index('"fw74": [') + len('"fw74": [')
    OUT.write_text(text[:start] + ", ".join(map(str, vertices)) + text[text.index("]", start) :], encoding="utf-8")


def plain_colours(face):
    """Yield colourings with lips and irises but without brows, so that shape alone says where brows are."""
    for skin, lip in (([0.82, 0.64, 0.55], [0.72, 0.38, 0.36]), ([0.62, 0.45, 0.36], [0.52, 0.28, 0.27])):
        colours = np.full((len(face.mean_shape), 3), skin)
        colours[face.topology.masks["lips"]] = lip
        for part in ("eyeball_left", "eyeball_right"):
            colours[slice(*face.topology.parts[part])] = [0.95, 0.94, 0.92]
        for name, shade in (("iris", 0.22), ("pupil", 0.04)):
            for side in ("left", "right"):
                colours[face.topology.masks[f"{name}_{side}"]] = shade
        yield colours


def detect(face, seen, colours):
    image = render_portrait(face.mean_shape, seen, SIZE, albedo=colours, **VIEW).image
    with MediaPipeDetector() as detector:
        return detector.detect(image)[0].convert("fw74").points


def snap(found, pixels, face):
    """Return the vertex of the right kind whose picture is nearest to each point; the left side mirrors the right."""
    topology, mean = face.topology, face.mean_shape.astype(float)
    n = face.n_skin
    lengths = polygon_adjacency(topology.quads[(topology.quads < n).all(axis=1)], n, mean)
    ibug = topology.landmarks["ibug68"]
    jaw = shortest_path(lengths, ibug[:17])
    lash = shortest_path(lengths, np.append(ibug[36:42], ibug[36]))
    border = shortest_path(lengths, np.append(ibug[48:60], ibug[48]))
    masks = topology.masks
    middle = np.flatnonzero((np.abs(mean[:n, 0]) < 1e-3) & (mean[:n, 2] > 0))
    upper, lower = masks["lip_contact_upper"], masks["lip_contact_lower"]
    front = np.flatnonzero((np.arange(n) < len(masks["face_region"])) & (mean[:n, 2] > 60.0))
    # Rows of points of one kind; nostrils are hollow, so that the nose takes what faces the camera.
    allowed = {k: front for k in range(74)}
    allowed |= dict.fromkeys(range(15), jaw) | dict.fromkeys([44, 45, 49, 53, 43], middle)
    allowed |= dict.fromkeys([28, 29, 30], lash[mean[lash, 1] > mean[ibug[36], 1]])
    allowed |= dict.fromkeys([32, 33, 34], lash[mean[lash, 1] < mean[ibug[36], 1]])
    allowed |= dict.fromkeys(range(54, 66), border) | {k: np.intersect1d(border, middle) for k in (57, 63)}
    allowed |= dict.fromkeys([67, 69], upper) | dict.fromkeys([71, 73], lower)
    allowed |= {68: np.intersect1d(upper, middle), 72: np.intersect1d(lower, middle), 7: np.intersect1d(jaw, middle)}
    # Corners and the tip are points that ICT-FaceKit names itself or that geometry gives.
    fixed = {27: ibug[36], 31: ibug[39], 54: ibug[48], 66: ibug[60], 45: middle[mean[middle, 2].argmax()]}
    vertices = np.full(74, -1)
    swap = load_scheme("fw74").mirror
    for k in range(74):
        if vertices[k] < 0:
            ids = allowed[k]
            vertices[k] = fixed.get(k, ids[np.argmin(((pixels[ids] - found[k]) ** 2).sum(axis=1))])
            vertices[swap[k]] = topology.mirror[vertices[k]]
    return vertices


if __name__ == "__main__":
    main()
