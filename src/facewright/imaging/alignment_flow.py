"""Alignment flow: bring one picture of a face to the pose, size and shape in which another shows it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from facewright.errors import DegenerateError
from facewright.faces.face import Face
from facewright.imaging.colour import linear_from_srgb, srgb_from_linear
from facewright.imaging.component_mask import SkinPixels, facing_camera
from facewright.imaging.mesh_view import MeshView
from facewright.imaging.poisson import solve_poisson
from facewright.imaging.resample import resample
from facewright.numeric.check import check_shape

_DEPTH_TOLERANCE_MM = 1.0
# Cosine of normal and ray in the picture over that in the wanted view: below, detail is missing; above, it is not.
_FORESHORTENING = (0.25, 0.5)
_GRAZING = 0.05  # cosine below which a picture does not show the skin
_HEAD_MM = 180.0  # a head with its neck covers about a square of this side
_SLIVER_MM = 2.5  # inner rims of lips and lids are so wide


@dataclass(frozen=True, eq=False)
class AlignedPicture:
    """A picture of a face as if taken where another was.

    Parameters
    ----------
    image : ndarray of shape (H, W, 3), uint8
        sRGB; black where nothing is known.
    seen : ndarray of shape (H, W), float32
        How well the picture shows what each pixel shows: 1 well, 0 not at all (hidden, turned away, out of the frame).
    facing : ndarray of shape (H, W), float32
        The lesser cosine between the skin's normal and the ray to the camera in the picture and in the wanted view; 0
        where there is no skin.
    flow : ndarray of shape (H, W, 2), float32, pixels
        Where each pixel was looked up in the picture; 0 where it was not.
    shrinking : float
        Pixels of the picture per pixel of the result, along one axis (median): below 1 it had to be enlarged.
    pixels_per_mm : float
        Scale of the result at the head, roughly.
    """

    image: NDArray[np.uint8]
    seen: NDArray[np.float32]
    facing: NDArray[np.float32]
    flow: NDArray[np.float32]
    shrinking: float
    pixels_per_mm: float


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
    scale = float(np.sqrt(covered.sum())) / _HEAD_MM
    radius = max(1, round(_SLIVER_MM * scale))
    # inner rims of lips and lids hide themselves in one picture or the other
    rims = (seen < 0.5) & covered & ndimage.binary_dilation(target.openings, iterations=radius)
    between = target.openings | rims
    _continue_into(flow, between, covered & ~rims)
    seen = _without_slivers(seen, between, covered & ~rims, max(1, round(0.4 * radius)))
    shrinking = _shrinking(flow, covered)
    image = np.zeros((*covered.shape, 3), np.uint8)
    resample(_smoothed(photo, shrinking), flow[..., 0], flow[..., 1], where=known, out=image)
    height, width = photo.shape[:2]
    inside = (flow >= 0).all(axis=2) & (flow[..., 0] <= width - 1) & (flow[..., 1] <= height - 1)
    seen = np.where(known & inside, seen, 0).astype(np.float32)
    return AlignedPicture(image, seen, values[..., 3:].min(axis=2), flow, shrinking, scale)


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
    labels, _ = ndimage.label(openings, np.ones((3, 3)))
    for k, (rows, cols) in enumerate(ndimage.find_objects(labels), start=1):
        box = (slice(max(rows.start - 1, 0), rows.stop + 1), slice(max(cols.start - 1, 0), cols.stop + 1))
        inside = labels[box] == k
        flow[box] = solve_poisson(flow[box], inside, free=~(inside | covered[box]))


def _without_slivers(
    seen: NDArray[np.floating], between: NDArray[np.bool_], around: NDArray[np.bool_], radius: int
) -> NDArray[np.float32]:
    """Return how well pixels are seen: thin slivers, and what lies between lips or lids, as well as what is around."""
    picture = np.where(between, 0.0, seen).astype(np.float32)
    closed = ndimage.grey_closing(picture, size=2 * radius + 1)
    labels, count = ndimage.label(between, np.ones((3, 3)))
    if count:
        border = ndimage.grey_dilation(labels, size=2 * radius + 1) * around
        mean = np.concatenate([[0.0], np.nan_to_num(ndimage.mean(closed, border, np.arange(1, count + 1)))])
        closed = np.where(between, mean[labels], closed)
    # beside what hides it the picture's own blur mixes skin with what is in front
    return np.asarray(ndimage.grey_erosion(closed, size=2 * max(1, radius // 2) + 1), dtype=np.float32)


def _shrinking(flow: NDArray[np.float32], covered: NDArray[np.bool_]) -> float:
    """Return the median number of pixels of the picture per pixel of the result, along one axis."""
    dx, dy = np.diff(flow, axis=1)[:-1], np.diff(flow, axis=0)[:, :-1]
    area = np.abs(dx[..., 0] * dy[..., 1] - dx[..., 1] * dy[..., 0])
    whole = covered[:-1, :-1] & covered[1:, :-1] & covered[:-1, 1:]
    return float(np.sqrt(np.median(area[whole]))) if whole.any() else 1.0


def _smoothed(photo: NDArray[np.uint8], shrinking: float) -> NDArray[np.uint8]:
    """Return the picture without detail that would alias where it is made smaller."""
    if shrinking <= 1.2:
        return photo
    sigma = 0.45 * np.sqrt(shrinking**2 - 1.0)
    smooth = [
        srgb_from_linear(ndimage.gaussian_filter(linear_from_srgb(c.astype(np.float32) / 255.0), sigma))
        for c in np.moveaxis(photo, 2, 0)
    ]
    return np.rint(np.stack(smooth, axis=-1) * 255.0).astype(np.uint8)
