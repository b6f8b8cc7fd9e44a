"""Marks over pictures: points, lines of a mesh, and the part of a picture that matters, enlarged."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from PIL import Image, ImageDraw
from scipy import ndimage

from facewright.errors import ValueRangeError
from facewright.imaging.rasterise import rasterise
from facewright.imaging.render import Albedo, render_mesh
from facewright.mesh.normals import face_area_vectors
from facewright.numeric.check import check_shape

Colour = tuple[int, int, int]


def crop_around(
    image: NDArray[np.uint8], points: NDArray[np.floating], *, margin: float = 0.35, height: int = 480
) -> tuple[NDArray[np.uint8], NDArray[np.float64], float]:
    """Cut the square round some points out of a picture and enlarge or shrink it.

    Parameters
    ----------
    image : ndarray of shape (H, W, 3), uint8
        Picture.
    points : ndarray of shape (N, 2), pixels
        What to show; rows with NaN are ignored.
    margin : float
        Free space round the points, as a share of their extent.
    height : int
        Side of the result, pixels.

    Returns
    -------
    crop : ndarray of shape (height, height, 3), uint8
        What lies outside the picture repeats its edge.
    origin : ndarray of shape (2,)
    zoom : float
        A point p of the picture lies at ``(p + 0.5 - origin) * zoom - 0.5`` in the crop.

    Raises
    ------
    ValueRangeError
        If the points extend over more than four times the picture, or lie as far away.
    """
    check_shape("points", points, "N", 2)
    reach = 4.0 * max(image.shape[:2])
    if not np.isfinite(points).any() or np.nanmax(np.abs(points)) > reach:
        raise ValueRangeError(f"points must lie within {reach:.0f} pixels of the picture's corner, got others.")
    low, high = np.nanmin(points, axis=0), np.nanmax(points, axis=0)
    side = float((high - low).max()) * (1 + 2 * margin)
    origin = (low + high) / 2 + 0.5 - side / 2
    zoom = height / side
    padded, pad = image, int(np.ceil(max(0.0, -origin.min(), (origin + side - image.shape[1::-1]).max())))
    if pad:
        padded = np.pad(image, ((pad, pad), (pad, pad), (0, 0)), mode="edge")
    box = (*(origin + pad), *(origin + pad + side))
    crop = Image.fromarray(padded).resize((height, height), Image.Resampling.BICUBIC, box=box)
    return np.asarray(crop), origin, zoom


def draw_points(
    image: NDArray[np.uint8], points: NDArray[np.floating], colour: Colour = (40, 220, 120), radius: float = 2.5
) -> NDArray[np.uint8]:
    """Return the picture with dots of `radius` pixels at `points` (N, 2); rows with NaN are left out."""
    check_shape("points", points, "N", 2)
    zoom = 3  # drawn finer and shrunk, so that dots are round
    height, width = image.shape[:2]
    mask = Image.new("L", (width * zoom, height * zoom))
    draw = ImageDraw.Draw(mask)
    r = radius * zoom
    for x, y in (np.asarray(points)[np.isfinite(points).all(axis=1)] + 0.5) * zoom:
        draw.ellipse((x - r, y - r, x + r, y + r), fill=255)
    return _tint(image, mask.resize((width, height), Image.Resampling.BOX), colour)


def draw_mesh_lines(
    image: NDArray[np.uint8],
    pixels: NDArray[np.floating],
    depth: NDArray[np.floating],
    faces: NDArray[np.integer],
    polygons: NDArray[np.integer] | None = None,
    colour: Colour = (90, 200, 255),
    *,
    opacity: float = 0.7,
    width: float = 0.5,
    perspective: bool = True,
) -> NDArray[np.uint8]:
    """Return the picture with the mesh's visible edges drawn over it.

    Parameters
    ----------
    image : ndarray of shape (H, W, 3), uint8
        Picture.
    pixels, depth : ndarray of shape (V, 2) and (V,)
        Projected vertices and their depth, mm.
    faces : ndarray of shape (F, 3)
        Triangles that hide one another.
    polygons : ndarray of shape (Q, 4), optional
        Polygons whose edges are drawn (-1 pads a triangle); the triangles where absent.
    colour : sRGB colour
        Of the lines.
    opacity : float
        Of the lines, 0 to 1.
    width : float
        Of the lines, pixels, in steps of a half.
    perspective : bool
        Whether the projection is a pinhole's.
    """
    size = image.shape[1], image.shape[0]
    zoom = 2
    fine = (np.asarray(pixels, dtype=np.float64) + 0.5) * zoom - 0.5
    nearest = rasterise(fine, depth, faces, (size[1] * zoom, size[0] * zoom), perspective=perspective).depth
    shown = faces if polygons is None else polygons
    following = np.roll(shown, -1, axis=1)
    following = np.where(following >= 0, following, shown[:, :1])  # after the last corner comes the first
    a, b = shown[shown >= 0], following[shown >= 0]
    edges = np.unique(np.sort(np.stack([a, b], axis=1), axis=1), axis=0)
    flat = np.concatenate([pixels, np.zeros((len(pixels), 1))], axis=1)
    towards = np.zeros(len(pixels), bool)
    towards[faces[face_area_vectors(flat, faces)[:, 2] < 0]] = True
    x, y = np.round(fine[:, 0]).astype(int), np.round(fine[:, 1]).astype(int)
    inside = (x >= 0) & (x < size[0] * zoom) & (y >= 0) & (y < size[1] * zoom) & towards
    seen = np.zeros(len(pixels), bool)
    seen[inside] = depth[inside] <= nearest[y[inside], x[inside]] + 3.0
    mask = Image.new("L", (size[0] * zoom, size[1] * zoom))
    thickness = max(1, round(width * zoom))
    draw = ImageDraw.Draw(mask)
    for i, j in edges[seen[edges].all(axis=1)]:
        draw.line((*(fine[i] + 0.5), *(fine[j] + 0.5)), fill=round(255 * opacity), width=thickness)
    return _tint(image, mask.resize(size, Image.Resampling.BOX), colour)


def draw_shaded(
    image: NDArray[np.uint8],
    camera_vertices: NDArray[np.floating],
    pixels: NDArray[np.floating],
    faces: NDArray[np.integer],
    opacity: NDArray[np.floating],
    *,
    albedo: Albedo | None = None,
    perspective: bool = True,
) -> NDArray[np.uint8]:
    """Return the picture with the mesh shaded over it, see-through where vertices say so.

    Parameters
    ----------
    image : ndarray of shape (H, W, 3), uint8
        Picture.
    camera_vertices, pixels : ndarray of shape (V, 3) and (V, 2)
        Vertices in the camera's frame, mm, and their projections.
    faces : ndarray of shape (F, 3)
        Triangles.
    opacity : ndarray of shape (V,)
        Of the surface, 0 to 1; what lies behind a see-through surface stays hidden.
    albedo : see `facewright.imaging.render.render_mesh`
        Surface colour.
    perspective : bool
        Whether the projection is a pinhole's.
    """
    check_shape("opacity", opacity, len(camera_vertices))
    height, width = image.shape[:2]
    drawn = render_mesh(
        camera_vertices, pixels, faces, (height, width), albedo=albedo, background=image, perspective=perspective
    )
    depth = np.asarray(camera_vertices)[:, 2]
    fragments = rasterise(pixels, depth, faces, (height, width), perspective=perspective)
    weight = fragments.interpolate(faces, np.asarray(opacity)[:, None])
    # at the rim, pixels whose centre the mesh misses take the opacity beside them
    weight = np.where(fragments.covered[..., None], weight, ndimage.maximum_filter(weight, (3, 3, 1)))
    return np.round(image * (1 - weight) + drawn.image * weight).astype(np.uint8)


def _tint(image: NDArray[np.uint8], mask: Image.Image, colour: Colour) -> NDArray[np.uint8]:
    weight = np.asarray(mask, dtype=np.float32)[..., None] / 255.0
    return np.round(image * (1 - weight) + np.asarray(colour, np.float32) * weight).astype(np.uint8)
