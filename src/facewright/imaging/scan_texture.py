"""The colours of a scan in the texture atlas of a mesh that was fitted to it."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from facewright.errors import ShapeError, TopologyError, ValueRangeError
from facewright.imaging.rasterise import rasterise
from facewright.imaging.texture import sample_bilinear, texels_from_uv
from facewright.io.mesh_data import MeshData
from facewright.mesh.closest_point import ClosestPoints
from facewright.mesh.topology import Topology
from facewright.numeric.check import check_shape

#: Colours of where the scan is not are spread from this much coarser picture, smoothly.
_SHRINK = 8


def bake_scan_texture(
    scan: MeshData,
    texture: NDArray[np.uint8] | None,
    vertices: NDArray[np.floating],
    topology: Topology,
    *,
    reach: float,
    size: int = 1024,
    textured: NDArray[np.bool_] | None = None,
) -> NDArray[np.uint8]:
    """Carry the colours of a scan into a mesh's texture atlas, from the scan's closest points.

    Parameters
    ----------
    scan : MeshData
        The scan, with texture coordinates or vertex colours.
    texture : ndarray of shape (H, W, 3), uint8, or None
        Its sRGB texture; None takes the vertex colours.
    vertices : ndarray of shape (V, 3), the scan's frame and unit
        The fitted mesh.
    topology : Topology
        With `uv` and `uv_faces`.
    reach : float, the scan's unit
        Texels further from the scan continue the colours around them.
    size : int
        Width and height of the texture.
    textured : ndarray of shape (V,), bool, optional
        Vertices that take colours from the scan, such as the skin; all where absent.

    Returns
    -------
    ndarray of shape (size, size, 3), uint8
        sRGB texture.

    Raises
    ------
    TopologyError
        If the topology has no texture coordinates.
    ShapeError, ValueRangeError
        If arrays do not match, the scan has no colours, or it is nowhere within reach.
    """
    if topology.uv is None or topology.uv_faces is None:
        raise TopologyError(f"topology {topology.name!r} must have texture coordinates (uv, uv_faces), got none.")
    check_shape("vertices", vertices, topology.n_vertices, 3)
    chosen = np.ones(len(topology.faces), bool)
    if textured is not None:
        check_shape("textured", textured, topology.n_vertices)
        chosen = textured[topology.faces].all(axis=1)
    texels = texels_from_uv(topology.uv, (size, size))
    atlas = rasterise(texels, np.zeros(len(texels)), topology.uv_faces[chosen], (size, size), perspective=False)
    inside = atlas.covered
    # float32 pictures of coordinates: relative to the middle, so that scans far from their origin keep their digits
    middle = np.asarray(vertices, np.float64).mean(axis=0)
    places = atlas.interpolate(topology.faces[chosen], np.asarray(vertices, np.float64) - middle)[inside] + middle
    found = ClosestPoints(scan.vertices, scan.faces).query(places, reach)
    near = found.faces >= 0
    if not near.any():
        raise ValueRangeError("the fitted mesh must lie on the scan to take its colours, got no texel within reach.")
    colours = np.zeros((len(places), 3), np.float32)
    colours[near] = _colours(scan, texture, found.faces[near], found.barycentric[near])
    picture = np.zeros((size, size, 3), np.float32)
    known = np.zeros((size, size), bool)
    picture[inside], known[inside] = colours, near
    return np.round(np.clip(_continued(picture, known), 0, 1) * 255).astype(np.uint8)


def _colours(
    scan: MeshData, texture: NDArray[np.uint8] | None, faces: NDArray[np.integer], weights: NDArray[np.float64]
) -> NDArray[np.float32]:
    """Return the scan's sRGB colours (N, 3) in [0, 1] at points of its triangles."""
    if texture is not None:
        if scan.uv is None or scan.uv_faces is None:
            raise ShapeError("a scan with a texture must have texture coordinates, got none.")
        positions = texels_from_uv(scan.uv, (texture.shape[0], texture.shape[1]))
        at = np.einsum("nk,nkc->nc", weights, positions[scan.uv_faces[faces]])
        low, high = np.floor(at.min(axis=0)).astype(int) - 2, np.ceil(at.max(axis=0)).astype(int) + 3
        low = np.clip(low, 0, [texture.shape[1] - 1, texture.shape[0] - 1])
        part = texture[low[1] : max(high[1], low[1] + 1), low[0] : max(high[0], low[0] + 1)]
        return sample_bilinear(part.astype(np.float32) / 255.0, at - low)
    if scan.vertex_colors is None:
        raise ValueRangeError("the scan must have a texture or vertex colours to bake, got neither.")
    return np.einsum("nk,nkc->nc", weights, scan.vertex_colors[scan.faces[faces]] / 255.0).astype(np.float32)


def _continued(picture: NDArray[np.float32], known: NDArray[np.bool_]) -> NDArray[np.float32]:
    """Fill what is not known of a picture (H, W, 3): nearest colours, smoothed away from where they are known."""
    nearest = ndimage.distance_transform_edt(~known, return_distances=False, return_indices=True)
    filled = picture[tuple(nearest)]
    away = ndimage.distance_transform_edt(~known).astype(np.float32)
    smooth = np.stack([ndimage.gaussian_filter(filled[..., k], _SHRINK) for k in range(3)], axis=2)
    weight = np.clip(away / (2.0 * _SHRINK), 0.0, 1.0)[..., None]
    return np.asarray((1.0 - weight) * filled + weight * smooth, dtype=np.float32)
