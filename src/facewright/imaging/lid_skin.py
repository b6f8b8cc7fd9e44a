"""Skin of the upper lid where the photo has none: folded away or squeezed to a strip while the eye is open."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numba import njit
from numpy.typing import NDArray
from scipy import ndimage, sparse
from scipy.sparse.linalg import splu
from scipy.spatial import cKDTree

from facewright.faces.face import Face
from facewright.imaging.inner_parts import SKIN, Opening, paint_map
from facewright.imaging.mesh_view import MeshView
from facewright.imaging.photo_light import PhotoLight, harmonics
from facewright.imaging.texture import sample_bilinear
from facewright.imaging.wide_blur import wide_blur
from facewright.mesh.connectivity import vertex_adjacency

_LASH_MM = 1.6  # so close to the lash line the photo shows lashes
_BROW_MM = 2.0
#: A lid that is stretched by these factors over its size in the photo begins to be, and is wholly, drawn.
_STRETCH = (1.35, 2.4)
#: Closing by so many millimetres begins to, and does, need lid skin.
_CLOSING_MM = (0.4, 2.0)
_SPREAD = 3
#: Lids nearer than this are shut; lashes of shut eyes cover so much beside their line.
_SHUT_MM, _MARGIN_MM = 2.0, 3.5
#: Closed lids are darker towards the lashes: how much, and over how many millimetres.
_LASH_SHADE, _LASH_SHADE_MM = 0.18, 2.5
_CREASE_SHADE = 0.10
_GRAIN_BELOW_MM = 13.0


@dataclass(frozen=True, eq=False)
class LidSkin:
    """What the upper lid of one eye looks like, and when it is needed.

    Parameters
    ----------
    colours : ndarray of shape (M, 3), float32
        sRGB in [0, 255] at the vertices of the opening: clean skin of the lid and its surroundings, continued smoothly.
    zone : ndarray of shape (M,), float32
        Where the lid's skin may be drawn, 0 to 1.
    lash_mm : ndarray of shape (M,), float32
        Distance to the lash line on the generic face.
    lash_colour : ndarray of shape (5,), float32
        sRGB in [0, 255] of the lash line, its opacity in [0, 1] and its width, mm.
    grain : ndarray of shape (M, 2), float32, pixels
        Where in the photo each vertex takes the skin's fine texture from: below the eye.
    """

    colours: NDArray[np.float32]
    zone: NDArray[np.float32]
    lash_mm: NDArray[np.float32]
    lash_colour: NDArray[np.float32]
    grain: NDArray[np.float32]
    _faces: NDArray[np.int32]
    _area: NDArray[np.float64]
    _normals: NDArray[np.float64]
    _gap: NDArray[np.float64]
    _smooth: sparse.csr_matrix
    _scale: float

    def weights(self, opening: Opening, pixels: NDArray[np.floating], gap_mm: NDArray[np.floating]) -> NDArray:
        """Return how far each vertex of the opening needs lid skin in a view, (M,) in [0, 1].

        Parameters
        ----------
        opening : Opening
            The eye.
        pixels : ndarray of shape (M, 2)
            Its vertices in the view.
        gap_mm : ndarray of shape (K,)
            Distance between the lids at the pairs of vertices that meet in a blink.
        """
        closing = float(np.percentile(self._gap - gap_mm, 75)) if len(gap_mm) else 0.0
        amount = _ease((closing - _CLOSING_MM[0]) / (_CLOSING_MM[1] - _CLOSING_MM[0]))
        if amount <= 0:
            # lids that part leave the line of lashes behind in which they met
            was_shut = 1 - np.clip(self._gap / _SHUT_MM, 0, 1)[opening.pair]
            parted = was_shut * np.clip((gap_mm - self._gap) / _SHUT_MM, 0, 1)[opening.pair]
            return np.asarray(parted * np.clip(_MARGIN_MM - self.lash_mm, 0, 1), np.float32)
        area = front_areas(np.ascontiguousarray(pixels, np.float64), self._faces)
        grown = np.median(area[self.zone == 0].clip(1e-6)) / self._scale  # the whole picture may be larger
        stretch = area / np.maximum(self._area * grown, 1e-3 * self._scale)
        low, high = np.log(_STRETCH)
        need = _ease((np.log(np.maximum(stretch, 1e-3)) - low) / (high - low))
        # the margin below the stretched skin turns away, and the skin above shall go over softly
        need = self._smooth @ spread_over(need, self._faces, _SPREAD)
        return np.asarray(self.zone * amount * np.clip(need, 0, 1), np.float32)

    def lash_line(
        self, opening: Opening, pixels: NDArray[np.floating], weights: NDArray[np.floating]
    ) -> NDArray[np.float64]:
        """Return the upper lid's lash line where the photo's own is covered by lid skin.

        Parameters
        ----------
        opening : Opening
            The eye.
        pixels : ndarray of shape (M, 2)
            Its vertices in the view.
        weights : ndarray of shape (M,)
            From `weights`.

        Returns
        -------
        ndarray of shape (K, 4)
            Points of the line: x, y, how strong it is in [0, 1], and its width as a share of that of `lash_colour`.
        """
        upper = opening.upper
        strength = np.zeros(len(weights))
        np.maximum.at(strength, opening.pair, np.asarray(weights, np.float64) * (self.lash_mm < 2.0))
        at = pixels[upper].astype(np.float64)
        order = np.argsort(at[:, 0])
        across = np.linspace(-1.0, 1.0, len(order)) if len(order) else np.zeros(0)
        strength = ndimage.gaussian_filter1d(strength[: len(upper)][order], 0.08 * len(order), mode="nearest")
        ends = np.clip((1.0 - np.abs(across)) / 0.2, 0.0, 1.0)
        width = 0.75 + 0.35 * (1.0 - across * across)
        return np.column_stack([at[order], strength * ends, width])

    def shaded(self, normals: NDArray[np.floating], light: PhotoLight) -> NDArray[np.float32]:
        """Return `colours` in the light that the lid gets in a view with unit normals (M, 3)."""
        luminance = light.terms @ np.array([0.2126, 0.7152, 0.0722])
        floor = 0.1 * abs(luminance[0])
        lid = np.flatnonzero(self.zone)
        now = np.maximum(harmonics(np.asarray(normals[lid], np.float64)) @ luminance, floor)
        then = np.maximum(harmonics(self._normals[lid]) @ luminance, floor)
        result = self.colours.copy()
        # sRGB values go with about the 2.2nd root of light
        result[lid] *= (np.clip(now / then, 0.5, 1.8) ** (1.0 / 2.2)).astype(np.float32)[:, None]
        return np.asarray(np.minimum(result, 255.0), np.float32)


def lid_skin(photo: NDArray[np.uint8], source: MeshView, face: Face, opening: Opening) -> LidSkin:
    """Collect the lid's skin from a photo.

    Parameters
    ----------
    photo : ndarray of shape (H, W, 3), uint8
        The photo.
    source : MeshView
        The fitted mesh as the photo sees it.
    face : Face
        Its topology.
    opening : Opening
        The eye.
    """
    ids = opening.vertices
    pixels, seen = source.pixels[ids], source.camera_vertices[ids]
    skin_faces = opening.faces[opening.kinds <= 1]
    skin = np.zeros(len(ids), bool)
    skin[skin_faces] = True
    area = front_areas(pixels, skin_faces)
    attributes = paint_map(face).columns(paint_map(face).attributes)
    lash = np.minimum(attributes["lash"][ids], 30.0)
    mean = face.mean_shape[ids].astype(np.float64)
    zone = _zone(face, opening, mean)
    px_per_mm = _scale_of(pixels, seen, skin_faces)
    clean = _clean(source, face, opening, mean, lash, area, max(_LASH_MM, 2.0 / px_per_mm))
    adjacency = vertex_adjacency(skin_faces, len(ids)).astype(np.float64)
    degree = np.maximum(np.asarray(adjacency.sum(axis=1)).ravel(), 1.0)
    spread = (sparse.diags(0.4 / degree) @ adjacency + sparse.diags(np.full(len(ids), 0.6))).tocsr()
    colours = _continued(photo, pixels, clean, adjacency, degree, px_per_mm)
    normals = unit_normals(np.ascontiguousarray(seen, np.float64), skin_faces)
    for _ in range(6):  # what the colours were taken from is not the fold
        normals = spread @ normals
    normals /= np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-9)
    gap = np.linalg.norm(seen[opening.upper] - seen[opening.lower], axis=1)
    hidden = opening.hidden > 0.5
    return LidSkin(
        colours=colours * _relief(face, opening, lash)[:, None],
        zone=zone.astype(np.float32),
        lash_mm=lash.astype(np.float32),
        lash_colour=_lash_colour(photo, pixels, lash, skin & (lash < 0.7), colours, px_per_mm),
        grain=_grain_places(face, opening, pixels, mean, skin),
        _faces=np.ascontiguousarray(skin_faces),
        _area=np.where(hidden, 0.0, area),
        _normals=normals,
        _gap=gap,
        _smooth=spread,
        _scale=float(np.median(area[zone == 0].clip(1e-6))),
    )


def _ease(value: NDArray[np.floating] | float) -> NDArray[np.float64]:
    w = np.clip(value, 0.0, 1.0)
    return np.asarray(w * w * (3 - 2 * w))


def _scale_of(pixels: NDArray, seen: NDArray, faces: NDArray[np.int32]) -> float:
    """Return pixels per millimetre."""
    a, b = faces[:, 0], faces[:, 1]
    flat = np.linalg.norm((pixels[a] - pixels[b]), axis=1)
    long = np.linalg.norm((seen[a] - seen[b])[:, :2], axis=1)
    return float(flat.sum() / max(float(long.sum()), 1e-9))


def _zone(face: Face, opening: Opening, mean: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return 1 on the upper lid and its margin, falling to 0 above it."""
    masks = face.topology.masks
    lid = masks[f"eyelid_upper_{opening.name}"]
    index = face.blendshape_names.index(f"eyeBlink_{opening.name[0].upper()}")
    motion = np.linalg.norm(face.blendshape_deltas[index][opening.vertices], axis=1)
    moving = _ease((motion - 0.6) / 2.0)
    near = cKDTree(face.mean_shape[lid].astype(np.float64)).query(mean)[0]
    lower = face.mean_shape[masks[f"lid_contact_lower_{opening.name}"]].astype(np.float64)
    upper = face.mean_shape[masks[f"lid_contact_upper_{opening.name}"]].astype(np.float64)
    above = cKDTree(lower).query(mean)[0] > cKDTree(upper).query(mean)[0]
    return np.asarray(moving * _ease((3.0 - near) / 3.0) * above)


def _relief(face: Face, opening: Opening, lash: NDArray[np.floating]) -> NDArray[np.float32]:
    """Return what the closed lid's form does to its brightness, (M,): darker at lashes and crease, lighter between."""
    index = face.blendshape_names.index(f"eyeBlink_{opening.name[0].upper()}")
    motion = np.linalg.norm(face.blendshape_deltas[index][opening.vertices], axis=1)
    share = motion / max(float(motion.max()), 1e-9)
    crease = _CREASE_SHADE * np.exp(-(((share - 0.3) / 0.1) ** 2))
    bulge = 0.4 * _CREASE_SHADE * np.exp(-(((share - 0.65) / 0.15) ** 2))
    return np.asarray((1 - _LASH_SHADE * np.exp(-lash / _LASH_SHADE_MM)) * (1 - crease + bulge), np.float32)


def _grain_places(
    face: Face, opening: Opening, pixels: NDArray[np.floating], mean: NDArray[np.float64], skin: NDArray[np.bool_]
) -> NDArray[np.float32]:
    """Lay the closed lid out over the cheek below the eye, (M, 2) pixels of the photo."""
    index = face.blendshape_names.index(f"eyeBlink_{opening.name[0].upper()}")
    closed = mean + face.blendshape_deltas[index][opening.vertices]
    design = np.column_stack([mean[skin, :2], np.ones(int(skin.sum()))])
    affine, *_ = np.linalg.lstsq(design, pixels[skin], rcond=None)
    shifted = np.column_stack([closed[:, 0], closed[:, 1] - _GRAIN_BELOW_MM, np.ones(len(closed))])
    return np.asarray(shifted @ affine, np.float32)


def _clean(
    source: MeshView,
    face: Face,
    opening: Opening,
    mean: NDArray[np.float64],
    lash: NDArray[np.floating],
    area: NDArray[np.float64],
    lash_mm: float,
) -> NDArray[np.float64]:
    """Return how surely the photo shows bare skin at each vertex, (M,) in [0, 1]."""
    ids = opening.vertices
    masks = face.topology.masks
    skin = np.zeros(len(ids), bool)
    skin[opening.faces[opening.kinds == SKIN]] = True
    normals = unit_normals(np.ascontiguousarray(source.camera_vertices[ids], np.float64), opening.faces)
    facing = np.clip((-normals[:, 2] - 0.25) / 0.25, 0, 1)
    result = np.where(skin, facing, 0.0) * (1 - np.clip(2 * opening.hidden, 0, 1))
    result *= np.clip((lash - lash_mm) / 1.0, 0, 1)
    brow = face.mean_shape[masks[f"brow_{opening.name}"]].astype(np.float64)
    result *= np.clip((cKDTree(brow).query(mean)[0] - _BROW_MM) / 2.0, 0, 1)
    margin = face.mean_shape[masks[f"eyelid_upper_{opening.name}"]].astype(np.float64)
    result *= np.clip((26.0 - cKDTree(margin).query(mean)[0]) / 6.0, 0, 1)
    return np.asarray(result * np.clip(area / 1.5, 0, 1))


def _continued(
    photo: NDArray[np.uint8],
    pixels: NDArray[np.floating],
    clean: NDArray[np.float64],
    adjacency: sparse.csr_matrix,
    degree: NDArray[np.float64],
    px_per_mm: float,
) -> NDArray[np.float32]:
    """Continue the colours of clean skin over the vertices: a screened Laplace equation."""
    lo = np.floor(pixels.min(axis=0)).astype(int)
    hi = np.ceil(pixels.max(axis=0)).astype(int)
    x0, y0 = np.clip(lo - 4, 0, np.array(photo.shape[1::-1]) - 1)
    x1, y1 = np.clip(hi + 5, 1, np.array(photo.shape[1::-1]))
    sigma = max(0.6, 0.5 * px_per_mm)
    crop = wide_blur(photo[y0:y1, x0:x1].astype(np.float32), sigma)
    sampled = sample_bilinear(crop, pixels - (x0, y0)).astype(np.float64)
    brightness = np.log(sampled.mean(axis=1) + 5.0)
    sure = clean > 0.5
    if sure.sum() >= 8:  # strands of hair, rims of glasses
        middle = np.median(brightness[sure])
        spread = max(1.4826 * float(np.median(np.abs(brightness[sure] - middle))), 0.08)
        clean = clean * np.clip(2.0 - np.abs(brightness - middle) / (2.5 * spread), 0, 1)
    total = clean.sum()
    typical = (clean @ sampled) / total if total > 1e-6 else np.median(sampled, axis=0)
    system = sparse.diags(degree + 0.8 * clean + 1e-4) - adjacency
    right = 0.8 * clean[:, None] * sampled + 1e-4 * typical
    smooth = splu(system.tocsc()).solve(right)
    # next to lashes and folds all is dark and grey; shaded skin is redder than that
    share = (np.maximum(smooth.mean(axis=1), 1.0) / typical.mean())[:, None] ** 0.65
    warm = typical * share ** np.array([0.85, 1.05, 1.15])
    return np.asarray(0.15 * smooth + 0.85 * warm, np.float32)


def _lash_colour(
    photo: NDArray[np.uint8],
    pixels: NDArray[np.floating],
    lash: NDArray[np.floating],
    line: NDArray[np.bool_],
    colours: NDArray[np.float32],
    px_per_mm: float,
) -> NDArray[np.float32]:
    """Return the colour of the photo's lash line, and how opaque it is against the lid."""
    width = max(0.5, 0.5 / px_per_mm)  # never so thin that it goes under in a small picture
    if not line.any():
        return np.array([40, 28, 24, 0.7, width], np.float32)
    around = np.concatenate([pixels[line] + (0, d * px_per_mm) for d in (-0.8, 0.0, 0.8)])
    low = np.maximum(np.floor(around.min(axis=0)).astype(int) - 1, 0)
    high = np.ceil(around.max(axis=0)).astype(int) + 2
    crop = photo[low[1] : high[1], low[0] : high[0]].astype(np.float32)
    if crop.size == 0:
        return np.array([40, 28, 24, 0.7, width], np.float32)
    seen = sample_bilinear(crop, around - low)
    dark = seen[seen.sum(axis=1) <= np.percentile(seen.sum(axis=1), 30)].mean(axis=0)
    lid = colours[line].mean(axis=0)
    # never lighter than a soft shadow: even fair lashes close the eye with a line
    colour = np.minimum(dark, 0.62 * lid)
    return np.append(colour, [0.85, width]).astype(np.float32)


@njit(cache=True, nogil=True)
def spread_over(values, faces, rounds):  # type: ignore[no-untyped-def]
    """Return for each vertex the largest value within so many edges, (V,)."""
    result = values.copy()
    for _ in range(rounds):
        before = result.copy()
        for f in range(len(faces)):
            top = max(before[faces[f, 0]], before[faces[f, 1]], before[faces[f, 2]])
            for k in range(3):
                result[faces[f, k]] = max(result[faces[f, k]], top)
    return result


@njit(cache=True, nogil=True)
def front_areas(pixels, faces):  # type: ignore[no-untyped-def]
    """Return the area in pixels of the triangles round each vertex that face the camera, (V,)."""
    area = np.zeros(len(pixels))
    for f in range(len(faces)):
        a, b, c = faces[f, 0], faces[f, 1], faces[f, 2]
        double = (pixels[c, 0] - pixels[a, 0]) * (pixels[b, 1] - pixels[a, 1]) - (pixels[b, 0] - pixels[a, 0]) * (
            pixels[c, 1] - pixels[a, 1]
        )
        if double > 0:
            area[a] += double
            area[b] += double
            area[c] += double
    return area / 6.0


@njit(cache=True, nogil=True)
def unit_normals(vertices, faces):  # type: ignore[no-untyped-def]
    """Return unit normals (V, 3) weighted by area; zero without a triangle. As `mesh.normals`, without temporaries."""
    normals = np.zeros(vertices.shape)
    for f in range(len(faces)):
        a, b, c = faces[f, 0], faces[f, 1], faces[f, 2]
        ux, uy, uz = vertices[b, 0] - vertices[a, 0], vertices[b, 1] - vertices[a, 1], vertices[b, 2] - vertices[a, 2]
        vx, vy, vz = vertices[c, 0] - vertices[a, 0], vertices[c, 1] - vertices[a, 1], vertices[c, 2] - vertices[a, 2]
        nx, ny, nz = uy * vz - uz * vy, uz * vx - ux * vz, ux * vy - uy * vx
        for k in (a, b, c):
            normals[k, 0] += nx
            normals[k, 1] += ny
            normals[k, 2] += nz
    for k in range(len(vertices)):
        length = np.sqrt(normals[k, 0] ** 2 + normals[k, 1] ** 2 + normals[k, 2] ** 2)
        if length > 0:
            for i in range(3):
                normals[k, i] /= length
    return normals
