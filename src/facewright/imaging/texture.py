"""Textures: looking colours up, and baking a photograph onto a mesh that was fitted to it."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage, sparse
from scipy.sparse.linalg import splu

from facewright.errors import TopologyError
from facewright.imaging.rasterise import Fragments, rasterise
from facewright.imaging.render import Albedo
from facewright.mesh.normals import vertex_normals
from facewright.mesh.topology import Topology
from facewright.numeric.check import check_shape


def sample_bilinear(image: NDArray[np.floating], points: NDArray[np.floating]) -> NDArray[np.float32]:
    """Look an image (H, W, C) up at pixel positions (N, 2), x right and y down; edges are repeated; (N, C)."""
    y, x = points[:, 1], points[:, 0]
    return np.stack(
        [ndimage.map_coordinates(image[..., k], [y, x], order=1, mode="nearest") for k in range(image.shape[2])], axis=1
    ).astype(np.float32)


def texels_from_uv(uv: NDArray[np.floating], size: tuple[int, int]) -> NDArray[np.float64]:
    """Convert texture coordinates (v upwards, [0, 1] over the whole image) to pixel positions (U, 2)."""
    height, width = size
    return np.stack([uv[:, 0] * width - 0.5, (1.0 - uv[:, 1]) * height - 0.5], axis=1).astype(np.float64)


def texture_albedo(
    texture: NDArray[np.uint8],
    topology: Topology,
    *,
    textured: NDArray[np.bool_] | None = None,
    rest: Albedo | None = None,
) -> Callable[[Fragments], NDArray[np.float32]]:
    """Make the albedo function of a textured mesh for `render_mesh`.

    Parameters
    ----------
    texture : ndarray of shape (H, W, 3), uint8
        sRGB texture in the topology's uv atlas.
    topology : Topology
        With `uv` and `uv_faces`; the rendered triangles must be its `faces`.
    textured : ndarray of shape (V,), bool, optional
        Vertices that the texture covers; all where absent.
    rest : ndarray of shape (V, 3), or a function of Fragments to (H, W, 3), optional
        sRGB colours in [0, 1] of the rest; grey where absent.

    Raises
    ------
    TopologyError
        If the topology has no texture coordinates.
    ShapeError
        If `textured` or `rest` has another number of vertices.
    """
    uv, uv_faces = _require_uv(topology)
    positions = texels_from_uv(uv, (texture.shape[0], texture.shape[1]))
    scaled = texture.astype(np.float32) / 255.0
    chosen = _chosen_faces(topology, textured)
    plain = np.full((topology.n_vertices, 3), 0.7) if rest is None else rest
    if not callable(plain):
        check_shape("rest", plain, topology.n_vertices, 3)

    def albedo(fragments: Fragments) -> NDArray[np.float32]:
        out = plain(fragments) if callable(plain) else fragments.interpolate(topology.faces, plain)
        out = np.array(out, dtype=np.float32)
        on_texture = fragments.covered & chosen[fragments.face_index]
        out[on_texture] = sample_bilinear(scaled, fragments.interpolate(uv_faces, positions)[on_texture])
        return out

    return albedo


def bake_texture(
    photo: NDArray[np.uint8],
    pixels: NDArray[np.floating],
    camera_vertices: NDArray[np.floating],
    topology: Topology,
    *,
    size: int = 1024,
    textured: NDArray[np.bool_] | None = None,
    perspective: bool = False,
) -> NDArray[np.uint8]:
    """Carry the photograph that a mesh was fitted to into the mesh's texture atlas.

    Texels that the camera saw take the photo's colour; those it did not take the mirrored side's, and beyond that a
    smooth continuation of the skin that was seen.

    Parameters
    ----------
    photo : ndarray of shape (H, W, 3), uint8
        sRGB photograph.
    pixels : ndarray of shape (V, 2), pixels
        Projected vertices.
    camera_vertices : ndarray of shape (V, 3), millimetres
        Vertices in the camera's frame.
    topology : Topology
        With `uv` and `uv_faces`.
    size : int
        Width and height of the texture.
    textured : ndarray of shape (V,), bool, optional
        Vertices that take colours from the photo, such as the skin; all where absent.
    perspective : bool
        Whether `pixels` come from a pinhole.

    Returns
    -------
    ndarray of shape (size, size, 3), uint8
        sRGB texture; texels outside the atlas repeat the nearest inside.

    Raises
    ------
    ShapeError, TopologyError
        If arrays do not match or the topology has no texture coordinates.
    """
    uv, uv_faces = _require_uv(topology)
    V = topology.n_vertices
    check_shape("pixels", pixels, V, 2)
    check_shape("camera_vertices", camera_vertices, V, 3)
    chosen = _chosen_faces(topology, textured)
    image = photo.astype(np.float32) / 255.0
    weight = _visibility((image.shape[0], image.shape[1]), pixels, camera_vertices, topology.faces, perspective)
    skin = np.zeros(V, bool)
    skin[topology.faces[chosen]] = True
    weight = weight * skin
    cheeks = np.zeros(V, bool)
    for name in ("cheeks_left", "cheeks_right"):
        cheeks[topology.masks.get(name, [])] = True
    colours = _continue_colours(sample_bilinear(image, pixels), weight, topology.faces[chosen], cheeks)

    texels = texels_from_uv(uv, (size, size))
    atlas = rasterise(texels, np.zeros(len(uv)), uv_faces[chosen], (size, size), perspective=False)
    inside = atlas.covered
    own = [np.asarray(pixels), weight[:, None]]
    mirror = np.arange(V) if topology.mirror is None else topology.mirror
    other = [np.asarray(pixels)[mirror], weight[mirror][:, None]]
    values = atlas.interpolate(topology.faces[chosen], np.concatenate([*own, *other, colours], axis=1))[inside]
    seen, seen_mirrored = _ease(values[:, 2:3]), _ease(values[:, 5:6])
    fallback = values[:, 6:9]
    fallback = seen_mirrored * sample_bilinear(image, values[:, 3:5]) + (1 - seen_mirrored) * fallback
    texture = np.zeros((size, size, 3), np.float32)
    texture[inside] = seen * sample_bilinear(image, values[:, 0:2]) + (1 - seen) * fallback
    nearest = ndimage.distance_transform_edt(~inside, return_distances=False, return_indices=True)
    texture = texture[tuple(nearest)]
    return np.round(np.clip(texture, 0, 1) * 255).astype(np.uint8)


def _require_uv(topology: Topology) -> tuple[NDArray[np.float32], NDArray[np.int32]]:
    if topology.uv is None or topology.uv_faces is None:
        raise TopologyError(f"topology {topology.name!r} must have texture coordinates (uv, uv_faces), got none.")
    return topology.uv, topology.uv_faces


def _chosen_faces(topology: Topology, textured: NDArray[np.bool_] | None) -> NDArray[np.bool_]:
    """Return which triangles the texture covers, shape (F,)."""
    if textured is None:
        return np.ones(len(topology.faces), bool)
    check_shape("textured", textured, topology.n_vertices)
    return np.asarray(textured, bool)[topology.faces].all(axis=1)


def _ease(weight: NDArray[np.floating]) -> NDArray[np.floating]:
    w = np.clip(weight, 0, 1)
    return w * w * (3 - 2 * w)


def _visibility(
    size: tuple[int, int],
    pixels: NDArray[np.floating],
    camera_vertices: NDArray[np.floating],
    faces: NDArray[np.integer],
    perspective: bool,
    tolerance_mm: float = 2.5,
) -> NDArray[np.float64]:
    """Return how well the camera sees each vertex: 0 hidden or grazing, 1 frontal; shape (V,)."""
    height, width = size
    depth = np.asarray(camera_vertices)[:, 2]
    x, y = np.round(pixels[:, 0]).astype(int), np.round(pixels[:, 1]).astype(int)
    in_frame = (x >= 0) & (x < width) & (y >= 0) & (y < height)
    buffer = rasterise(pixels, depth, faces, size, perspective=perspective).depth
    # the deepest of the neighbouring pixels, so that steep but visible skin does not hide itself
    buffer = ndimage.maximum_filter(np.where(np.isfinite(buffer), buffer, -np.inf), 3)
    ahead = np.zeros(len(pixels), bool)
    ahead[in_frame] = depth[in_frame] <= buffer[y[in_frame], x[in_frame]] + tolerance_mm
    normals = vertex_normals(np.asarray(camera_vertices, np.float64), faces)
    facing = -normals[:, 2]
    # grazing skin is left out: a pixel's error in the fit would paint background or hair on it
    return np.clip((facing - 0.35) / 0.35, 0, 1) * ahead


def _continue_colours(
    sampled: NDArray[np.floating],
    weight: NDArray[np.floating],
    faces: NDArray[np.integer],
    typical_vertices: NDArray[np.bool_],
) -> NDArray[np.float32]:
    """Extend the seen vertices' colours smoothly over the rest of the mesh (a screened Laplace equation)."""
    V = len(sampled)
    edges = np.concatenate([faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]])
    graph = sparse.coo_matrix((np.ones(len(edges)), (edges[:, 0], edges[:, 1])), shape=(V, V)).tocsr()
    graph = ((graph + graph.T) > 0).astype(np.float64)
    laplacian = sparse.diags(np.asarray(graph.sum(axis=1)).ravel()) - graph
    confident = weight > 0.6
    shown = confident & typical_vertices if (confident & typical_vertices).any() else confident
    typical = np.median(sampled[shown], axis=0) if shown.any() else np.array([0.8, 0.6, 0.5])
    data = np.where(confident, weight, 0.0) * 2.0
    screen = 1e-3  # far from anything seen, return to the colour of the cheeks
    system = (laplacian + sparse.diags(data + screen)).tocsc()
    filled = splu(system).solve(data[:, None] * sampled + screen * typical)
    return filled.astype(np.float32)
