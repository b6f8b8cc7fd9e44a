"""What a photo shows of a fitted head: which skin is seen, where its outline runs, how large it is."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage
from scipy.sparse.csgraph import dijkstra

from facewright.faces.face import Face
from facewright.imaging.mesh_view import MeshView
from facewright.imaging.rasterise import Fragments, rasterise
from facewright.mesh.geodesics import path_graph
from facewright.mesh.normals import vertex_normals
from facewright.numeric.check import check_shape

#: Kinds of triangles.
BODY, HEAD, INNER = 0, 1, 2

_HIDDEN_MM = 1.5  # a vertex may lie so far behind what the photo shows there
_FACING = (0.25, 0.75)  # cosine between normal and line of sight where trust begins and is full
_RISE_MM = 6.0  # over which trust rises from the edge of what is seen
_SKULL_TRUST = 0.02  # hair lies over it: it moves with the skull, not quite as its surface
_SKULL_OUTLINE = 0.02  # and its silhouette is not the skull's
_BEHIND = (-0.4, -0.1)  # cosine where the silhouette is skin that the photo does not show, and nearly does
_UNSEEN_OUTLINE = 0.15
_NECK_TRUST = 0.3  # collars and scarves lie over it
_NECK_MM = (-5.0, 55.0)  # below the chin: where the neck begins to stay behind the head, and where it rests
_TABLE = 512  # most pixels along a side of the outline's table


@dataclass(frozen=True, eq=False)
class SourceSurface:
    """A fitted head in the photo that it was fitted to; nothing here depends on what is to be drawn.

    Parameters
    ----------
    view : MeshView
        The mesh as the photo sees it, all parts.
    faces : ndarray of shape (F, 3), int32
        Its triangles.
    kinds : ndarray of shape (F,), uint8
        `HEAD` for skin of the head, `BODY` for the neck and what is below, `INNER` for eyes, teeth, mouth.
    weights : ndarray of shape (V, 4), float32
        How far a pixel of the skin is looked up where the mesh says; how much it tells the field around it; how much
        the silhouette tells that ends there; share of the head's motion that the neck takes part in.
    outline : ndarray of shape (h, w, 2), float32, pixels
        For places in the head's silhouette the nearest place on its outline, in the photo's pixels.
    outline_origin, outline_scale : (2,) pixels, and float
        Entry (j, i) of `outline` belongs to the pixel `outline_origin + (i, j) / outline_scale`.
    head_size : float
        Longer side of the head's box, without the neck, pixels.
    front : ndarray of shape (V,), bool
        Vertices of the face's own skin.
    seen : ndarray of shape (V,), float64
        How well the photo shows each vertex of the head's skin, 0 to 1, without steps.
    chin_vertex : int
        The lowest of the chin.
    chin, down : ndarray of shape (2,)
        The lowest point of the chin, pixels, and the direction from the eyes to it.
    """

    view: MeshView
    faces: NDArray[np.int32]
    kinds: NDArray[np.uint8]
    weights: NDArray[np.float32]
    outline: NDArray[np.float32]
    outline_origin: NDArray[np.float64]
    outline_scale: float
    head_size: float
    front: NDArray[np.bool_]
    seen: NDArray[np.float64]
    chin_vertex: int
    chin: NDArray[np.float64]
    down: NDArray[np.float64]

    @classmethod
    def of(cls, view: MeshView, face: Face) -> SourceSurface:
        """Analyse a fitted head.

        Raises
        ------
        ShapeError
            If the view does not have the face's vertices.
        """
        check_shape("source.pixels", view.pixels, face.topology.n_vertices, 2)
        masks = face.topology.masks
        faces = np.ascontiguousarray(face.topology.faces, dtype=np.int32)
        kinds = triangle_kinds(face)
        head = np.unique(faces[kinds == HEAD])
        lo, hi = view.pixels[head].min(axis=0) - 2, view.pixels[head].max(axis=0) + 2
        scale = min(_TABLE / max(*(hi - lo), 1.0), 2.0)
        columns, rows = (int(n) for n in np.ceil((hi - lo) * scale) + 1)
        shape = (rows, columns)
        at = (view.pixels - lo) * scale
        seen = rasterise(at, view.depth, faces, shape, perspective=view.perspective)
        cosine = facing(view, faces)
        trust = _trust(view, face, cosine, seen, at)
        front = np.zeros(len(trust), bool)
        front[masks["face_region"]] = True
        skin = np.arange(len(trust)) < face.n_skin
        skull = np.where(skin & ~front, _SKULL_TRUST, 0.0)
        body = np.unique(faces[kinds == BODY])
        skull[body] = 0
        mean = face.mean_shape
        lowest = masks["chin"][np.argmin(mean[masks["chin"], 1])]
        follows = _neck_share(mean, float(mean[lowest, 1]))
        skull[body] = _NECK_TRUST * (follows[body] > 0)
        blended = _rising(trust * front, mean, faces[kinds != INNER])
        told = np.maximum(blended, skull * (trust > 0))
        ends = np.where(_near(front, faces, 2), _bare(mean, masks), _SKULL_OUTLINE)
        ends *= np.clip((cosine - _BEHIND[0]) / (_BEHIND[1] - _BEHIND[0]), _UNSEEN_OUTLINE, 1)
        weights = np.column_stack([blended, told, ends, follows]).astype(np.float32)
        is_head = seen.covered & (kinds[np.maximum(seen.face_index, 0)] != BODY)
        eyes = np.concatenate([masks[f"eyelid_upper_{side}"] for side in ("left", "right")])
        down = view.pixels[lowest] - view.pixels[eyes].mean(axis=0)
        return cls(
            view=view,
            faces=faces,
            kinds=kinds,
            weights=weights,
            outline=_outline_table(is_head, lo, scale),
            outline_origin=lo,
            outline_scale=scale,
            head_size=float(max(hi - lo)),
            front=front,
            seen=_rising(trust * _of_head(faces[kinds == HEAD], len(trust)), mean, faces[kinds != INNER]),
            chin_vertex=int(lowest),
            chin=view.pixels[lowest],
            down=down / max(float(np.linalg.norm(down)), 1e-9),
        )


def triangle_kinds(face: Face) -> NDArray[np.uint8]:
    """Return for every triangle whether it is skin of the head, of the neck and below, or an inner part, (F,) uint8."""
    mean, masks = face.mean_shape, face.topology.masks
    chin = mean[masks["chin"], 1].min()
    front = np.zeros(len(mean), bool)
    front[masks["face_region"]] = True
    mouth = mean[masks["lips"], 1].mean()
    below = (mean[:, 1] < chin - 3.0) | ((mean[:, 1] < mouth) & ~front)
    faces = face.topology.faces
    kinds = np.where(below[faces].sum(axis=1) >= 2, BODY, HEAD).astype(np.uint8)
    kinds[(faces >= face.n_skin).any(axis=1)] = INNER
    return kinds


def facing(view: MeshView, faces: NDArray[np.int32]) -> NDArray[np.float64]:
    """Return the cosine between each vertex's normal and the line of sight, (V,)."""
    normals = vertex_normals(view.camera_vertices, faces)
    towards = -view.camera_vertices / np.linalg.norm(view.camera_vertices, axis=1, keepdims=True)
    return np.asarray((normals * towards).sum(axis=1), dtype=np.float64)


def _trust(
    view: MeshView, face: Face, cosine: NDArray[np.float64], seen: Fragments, at: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Return how well the photo shows each vertex, (V,) in [0, 1]."""
    shape = seen.depth.shape
    deepest = ndimage.maximum_filter(np.where(seen.covered, seen.depth, 0), 3)
    cells = np.round(at).astype(int)
    inside = ((cells >= 0) & (cells < (shape[1], shape[0]))).all(axis=1)
    cells = np.clip(cells, 0, (shape[1] - 1, shape[0] - 1))
    visible = inside & (view.depth <= deepest[cells[:, 1], cells[:, 0]] + _HIDDEN_MM)
    facing = np.clip((cosine - _FACING[0]) / (_FACING[1] - _FACING[0]), 0, 1)
    skin = np.arange(len(at)) < face.n_skin
    return np.asarray(visible * facing * skin, dtype=np.float64)


def _neck_share(mean: NDArray[np.floating], chin: float) -> NDArray[np.float64]:
    """Return the share of the head's motion that the neck at each vertex takes part in, (V,)."""
    t = np.clip((chin - mean[:, 1] - _NECK_MM[0]) / (_NECK_MM[1] - _NECK_MM[0]), 0, 1)
    return np.asarray(1 - t * t * (3 - 2 * t), dtype=np.float64)


def _bare(mean: NDArray[np.floating], masks: Mapping[str, NDArray[np.int32]]) -> NDArray[np.float64]:
    """Return how surely each vertex, where the silhouette runs, is not under hair: jaw and cheek are bare, (V,)."""
    eyes = mean[np.concatenate([masks["eyelid_upper_left"], masks["eyelid_upper_right"]]), 1].mean()
    top = mean[masks["forehead"], 1].max()
    t = np.clip((mean[:, 1] - eyes) / max(float(top - eyes), 1e-6), 0, 1)
    return np.asarray(1 - (1 - _SKULL_OUTLINE) * np.minimum(2 * t, 1), dtype=np.float64)


def _of_head(faces: NDArray[np.int32], n_vertices: int) -> NDArray[np.bool_]:
    """Return the vertices of triangles, (V,) bool."""
    result = np.zeros(n_vertices, np.bool_)
    result[faces] = True
    return result


def _near(region: NDArray[np.bool_], faces: NDArray[np.int32], rings: int) -> NDArray[np.bool_]:
    """Return the region and some rings of triangles around it, (V,) bool."""
    result = region.copy()
    for _ in range(rings):
        result[faces[result[faces].any(axis=1)]] = True
    return result


def _rising(
    values: NDArray[np.float64], vertices: NDArray[np.floating], faces: NDArray[np.int32]
) -> NDArray[np.float64]:
    """Return values that nowhere exceed the given ones and rise over some millimetres from where those are 0."""
    zero = np.flatnonzero(values <= 0)
    if not len(zero):
        return values
    graph = path_graph(vertices, faces)
    away = dijkstra(graph, indices=zero, min_only=True, limit=2 * _RISE_MM)
    t = np.clip(away / _RISE_MM, 0, 1)
    return np.asarray(values * t * t * (3 - 2 * t), dtype=np.float64)


def _outline_table(inside: NDArray[np.bool_], origin: NDArray[np.float64], scale: float) -> NDArray[np.float32]:
    """Return for each place in a silhouette the nearest place on its outline, in the photo's pixels, (h, w, 2)."""
    indices = ndimage.distance_transform_edt(np.pad(inside, 1), return_distances=False, return_indices=True)
    rows, columns = np.mgrid[: inside.shape[0], : inside.shape[1]]
    to = (indices[:, 1:-1, 1:-1] - 1)[::-1].transpose(1, 2, 0)
    here = np.stack([columns, rows], axis=-1)
    away = to - here
    distance = np.maximum(np.linalg.norm(away, axis=-1, keepdims=True), 1e-9)
    edge = here + away * np.maximum(1 - 0.5 / distance, 0)  # half a pixel before the first place outside
    return (edge / scale + origin).astype(np.float32)
