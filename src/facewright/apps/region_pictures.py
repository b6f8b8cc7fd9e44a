"""Pictures of a mesh in regions: a colour for each, the triangles that they share in grey."""

from __future__ import annotations

import colorsys
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from facewright.numeric.check import check_shape

if TYPE_CHECKING:
    from facewright.imaging.rasterise import Fragments
    from facewright.models.regions import Regions

_GREY = (0.62, 0.62, 0.62)
_GOLDEN = 0.618033988749895  # turns of the colour wheel between one region and the next: neighbours differ
_EDGE_SHARE = 0.045  # of a triangle, drawn darker, so that the mesh is seen
_YAWS = (-38.0, 0.0, 38.0)


def region_colours(count: int) -> NDArray[np.float64]:
    """Return a colour for each of `count` regions, (count, 3), sRGB in [0, 1]."""
    hues = (0.02 + _GOLDEN * np.arange(count)) % 1.0
    tones = [(0.62, 0.86), (0.45, 0.95), (0.75, 0.70)]
    return np.array([colorsys.hsv_to_rgb(hue, *tones[i % 3]) for i, hue in enumerate(hues)]).reshape(count, 3)


def region_of_faces(regions: Regions, faces: NDArray[np.integer]) -> NDArray[np.int32]:
    """Return the region of each triangle (F,), the only one that holds all its corners; -1 where several do."""
    holders = np.zeros((len(regions.members), len(faces)), dtype=bool)
    for i, ids in enumerate(regions.members):
        inside = np.zeros(regions.n_vertices, dtype=bool)
        inside[ids] = True
        holders[i] = inside[faces].all(axis=1)
    return np.where(holders.sum(axis=0) == 1, holders.argmax(axis=0), -1).astype(np.int32)


def draw_regions(
    vertices: NDArray[np.floating],
    faces: NDArray[np.integer],
    face_region: NDArray[np.integer],
    *,
    size: tuple[int, int] = (420, 360),
    odd: NDArray[np.integer] | None = None,
) -> NDArray[np.uint8]:
    """Draw a face from its right, its front and its left.

    Parameters
    ----------
    vertices : ndarray of shape (N, 3), millimetres
        y up, the face towards +z.
    faces : ndarray of shape (F, 3), int
    face_region : ndarray of shape (F,), int
        Region of each triangle, -1 for grey.
    size : (height, width)
        Of each of the three pictures, pixels.
    odd : ndarray of shape (L,), int, optional
        Vertices to mark in black.

    Returns
    -------
    ndarray of shape (H, 3 W, 3), uint8
    """
    from facewright.imaging.portrait import render_portrait

    check_shape("vertices", vertices, "N", 3)
    check_shape("face_region", face_region, len(faces))
    colours = np.vstack([region_colours(int(face_region.max(initial=-1)) + 1), _GREY])[face_region]
    is_odd = np.zeros(len(vertices), dtype=bool)
    if odd is not None:
        is_odd[odd] = True
    corner_odd = is_odd[faces]

    def albedo(fragments: Fragments) -> NDArray[np.floating]:
        shade = np.zeros((*fragments.face_index.shape, 3))
        index, share = fragments.face_index[fragments.covered], fragments.barycentric[fragments.covered]
        colour = colours[index] * np.where(share.min(axis=1) < _EDGE_SHARE, 0.72, 1.0)[:, None]
        colour[(corner_odd[index] & (share > 0.6)).any(axis=1)] = 0.0
        shade[fragments.covered] = colour
        return shade

    low, high = np.min(vertices, axis=0), np.max(vertices, axis=0)
    middle = 0.5 * (low + high)
    height = 1.12 * max(high[1] - low[1], (high[0] - low[0]) * size[0] / size[1])
    pictures = [
        render_portrait(
            vertices,
            faces,
            size,
            albedo=albedo,
            shininess=0.0,
            yaw_degrees=yaw,
            centre_mm=(float(middle[0]), float(middle[1]), float(middle[2])),
            height_mm=float(height),
            background=(255, 255, 255),
        ).image
        for yaw in _YAWS
    ]
    return np.concatenate(pictures, axis=1)
