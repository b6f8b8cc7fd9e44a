"""Where each pixel of a wanted picture lies in the photo: the skin's own motion, extended smoothly around the head."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage, sparse
from scipy.sparse.linalg import spsolve

from facewright.faces.face import Face
from facewright.imaging.mesh_view import MeshView
from facewright.imaging.rasterise import rasterise
from facewright.mesh.normals import vertex_normals
from facewright.numeric.check import check_shape

_DEPTH_TOLERANCE_MM = 2.0
_CELLS = 72  # of the coarse grid, along the longer side of the box


def displacement_field(
    source: MeshView, target: MeshView, face: Face, size: tuple[int, int], margin: float = 0.45
) -> NDArray[np.float32]:
    """Return, for every pixel of the target picture, where it lies in the source picture, relative to itself.

    Parameters
    ----------
    source, target : MeshView
        The mesh as both pictures see it, all parts.
    face : Face
        Its topology.
    size : (height, width)
        Size of both pictures.
    margin : float
        Reach of the field around the head, as a share of its size.

    Returns
    -------
    ndarray of shape (H, W, 2), float32, pixels
        Source position minus target position; exactly zero beyond the margin.

    Raises
    ------
    ShapeError
        If a view does not have the face's vertices.
    """
    V = face.topology.n_vertices
    check_shape("source.pixels", source.pixels, V, 2)
    check_shape("target.pixels", target.pixels, V, 2)
    result = np.zeros((*size, 2), np.float32)
    motion = source.pixels - target.pixels
    if not np.abs(motion).max() > 0:
        return result
    n, faces = face.n_skin, face.topology.faces
    trust = _trust(source, face, size)
    x0, y0, x1, y1 = _box(source, target, n, size, margin)
    if x1 <= x0 or y1 <= y0:
        return result
    shifted = target.pixels - (x0, y0)
    box_size = (y1 - y0, x1 - x0)
    fragments = rasterise(shifted, target.depth, faces, box_size, perspective=target.perspective)
    values = fragments.interpolate(faces, np.column_stack([motion, trust]))
    inner, weight = values[..., :2], values[..., 2]
    weight = np.where(fragments.covered, weight, 0).astype(np.float32)
    outer = _extend(inner, weight)
    step = max(box_size) / _CELLS
    soft = ndimage.gaussian_filter(np.minimum(weight, ndimage.minimum_filter(weight, int(2 * step) | 1)), 0.6 * step)
    soft = np.clip(soft, 0, 1)[..., None]
    result[y0:y1, x0:x1] = soft * inner + (1 - soft) * outer
    return result


def _trust(source: MeshView, face: Face, size: tuple[int, int]) -> NDArray[np.float64]:
    """Return how far the photo shows each vertex, and the mesh is where the photo's surface is, (V,) in [0, 1]."""
    faces, n = face.topology.faces, face.n_skin
    lo = np.floor(source.pixels[:n].min(axis=0)) - 2
    hi = np.ceil(source.pixels[:n].max(axis=0)) + 2
    scale = 400.0 / max(*(hi - lo), 1.0)
    shape = tuple(np.ceil((hi - lo)[::-1] * scale).astype(int) + 1)
    at = (source.pixels - lo) * scale
    seen = rasterise(at, source.depth, faces, shape, perspective=source.perspective)
    nearest = ndimage.maximum_filter(np.where(seen.covered, seen.depth, 0), 3)
    cells = np.clip(np.round(at).astype(int), 0, np.array(shape)[::-1] - 1)
    visible = source.depth <= nearest[cells[:, 1], cells[:, 0]] + _DEPTH_TOLERANCE_MM
    normals = vertex_normals(source.camera_vertices, faces)
    towards = -source.camera_vertices / np.linalg.norm(source.camera_vertices, axis=1, keepdims=True)
    facing = np.clip(((normals * towards).sum(axis=1) - 0.1) / 0.25, 0, 1)
    region = np.ones(len(visible))
    mean = face.mean_shape
    chin = mean[face.topology.masks["chin"], 1].min() if "chin" in face.topology.masks else mean[:, 1].min()
    a, b = face.topology.parts["head_and_neck"]
    below = np.clip((chin + 10 - mean[a:b, 1]) / 15.0, 0, 1)
    region[a:b] = 0.5 * (1 - below)
    front = face.topology.masks["face_region"]
    region[front] = 1
    return visible * facing * region


def _box(
    source: MeshView, target: MeshView, n_skin: int, size: tuple[int, int], margin: float
) -> tuple[int, int, int, int]:
    both = np.concatenate([source.pixels[:n_skin], target.pixels[:n_skin]])
    lo, hi = both.min(axis=0), both.max(axis=0)
    reach = margin * max(hi - lo)
    lo, hi = np.floor(lo - reach).astype(int), np.ceil(hi + reach).astype(int)
    return max(lo[0], 0), max(lo[1], 0), min(hi[0], size[1]), min(hi[1], size[0])


def _extend(inner: NDArray[np.float32], weight: NDArray[np.float32]) -> NDArray[np.float32]:
    """Extend displacements (H, W, 2), known as far as `weight` (H, W) says, smoothly to zero at the border."""
    h, w = weight.shape
    step = max(1, int(np.ceil(max(h, w) / _CELLS)))
    rows, cols = -(-h // step), -(-w // step)
    padded = ((0, rows * step - h), (0, cols * step - w))
    mass = np.pad(weight, padded).reshape(rows, step, cols, step).mean(axis=(1, 3))
    moment = np.pad(inner * weight[..., None], (*padded, (0, 0))).reshape(rows, step, cols, step, 2).mean(axis=(1, 3))
    n = rows * cols
    line = lambda k: sparse.diags([np.full(k, 2.0), -np.ones(k - 1), -np.ones(k - 1)], [0, 1, -1])  # noqa: E731
    laplace = sparse.kronsum(line(cols), line(rows))  # zero beyond the border
    matrix = laplace @ laplace * 0.5 + 0.02 * laplace + sparse.diags(20 * mass.ravel())
    solved = spsolve(matrix.tocsc(), 20 * moment.reshape(n, 2)).reshape(rows, cols, 2)
    edge = np.minimum.outer(
        np.minimum(np.arange(rows), np.arange(rows)[::-1]), np.minimum(np.arange(cols), np.arange(cols)[::-1])
    )
    ramp = np.clip(edge / 6.0, 0, 1)
    solved *= (ramp * ramp * (3 - 2 * ramp))[..., None]
    y, x = (np.arange(h) + 0.5) / step - 0.5, (np.arange(w) + 0.5) / step - 0.5
    grid = np.meshgrid(y, x, indexing="ij")
    return np.stack(
        [ndimage.map_coordinates(solved[..., k], grid, order=1, mode="nearest") for k in range(2)], axis=-1
    ).astype(np.float32)
