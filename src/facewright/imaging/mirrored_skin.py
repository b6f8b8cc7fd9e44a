"""Skin that the photo hides on the far side of a turned head, taken from its mirror image on the near side."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage
from scipy.sparse.csgraph import dijkstra

from facewright.faces.face import Face
from facewright.imaging._mirror_kernels import paint_mirrored
from facewright.imaging.mesh_view import MeshView
from facewright.imaging.rasterise import Fragments, rasterise
from facewright.imaging.source_surface import BODY, HEAD, INNER, SourceSurface, facing
from facewright.imaging.wide_blur import block_means
from facewright.mesh.geodesics import path_graph
from facewright.mesh.normals import vertex_normals
from facewright.numeric.check import check_shape
from facewright.numeric.similarity import estimate_similarity

_BEYOND_MM = (4.0, 22.0)  # from the face and the ears: where hair may be, the mirrored side ends
_TURNED = (0.03, 0.17)  # growth of the cosine between normal and line of sight over which it comes
_UNCOVERED = (0.0, 0.06)  # the same where the background would be seen instead
_SHOWN = 0.12  # so little as the photo shows of the other side is better than the background
_ASIDE = (0.1, 0.16)  # sine of the head's turn in the photo from which the far side's mirror image shows more
_NECK_MM = 7.0
_MIDDLE_MM = 12.0  # from the middle plane: where the far side begins
_INWARDS = 0.02  # of the head's size: so far inside the person's old outline it begins
_SMOOTH = 0.04  # of the head's size: the light varies no faster
_SPREAD_MM = 12.0  # so far ratios of light reach
_MOST = 0.6  # of the logarithm of a ratio of light
_SAMPLES = 600
_LEAST = 40  # vertices that must show both sides


@dataclass(frozen=True, eq=False)
class MirroredSkin:
    """What a photo shows of one side of a head for what it hides of the other.

    Parameters
    ----------
    surface : SourceSurface
        What the photo shows.
    ids : ndarray of shape (N,), int
        Vertices that the photo does not show, but their mirror images.
    weights : ndarray of shape (N, 2)
        How far each is better taken from the other side, 0 to 1: where the picture shows the person there already, and
        where it shows what lies behind.
    normals : ndarray of shape (N, 3)
        Their normals in the photo's view.
    cosines : ndarray of shape (N,)
        Between those and the lines of sight.
    attributes : ndarray of shape (V, 5), float32
        Pixel of the mirror image, and ratios of red, green and blue (sRGB) between here and there.
    near : ndarray of shape (F,), bool
        Triangles with such vertices.
    """

    surface: SourceSurface
    ids: NDArray[np.intp]
    weights: NDArray[np.float64]
    normals: NDArray[np.float64]
    cosines: NDArray[np.float64]
    attributes: NDArray[np.float32]
    near: NDArray[np.bool_]

    @classmethod
    def of(cls, photo: NDArray[np.uint8], surface: SourceSurface, face: Face) -> MirroredSkin | None:
        """Find what the other side can give; None where it has no more to show."""
        mirror = face.topology.mirror
        if mirror is None:
            return None
        seen, view = surface.seen, surface.view
        shown = seen[mirror] * (1 - seen)
        for side in (-1, 1):  # folds of an ear are hidden by what lies beside them
            ear = face.topology.masks.get("ears", np.zeros(0, np.int32))
            ear = ear[side * face.mean_shape[ear, 0] > 0]
            if len(ear):
                shown[ear] = np.maximum(shown[ear], np.percentile(shown[ear], 80))
        cosine = facing(view, surface.faces)
        sine, far = _far_side(surface, face, mirror)
        turned = np.clip((sine - _ASIDE[0]) / (_ASIDE[1] - _ASIDE[0]), 0, 1)
        far *= _above_neck(surface, face)
        over = (far if sine > np.mean(_ASIDE) else 0 * far) * np.clip(shown * (1 - seen) / _SHOWN, 0, 1)
        weights = turned * far * (1 - seen) * seen[mirror] * _region(surface, face)
        ids = np.flatnonzero((over > 0.02) | (weights > 0.02))
        if not len(ids):
            return None
        ratio = _ratios(photo, surface, face, mirror, ids)
        if ratio is None:
            return None
        attributes = np.zeros((len(seen), 5), np.float32)
        attributes[:, :2] = view.pixels[mirror]
        attributes[:, 2:] = 1
        attributes[ids, 2:] = ratio
        chosen = np.zeros(len(seen), bool)
        chosen[ids] = True
        near = chosen[surface.faces].any(axis=1) & (surface.kinds == HEAD)
        normals = vertex_normals(view.camera_vertices, surface.faces)[ids]
        return cls(surface, ids, np.column_stack([weights, over])[ids], normals, cosine[ids], attributes, near)

    def held(self, share: NDArray[np.floating]) -> MirroredSkin:
        """Return the same with less of it, by a share for each vertex (V,): where an outline is in doubt."""
        check_shape("share", share, len(self.attributes))
        return replace(self, weights=self.weights * np.asarray(share)[self.ids, None])

    def paint(
        self,
        image: NDArray[np.uint8],
        touched: NDArray[np.bool_],
        photo: NDArray[np.uint8 | np.float32],
        target: MeshView,
        fragments: Fragments,
        origin: tuple[int, int],
        share: NDArray[np.uint8] | None = None,
    ) -> None:
        """Draw over a picture, in place, what has come into view.

        Parameters
        ----------
        image : ndarray of shape (h, w, 3), uint8
            A part of the picture.
        touched : ndarray of shape (h, w), bool
            Set where it is changed.
        photo : ndarray of shape (H, W, 3), uint8 or float32
            Where it is taken from.
        target : MeshView
            What the picture shows.
        fragments : Fragments
            Its visible surface, in a box that begins at `origin` of the part.
        share : ndarray of shape (h, w), uint8, optional
            The person's share of the part's pixels; all where absent.
        """
        then, now = self.surface.view.camera_vertices, target.camera_vertices
        every = self.surface.faces[self.surface.kinds == HEAD][::97, 0]
        turn = estimate_similarity(then[every], now[every]).rotation
        sight = -now[self.ids] / np.linalg.norm(now[self.ids], axis=1, keepdims=True)
        grown = ((self.normals @ turn.T) * sight).sum(axis=1) - self.cosines
        weights = np.zeros((len(self.attributes), 2), np.float32)
        for k, (least, full) in enumerate((_TURNED, _UNCOVERED)):
            # what lies in folds faces anywhere: where the background would be seen it comes with the rest
            by = grown if k == 0 else np.maximum(grown, np.percentile(grown, 75))
            t = np.clip((by - least) / (full - least), 0, 1)
            weights[self.ids, k] = self.weights[:, k] * t * t * (3 - 2 * t)
        if weights.any():
            person = np.full((1, 1), 255, np.uint8)
            if share is not None:
                person = self._within(share, fragments, origin)
            paint_mirrored(
                image, touched, photo, fragments.face_index, fragments.barycentric, origin, self.surface.faces,
                self.near, weights, self.attributes, person,
            )  # fmt: skip

    def _within(self, share: NDArray[np.uint8], fragments: Fragments, origin: tuple[int, int]) -> NDArray[np.uint8]:
        """Return the person's share, drawn back from their outline, where the mesh is seen, (h, w)."""
        (x, y), (h, w) = origin, fragments.face_index.shape
        by = max(1, round(_INWARDS * self.surface.head_size))
        part = ndimage.minimum_filter(share[y : y + h, x : x + w], 2 * by + 1, mode="nearest")
        return np.asarray(ndimage.uniform_filter(part, by, mode="nearest"))


def _far_side(surface: SourceSurface, face: Face, mirror: NDArray[np.int32]) -> tuple[float, NDArray[np.float64]]:
    """Return the sine of the head's turn in the photo, and how far each vertex is on its far side, (V,)."""
    x = face.mean_shape[:, 0].astype(np.float64)
    front = np.flatnonzero(surface.front & (x > 0))
    across = (surface.view.camera_vertices[front] - surface.view.camera_vertices[mirror[front]]).sum(axis=0)
    sight = surface.view.camera_vertices[surface.front].mean(axis=0)
    sine = float(across @ sight / max(float(np.linalg.norm(across) * np.linalg.norm(sight)), 1e-9))
    return abs(sine), np.clip(np.sign(sine) * x / _MIDDLE_MM, 0, 1)


def _above_neck(surface: SourceSurface, face: Face) -> NDArray[np.float64]:
    """Return 0 where the neck begins, rising to 1, (V,)."""
    graph = path_graph(face.mean_shape, surface.faces[surface.kinds != INNER])
    body = np.unique(surface.faces[surface.kinds == BODY])
    if not len(body):
        return np.ones(len(surface.front))
    return np.clip(dijkstra(graph, indices=body, min_only=True, limit=2 * _NECK_MM) / _NECK_MM, 0, 1)


def _region(surface: SourceSurface, face: Face) -> NDArray[np.float64]:
    """Return 1 for face and ears, falling to 0 where hair may lie, (V,)."""
    core = surface.front.copy()
    if "ears" in face.topology.masks:
        core[face.topology.masks["ears"]] = True
    skin = np.unique(surface.faces[surface.kinds == HEAD])
    graph = path_graph(face.mean_shape, surface.faces[surface.kinds == HEAD])
    away = dijkstra(graph, indices=np.flatnonzero(core), min_only=True, limit=2 * _BEYOND_MM[1])
    t = np.clip((away - _BEYOND_MM[0]) / (_BEYOND_MM[1] - _BEYOND_MM[0]), 0, 1)
    result = np.zeros(len(core))
    result[skin] = (1 - t * t * (3 - 2 * t))[skin]
    return result


def _ratios(
    photo: NDArray[np.uint8], surface: SourceSurface, face: Face, mirror: NDArray[np.int32], ids: NDArray[np.intp]
) -> NDArray[np.float64] | None:
    """Return how bright each vertex would be beside its mirror image, (N, 3), from where the photo shows both."""
    mean = face.mean_shape.astype(np.float64)
    both = np.flatnonzero((surface.seen > 0.3) & (surface.seen[mirror] > 0.3) & surface.front)
    if len(both) < _LEAST:
        return None
    both = both[:: -(-len(both) // _SAMPLES)]
    ratio = np.log(_colours(photo, surface, both) / _colours(photo, surface, mirror[both]))
    ratio = np.clip(ratio, -_MOST, _MOST)
    apart = ((mean[ids, None] - mean[None, both]) ** 2).sum(axis=2)
    nearest = apart.min(axis=1, keepdims=True)
    share = surface.seen[both] * np.exp(-(apart - nearest) / (2 * _SPREAD_MM**2))
    return np.asarray(np.exp(share @ ratio / share.sum(axis=1, keepdims=True)))


def _colours(photo: NDArray[np.uint8], surface: SourceSurface, ids: NDArray[np.intp]) -> NDArray[np.float64]:
    """Return the photo's smooth colours at vertices, (N, 3), at least one level."""
    pixels, size = surface.view.pixels, surface.head_size
    (x0, y0), (x1, y1) = surface.outline_origin, surface.outline_origin + size
    x0, y0 = max(int(x0), 0), max(int(y0), 0)
    part = photo[y0 : max(int(y1) + 1, y0 + 1), x0 : max(int(x1) + 1, x0 + 1)]
    n = max(1, int(0.4 * _SMOOTH * size))
    small = block_means(part.astype(np.float32), n)
    at = (pixels - (x0, y0) + 0.5) / n - 0.5
    view = surface.view
    shown = rasterise(at, view.depth, surface.faces, (small.shape[0], small.shape[1]), perspective=view.perspective)
    faces = np.maximum(shown.face_index, 0)
    skin = shown.covered & (surface.kinds[faces] == HEAD) & surface.front[surface.faces].all(axis=1)[faces]
    weight = ndimage.binary_erosion(skin, iterations=2).astype(np.float32)[..., None] + np.float32(1e-6)
    blur = (_SMOOTH * size / n,) * 2 + (0,)
    small = ndimage.gaussian_filter(small * weight, blur) / ndimage.gaussian_filter(weight, blur)
    at = at[ids].T[::-1]
    found = [ndimage.map_coordinates(small[..., c], at, order=1, mode="nearest") for c in range(3)]
    return np.maximum(np.stack(found, axis=1).astype(np.float64), 1.0)
