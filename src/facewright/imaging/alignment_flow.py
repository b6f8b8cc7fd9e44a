"""Alignment flow: bring one picture of a face to the pose, size and shape in which another shows it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage, sparse
from scipy.sparse.linalg import spsolve

from facewright.errors import DegenerateError
from facewright.faces.face import Face
from facewright.imaging.colour import linear_from_srgb, srgb_from_linear
from facewright.imaging.component_mask import SkinPixels, facing_camera
from facewright.imaging.mesh_view import MeshView
from facewright.imaging.resample import resample
from facewright.numeric.check import check_shape

_DEPTH_TOLERANCE_MM = 3.0
# Cosine of normal and ray in the picture over that in the wanted view: below, detail is missing; above, it is not.
_FORESHORTENING = (0.25, 0.5)
_GRAZING = 0.05  # cosine below which a picture does not show the skin
_SLIVER_MM = 2.5  # half the width of what a picture may fail to show between things that it shows
_MAX_UNKNOWNS = 40_000  # of the map across one opening; larger ones are solved on a coarser grid


@dataclass(frozen=True, eq=False)
class AlignedPicture:
    """A picture of a face as if taken where another was.

    Parameters
    ----------
    image : ndarray of shape (H, W, 3), float32
        sRGB in [0, 1]; black where nothing is known.
    seen : ndarray of shape (H, W), float32
        How well the picture shows what each pixel shows: 1 well, 0 not at all (hidden, turned away, out of the frame).
    flow : ndarray of shape (H, W, 2), float32, pixels
        Where each pixel was looked up in the picture; 0 where it was not.
    shrinking : float
        Pixels of the picture per pixel of the result, along one axis (median): below 1 it had to be enlarged.
    """

    image: NDArray[np.float32]
    seen: NDArray[np.float32]
    flow: NDArray[np.float32]
    shrinking: float


def align_picture(photo: NDArray[np.uint8], source: MeshView, face: Face, target: SkinPixels) -> AlignedPicture:
    """Look up, for every pixel of a wanted view, the same point of the skin in a picture.

    Parameters
    ----------
    photo : ndarray of shape (h, w, 3), uint8
        sRGB picture.
    source : MeshView
        The face's mesh as the picture shows it, all parts.
    face : Face
        Its topology.
    target : SkinPixels
        What the wanted view sees of the mesh's skin. Between lips and between lids, where the mesh has no surface that
        could be trusted to a pixel, the map is continued smoothly from the skin around.

    Returns
    -------
    AlignedPicture
        The picture at the size of `target`.

    Raises
    ------
    ShapeError
        If `source` is not a view of the face.
    DegenerateError
        If the wanted view shows no skin.
    """
    check_shape("photo", photo, "h", "w", 3)
    check_shape("source.pixels", source.pixels, face.topology.n_vertices, 2)
    covered = target.fragments.covered
    if not covered.any():
        raise DegenerateError("the wanted view must show the face, got one that shows no skin.")
    n = face.n_skin
    depth, facing = _depth_map(photo, source, face), facing_camera(source, face)
    values = target.interpolate(np.column_stack([source.pixels[:n], source.depth[:n], facing, target.facing]))
    flow = np.ascontiguousarray(values[..., :2])
    low, high = _FORESHORTENING
    share = values[..., 3] / np.maximum(values[..., 4], 0.1)
    seen = _ahead(flow, values[..., 2], depth) * np.clip((share - low) / (high - low), 0, 1) * covered
    seen[values[..., 3] < _GRAZING] = 0
    known = covered | target.openings
    _continue_into(flow, target.openings, covered)
    seen = _without_slivers(seen, target)
    shrinking = _shrinking(flow, covered)
    image = np.zeros((*covered.shape, 3), np.float32)
    resample(_smoothed(photo, shrinking), flow[..., 0], flow[..., 1], where=known, out=image)
    height, width = photo.shape[:2]
    inside = (flow >= 0).all(axis=2) & (flow[..., 0] <= width - 1) & (flow[..., 1] <= height - 1)
    return AlignedPicture(np.clip(image, 0, 1), np.where(known & inside, seen, 0).astype(np.float32), flow, shrinking)


def _depth_map(photo: NDArray[np.uint8], source: MeshView, face: Face) -> NDArray[np.float32]:
    """Return the depth of the nearest skin at each pixel of the picture; infinite where there is none."""
    return SkinPixels.of(face, source, (photo.shape[0], photo.shape[1])).fragments.depth


def _ahead(flow: NDArray[np.float32], depth: NDArray[np.float32], nearest: NDArray[np.float32]) -> NDArray[np.bool_]:
    """Tell whether points are in front in a picture, from its z-buffer."""
    height, width = nearest.shape
    x = np.clip(np.round(flow[..., 0]).astype(int), 0, width - 1)
    y = np.clip(np.round(flow[..., 1]).astype(int), 0, height - 1)
    # the deepest of the neighbouring pixels, so that steep but visible skin does not hide itself
    around = ndimage.maximum_filter(np.where(np.isfinite(nearest), nearest, -np.inf), 3)
    return np.asarray(depth <= around[y, x] + _DEPTH_TOLERANCE_MM)


def _continue_into(flow: NDArray[np.float32], openings: NDArray[np.bool_], covered: NDArray[np.bool_]) -> None:
    """Continue a map harmonically from the skin into the openings, in place."""
    labels, _ = ndimage.label(openings)
    for k, (rows, cols) in enumerate(ndimage.find_objects(labels), start=1):
        y0, y1 = max(rows.start - 1, 0), min(rows.stop + 1, flow.shape[0])
        x0, x1 = max(cols.start - 1, 0), min(cols.stop + 1, flow.shape[1])
        box = (slice(y0, y1), slice(x0, x1))
        inside = labels[box] == k
        flow[box][inside] = _harmonic(flow[box], inside, covered[box])


def _harmonic(values: NDArray[np.float32], inside: NDArray[np.bool_], known: NDArray[np.bool_]) -> NDArray[np.float32]:
    """Return the harmonic continuation of values (h, w, C) from known pixels to those `inside`, shape (N, C)."""
    step = int(np.ceil(np.sqrt(inside.sum() / _MAX_UNKNOWNS)))
    if step > 1:  # the map is smooth: a coarser grid, looked up between its points
        coarse = _harmonic(values[::step, ::step], inside[::step, ::step], known[::step, ::step])
        grid = np.array(values[::step, ::step])
        grid[inside[::step, ::step]] = coarse
        at = np.array(np.nonzero(inside)) / step
        return np.stack([ndimage.map_coordinates(c, at, order=1, mode="nearest") for c in np.moveaxis(grid, 2, 0)], 1)
    n = int(inside.sum())
    number = np.full(inside.shape, -1)
    number[inside] = np.arange(n)
    padded = np.pad(number, 1, constant_values=-1)
    weights = np.pad(inside | known, 1)
    data = np.pad(np.where(known[..., None], values, 0).astype(np.float64), ((1, 1), (1, 1), (0, 0)))
    ys, xs = np.nonzero(inside)
    diagonal, right = np.zeros(n), np.zeros((n, values.shape[2]))
    rows, cols = [], []
    for dy, dx in ((0, 1), (0, -1), (1, 0), (-1, 0)):
        y, x = ys + 1 + dy, xs + 1 + dx
        valid, other = weights[y, x], padded[y, x]
        diagonal += valid
        right += np.where((valid & (other < 0))[:, None], data[y, x], 0)
        rows.append(np.flatnonzero(other >= 0))
        cols.append(other[other >= 0])
    i, k = np.concatenate(rows), np.concatenate(cols)
    matrix = sparse.coo_matrix((-np.ones(len(i)), (i, k)), shape=(n, n)) + sparse.diags(np.maximum(diagonal, 1e-9))
    return np.asarray(spsolve(matrix.tocsc(), right), dtype=np.float32).reshape(n, -1)


def _without_slivers(seen: NDArray[np.floating], target: SkinPixels) -> NDArray[np.float32]:
    """Return how well pixels are seen, with openings and thin slivers as well as the skin around them.

    Inner rims of lips and lids hide themselves in one picture or the other; what lies next to them is seen, and the
    map goes on smoothly.
    """
    picture = np.where(target.openings, 0.0, seen).astype(np.float32)
    area = float(target.fragments.covered.sum())  # of a head of about 150 x 220 mm
    radius = max(1, round(_SLIVER_MM * np.sqrt(area) / 180.0))
    closed = ndimage.grey_closing(picture, size=2 * radius + 1)
    labels, count = ndimage.label(target.openings, np.ones((3, 3)))
    if count:
        around = ndimage.grey_dilation(labels, size=2 * radius + 1) * target.fragments.covered
        mean = np.nan_to_num(ndimage.mean(closed, around, np.arange(1, count + 1)))
        closed = np.where(target.openings, np.concatenate([[0.0], mean])[labels], closed)
    return np.asarray(closed, dtype=np.float32)


def _shrinking(flow: NDArray[np.float32], covered: NDArray[np.bool_]) -> float:
    """Return the median number of pixels of the picture per pixel of the result, along one axis."""
    dx, dy = np.diff(flow, axis=1)[:-1], np.diff(flow, axis=0)[:, :-1]
    area = np.abs(dx[..., 0] * dy[..., 1] - dx[..., 1] * dy[..., 0])
    whole = covered[:-1, :-1] & covered[1:, :-1] & covered[:-1, 1:]
    return float(np.sqrt(np.median(area[whole]))) if whole.any() else 1.0


def _smoothed(photo: NDArray[np.uint8], shrinking: float) -> NDArray[np.float32]:
    """Return the picture as sRGB in [0, 1], without detail that would alias where it is made smaller."""
    picture = photo.astype(np.float32) / 255.0
    if shrinking <= 1.2:
        return picture
    sigma = 0.45 * np.sqrt(shrinking**2 - 1.0)
    linear = linear_from_srgb(picture)
    return srgb_from_linear(np.stack([ndimage.gaussian_filter(c, sigma) for c in np.moveaxis(linear, 2, 0)], axis=-1))
