"""A posed character as the page needs it: one packet of what stays, and buffers of what moves."""

from __future__ import annotations

import colorsys
import io
import json
from typing import Any

import numpy as np
from numpy.typing import NDArray
from PIL import Image
from scipy.sparse.csgraph import dijkstra

from facewright.apps.export import face_looks
from facewright.apps.pose_session import PoseSession
from facewright.apps.posed_character import PosedCharacter
from facewright.mesh.connectivity import unique_edges
from facewright.mesh.geodesics import path_graph
from facewright.models.regions import Regions

#: A vertex farther than this from every vertex of the model cannot be grabbed, mm along the surface.
REACH_MM = 16.0

_NOSTRIL_LIGHT = 0.25
_HUES = 14
_LIGHTNESS, _SATURATION = (0.62, 0.52), (0.62, 0.55)


class PoseBody:
    """The character of a session, with a buffer of positions for each kind of model.

    Parameters
    ----------
    session : PoseSession
    character : PosedCharacter
    """

    def __init__(self, session: PoseSession, character: PosedCharacter) -> None:
        self.character = character
        self.positions = {kind: character.neutral.copy() for kind in session.kinds}
        self._looks, look = face_looks(character.topology)
        shown = look >= 0
        order = np.argsort(look[shown], kind="stable")
        self.faces = character.topology.faces[shown][order].astype(np.uint32)
        uv_faces = character.topology.uv_faces
        self._uv_faces = None if uv_faces is None else uv_faces[shown][order]
        self._look_of_face = look[shown][order]
        self.nearest, self._away = _nearest_handle(character)
        self._regions = session.model.regions

    def update(self, session: PoseSession) -> None:
        """Bring the positions to the session's pose."""
        for kind, out in self.positions.items():
            self.character.pose(kind, session.coefficients(kind), out)

    def packet(self, session: PoseSession) -> bytes:
        """Return what stays, for `fetchShared` of stream.js: the size of a JSON text, the text, arrays on 4 bytes."""
        V = len(self.character.neutral)
        look_of = np.zeros(V, dtype=np.uint8)
        look_of[self.faces] = self._look_of_face[:, None]
        membership = self._membership()
        colours = region_colours(self._regions, session.model.faces)
        arrays: dict[str, NDArray[Any]] = {
            "positions": self.character.neutral,
            "faces": self.faces.ravel(),
            "handles": self.character.handles.astype(np.uint32),
            "nearest": self.nearest.astype(np.int32),
            "handleRegion": _main_region(self._regions),
            "lookOf": look_of,
            "shade": self._shade(),
            "membership": np.rint(255 * membership).astype(np.uint8).ravel(),
            "regionColours": _tint(membership, colours),
        }
        if self.character.colors is not None:
            arrays["colours"] = self.character.colors.ravel()
        arrays.update(self._drawn())
        ends = np.searchsorted(self._look_of_face, np.arange(len(self._looks) + 1))
        groups = [
            {"look": name, "start": int(3 * ends[k]), "count": int(3 * (ends[k + 1] - ends[k]))}
            for k, name in enumerate(self._looks)
        ]
        shared = {
            "kinds": list(session.kinds),
            "regions": [region_title(name) for name in self._regions.names],
            "looks": list(self._looks),
            "groups": groups,
        }
        return _pack(shared, arrays)

    def _drawn(self) -> dict[str, NDArray[Any]]:
        """Return the vertices as they are drawn, one for each texture coordinate, and the skin's picture."""
        corners, texture, uv = self.faces.astype(np.int64), self.character.texture, self.character.topology.uv
        if self._uv_faces is None or texture is None or uv is None:
            return {"source": np.arange(len(self.character.neutral), dtype=np.uint32), "drawnFaces": self.faces.ravel()}
        keys = corners * len(uv) + self._uv_faces
        pairs, drawn = np.unique(keys, return_inverse=True)
        picture = io.BytesIO()
        Image.fromarray(texture).save(picture, "png", compress_level=4)
        return {
            "source": (pairs // len(uv)).astype(np.uint32),
            "drawnFaces": drawn.ravel().astype(np.uint32),
            "uv": (uv[pairs % len(uv)] * [1.0, -1.0] + [0.0, 1.0]).astype(np.float32).ravel(),
            "skin": np.frombuffer(picture.getvalue(), dtype=np.uint8),
        }

    def _shade(self) -> NDArray[np.uint8]:
        """Return how much light reaches each vertex (V,), 255 all: the insides of the nostrils lie in the dark."""
        masks = self.character.topology.masks
        light = np.ones((1, len(self.character.neutral)))
        light[0, masks.get("nostril_insides", np.zeros(0, int))] = _NOSTRIL_LIGHT
        smooth = 0.5 * light + 0.5 * _neighbour_mean(light, self.faces.astype(np.int64))
        return np.rint(255 * np.minimum(light, smooth)[0]).astype(np.uint8)

    def _membership(self) -> NDArray[np.float64]:
        """Return how much of each vertex lies in each region, (M, V): shared at boundaries, 0 out of reach."""
        members = np.zeros((len(self._regions.names), self._regions.n_vertices))
        for row, ids in zip(members, self._regions.members, strict=True):
            row[ids] = 1.0
        members /= members.sum(axis=0)
        reached = self.nearest >= 0
        result = np.zeros((len(members), len(self.nearest)))
        result[:, reached] = members[:, self.nearest[reached]]
        faces = self.faces.astype(np.int64)
        for _ in range(2):  # soft edges: a vertex takes half of what its neighbours have
            result = 0.5 * result + 0.5 * _neighbour_mean(result, faces)
        fade = np.clip(1.5 - self._away / REACH_MM, 0.0, 1.0)
        return result * np.where(np.isfinite(fade), fade, 0.0)


def region_title(name: str) -> str:
    """Return a region's name for people: ``region_03`` becomes "Region 3"."""
    head, _, number = name.rpartition("_")
    if head == "region" and number.isdigit():
        return f"Region {int(number)}"
    return name.replace("_", " ").capitalize()


def region_colours(regions: Regions, faces: NDArray[np.integer[Any]]) -> NDArray[np.uint8]:
    """Return sRGB colours (M, 3) such that regions that touch differ well.

    Hues around the circle; each region takes the hue farthest from those of its neighbours.
    """
    M = len(regions.names)
    member = np.zeros((M, regions.n_vertices), dtype=bool)
    for row, ids in zip(member, regions.members, strict=True):
        row[ids] = True
    touches = (member[:, faces].any(axis=2).astype(float) @ member[:, faces].any(axis=2).T.astype(float)) > 0
    n_hues = max(_HUES, M)
    hues = np.full(M, np.nan)
    free = np.arange(n_hues) / n_hues
    for region in np.argsort(-touches.sum(axis=1), kind="stable"):
        taken = hues[touches[region] & ~np.isnan(hues)]
        others = hues[~np.isnan(hues)]
        apart = np.ones(len(free)) if not len(taken) else _apart(free, taken)
        unlike = np.ones(len(free)) if not len(others) else _apart(free, others)
        best = int(np.argmax(np.minimum(apart, 0.25) + 0.5 * unlike))
        hues[region] = free[best]
        free = np.delete(free, best)
    bright = np.arange(M) % 2
    rgb = [colorsys.hls_to_rgb(h, _LIGHTNESS[b], _SATURATION[b]) for h, b in zip(hues, bright, strict=True)]
    return np.rint(255 * np.array(rgb)).astype(np.uint8)


def _apart(hues: NDArray[np.float64], others: NDArray[np.float64]) -> NDArray[np.float64]:
    away = np.abs(hues[:, None] - others)
    return np.minimum(away, 1.0 - away).min(axis=1)


def _tint(membership: NDArray[np.float64], colours: NDArray[np.uint8]) -> NDArray[np.uint8]:
    """Return RGBA (V, 4): the regions' colours mixed by membership, alpha where there are none."""
    total = membership.sum(axis=0)
    mixed = (membership.T @ colours) / np.maximum(total, 1e-9)[:, None]
    rgba = np.concatenate([mixed, 255.0 * np.clip(total, 0.0, 1.0)[:, None]], axis=1)
    return np.rint(np.clip(rgba, 0, 255)).astype(np.uint8).ravel()


def _main_region(regions: Regions) -> NDArray[np.int32]:
    """Return the first region of each vertex, (N,)."""
    main = np.full(regions.n_vertices, -1, dtype=np.int32)
    for k in range(len(regions.members) - 1, -1, -1):
        main[regions.members[k]] = k
    return main


def _nearest_handle(character: PosedCharacter) -> tuple[NDArray[np.int32], NDArray[np.float64]]:
    """Return for each vertex (V,) the model's vertex nearest along the surface, -1 beyond reach; and how far, mm."""
    graph = path_graph(character.neutral.astype(np.float64), character.topology.faces)
    away, _, source = dijkstra(
        graph, directed=False, indices=character.handles, min_only=True, return_predecessors=True, limit=2 * REACH_MM
    )
    number = np.full(len(character.neutral) + 1, -1, dtype=np.int32)
    number[character.handles] = np.arange(len(character.handles))
    nearest = number[np.where(source < 0, -1, source)]
    return np.where(away <= REACH_MM, nearest, -1).astype(np.int32), away


def _neighbour_mean(values: NDArray[np.float64], faces: NDArray[np.int64]) -> NDArray[np.float64]:
    edges = unique_edges(faces)
    V = values.shape[1]
    count = np.bincount(edges.ravel(), minlength=V)
    total = np.stack(
        [
            np.bincount(edges[:, 0], weights=row[edges[:, 1]], minlength=V)
            + np.bincount(edges[:, 1], weights=row[edges[:, 0]], minlength=V)
            for row in values
        ]
    )
    return np.where(count > 0, total / np.maximum(count, 1), values)


def _pack(shared: dict[str, Any], arrays: dict[str, NDArray[Any]]) -> bytes:
    """Lay arrays behind a JSON text that says where each begins."""
    blobs = [np.ascontiguousarray(array).tobytes() for array in arrays.values()]
    starts = np.concatenate([[0], np.cumsum([len(blob) + -len(blob) % 4 for blob in blobs])])
    types = [f"{array.dtype.kind}{array.dtype.itemsize}" for array in arrays.values()]

    def text(first: int) -> bytes:
        table = {
            name: [kind, int(first + start), int(array.size)]
            for (name, array), kind, start in zip(arrays.items(), types, starts, strict=False)
        }
        content = json.dumps({**shared, "arrays": table}).encode()
        return content + b" " * (-len(content) % 4)

    size, first = 0, 4
    while size != (size := len(text(first))):  # the numbers in the text depend on its length
        first = 4 + size
    head = text(first)
    padded = b"".join(blob + b"\0" * (-len(blob) % 4) for blob in blobs)
    return np.uint32(len(head)).tobytes() + head + padded
