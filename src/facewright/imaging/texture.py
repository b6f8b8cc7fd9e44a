"""Textures: looking colours up, and baking a photograph onto a mesh that was fitted to it."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage, sparse
from scipy.sparse.csgraph import dijkstra
from scipy.sparse.linalg import splu

from facewright.errors import TopologyError
from facewright.imaging.rasterise import Fragments, rasterise
from facewright.imaging.render import Albedo
from facewright.mesh.geodesics import path_graph
from facewright.mesh.normals import vertex_normals
from facewright.mesh.topology import Topology
from facewright.numeric.check import check_shape

#: Over this distance along the skin the photo fades out beyond the face and before the ears.
_FADE_MM = 12.0
#: The least spread of skin's `_tone_features` over a face: brightness varies with the light, shares of colour little.
_TONE_FLOOR = (0.2, 0.018, 0.016)
#: Insides of nostrils and lash lines, as multiples of the skin's sRGB colour: a dark reddish brown.
_DARK = np.array([0.30, 0.19, 0.17])


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

    Texels of the face that the camera saw take the photo's colour; those it did not take the mirrored side's, and
    beyond that a smooth continuation of the skin that was seen. Ears, neck, scalp and the insides of the nostrils never
    show the photo, nor does the forehead where it is not skin-coloured: hair, collar and background lie there as often
    as skin. The face is the topology's mask ``face_region`` (or ``face``) without ``ears``, its skin tone that of
    ``cheeks_left`` and ``cheeks_right``; where either is missing, all is face.

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
    zones = _zones(topology, np.asarray(camera_vertices, np.float64), chosen)
    sampled = sample_bilinear(image, pixels)
    tone = _skin_tone(sampled, (weight > 0.6) & zones.cheeks, zones.masked)
    weight = weight * zones.photo
    mirror = np.arange(V) if topology.mirror is None else topology.mirror

    texels = texels_from_uv(uv, (size, size))
    atlas = rasterise(texels, np.zeros(len(uv)), uv_faces[chosen], (size, size), perspective=False)
    inside = atlas.covered
    columns = [np.asarray(pixels), weight[:, None], np.asarray(pixels)[mirror], weight[mirror][:, None]]
    values = atlas.interpolate(topology.faces[chosen], np.column_stack([*columns, zones.doubt]))
    own = sample_bilinear(image, values[inside, 0:2])
    other = sample_bilinear(image, values[inside, 3:5])
    doubt = values[..., 6]
    likeness = [_certain_skin(_likeness(c, tone), inside, doubt, size / 85) for c in (own, other)]

    corners = np.zeros((V, 2))
    corners[topology.faces[chosen]] = texels[uv_faces[chosen]]
    trusted = weight * sample_bilinear(likeness[0][..., None], corners)[:, 0] * _likeness(sampled, tone)
    filled = _continue_colours(sampled, trusted, topology.faces[chosen], tone.colour)
    filled = filled * (1 - zones.dark) + zones.dark * tone.colour * _DARK
    fallback = atlas.interpolate(topology.faces[chosen], filled)[inside]
    seen = (_ease(values[..., 2]) * likeness[0])[inside, None]
    # where hair hides the skin, the mirrored side's hair line would not fit
    hair = _ease(values[..., 2]) * (1 - likeness[0])
    seen_mirrored = (_ease(values[..., 5]) * likeness[1] * (1 - hair))[inside, None]
    texture = np.zeros((size, size, 3), np.float32)
    texture[inside] = seen * own + (1 - seen) * (seen_mirrored * other + (1 - seen_mirrored) * fallback)
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


@dataclass(frozen=True, eq=False)
class _Zones:
    """What the topology's masks say about each vertex, shape (V,); see `_zones`."""

    photo: NDArray[np.float64]
    doubt: NDArray[np.float64]
    dark: NDArray[np.float64]
    cheeks: NDArray[np.bool_]
    masked: bool


def _zones(topology: Topology, vertices: NDArray[np.float64], chosen: NDArray[np.bool_]) -> _Zones:
    """Return where the photo counts (0 to 1), where only its skin does, and where holes are dark."""
    V = topology.n_vertices
    graph = path_graph(vertices, topology.faces[chosen], diagonals=False)

    def mask(*names: str) -> NDArray[np.bool_]:
        out = np.zeros(V, bool)
        for name in names:
            out[topology.masks.get(name, [])] = True
        return out

    def away(source: NDArray[np.bool_]) -> NDArray[np.float64]:
        if not source.any():
            return np.full(V, np.inf)
        return np.asarray(dijkstra(graph, indices=np.flatnonzero(source), min_only=True))

    skin = np.zeros(V, bool)
    skin[topology.faces[chosen]] = True
    cheeks = mask("cheeks_left", "cheeks_right")
    ears, holes, lashes = mask("ears"), mask("nostril_insides"), mask("lash_line_left", "lash_line_right")
    face = mask("face_region" if "face_region" in topology.masks else "face") & ~ears
    lids = mask("eyelid_upper_left", "eyelid_upper_right")
    masked = bool(face.any() and cheeks.any())
    photo = skin.astype(np.float64)
    doubt = np.zeros(V)
    if masked:
        photo *= 1 - _ease(away(face) / _FADE_MM)
        photo *= _ease(away(ears) / _FADE_MM)
        # brows, lashes, lips, beards and shadows round the nose differ from the cheeks, and belong to the face
        features = mask("nose", "lips", "chin") | cheeks | lids | lashes
        near_brows = _ease(away(mask("brow_left", "brow_right")) / 4.0)  # a fringe may end just above them
        doubt = np.minimum(_ease((away(features) - 3.0) / 5.0), near_brows)
    photo *= _ease(away(holes) / 1.5)
    # of an open eye's lid the camera sees a narrow strip, mostly lashes: closed, it would smear over the lid
    photo *= np.where(lids, _ease(away(lashes) / 8.0), 1.0)
    dark = np.where(holes, _ease(away(~holes & skin) / 3.0), 0.0)
    dark = np.maximum(dark, 0.6 * (lashes & lids))[:, None]
    return _Zones(photo, doubt, dark, cheeks if masked else skin, masked)


@dataclass(frozen=True, eq=False)
class _SkinTone:
    """The cheeks' colour (3,), sRGB, and the place and spread of their `_tone_features`; none where unknown."""

    colour: NDArray[np.float64]
    middle: NDArray[np.float64] | None = None
    spread: NDArray[np.float64] | None = None


def _tone_features(colours: NDArray[np.floating]) -> NDArray[np.float64]:
    """Return logarithmic brightness, share of red, share of blue; (N, 3)."""
    lifted = np.asarray(colours, np.float64) + 0.02
    total = lifted.sum(axis=1)
    return np.stack([np.log(total), lifted[:, 0] / total, lifted[:, 2] / total], axis=1)


def _skin_tone(sampled: NDArray[np.floating], cheeks: NDArray[np.bool_], masked: bool) -> _SkinTone:
    """Take the skin's tone from the cheeks' vertices that the camera sees."""
    if not masked or cheeks.sum() < 10:
        return _SkinTone(np.median(sampled[cheeks], axis=0) if cheeks.any() else np.array([0.8, 0.6, 0.5]))
    features = _tone_features(sampled[cheeks])
    middle = np.median(features, axis=0)
    spread = 1.4826 * np.median(np.abs(features - middle), axis=0)
    return _SkinTone(np.median(sampled[cheeks], axis=0), middle, np.maximum(spread, _TONE_FLOOR))


def _likeness(colours: NDArray[np.floating], tone: _SkinTone) -> NDArray[np.float64]:
    """Return how much colours (N, 3) look like the cheeks, 0 to 1."""
    if tone.middle is None or tone.spread is None:
        return np.ones(len(colours))
    off = np.linalg.norm((_tone_features(colours) - tone.middle) / tone.spread, axis=1)
    return np.asarray(_ease((4.0 - off) / 1.5))


def _certain_skin(
    likeness: NDArray[np.floating], inside: NDArray[np.bool_], doubt: NDArray[np.floating], radius: float
) -> NDArray[np.float64]:
    """Return where colours are skin, as a picture of soft weights.

    What is not skin is spread by `radius` texels, and skin that hangs together with no part of the face beyond doubt
    (a bright lock of hair) is left out.
    """
    picture = np.ones(inside.shape)
    picture[inside] = 1 - doubt[inside] * (1 - likeness)
    width = 2 * round(radius) + 1
    shrunk = ndimage.minimum_filter(ndimage.median_filter(picture, 5), width)
    pieces, _ = ndimage.label((shrunk > 0.5) & inside)
    attached = np.unique(pieces[inside & (doubt < 0.05)])
    shrunk *= np.isin(pieces, attached[attached > 0])
    return 1 - doubt * (1 - ndimage.gaussian_filter(shrunk, 0.6 * radius))


def _continue_colours(
    sampled: NDArray[np.floating],
    weight: NDArray[np.floating],
    faces: NDArray[np.integer],
    typical: NDArray[np.floating],
) -> NDArray[np.float32]:
    """Extend the seen vertices' colours smoothly over the rest of the mesh (a screened Laplace equation)."""
    V = len(sampled)
    edges = np.concatenate([faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]])
    graph = sparse.coo_matrix((np.ones(len(edges)), (edges[:, 0], edges[:, 1])), shape=(V, V)).tocsr()
    graph = ((graph + graph.T) > 0).astype(np.float64)
    laplacian = sparse.diags(np.asarray(graph.sum(axis=1)).ravel()) - graph
    data = np.where(weight > 0.6, weight, 0.0) * 2.0
    screen = 4e-3  # far from anything seen, return to the colour of the cheeks
    system = (laplacian + sparse.diags(data + screen)).tocsc()
    filled = splu(system).solve(data[:, None] * sampled + screen * typical)
    return filled.astype(np.float32)
