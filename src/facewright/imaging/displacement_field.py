"""Where each pixel of a wanted picture lies in the photo: the skin's own motion, extended smoothly around the head."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from facewright.errors import ValueRangeError
from facewright.faces.face import Face
from facewright.imaging._warp_kernels import compose, gather_skin, mark_breaks
from facewright.imaging.followed_points import meet_points
from facewright.imaging.jacobian import Untangled, untangle
from facewright.imaging.membrane import stretch_membrane
from facewright.imaging.mesh_view import MeshView
from facewright.imaging.rasterise import Fragments, rasterise
from facewright.imaging.source_surface import BODY, SourceSurface
from facewright.numeric.check import check_shape

_CELLS = 56  # of the lattice, along the head
_DATA, _PINNED, _BORDER = 4.0, 1.5, 4.0  # strengths, beside a membrane of stiffness 1
_SOFT = 0.2  # stiffness beyond
_PER_DISPLACEMENT = 3.2  # the field reaches beyond the hair by so many times the largest displacement, at least
_FREE = 0.12  # width of the neck beside the jaw that follows as it must, as a share of the head
_FAR = 0.08  # a silhouette that slides farther, as a share of the head, tells less
_BAND = 0.04  # so near the picture's border, as a share of the head, skin says less
_ALIGNED = 8  # cells: where windows may begin
_LEAST = 0.03  # pixels: smaller displacements are none


@dataclass(frozen=True, eq=False)
class HeadMap:
    """Where the pixels of a box of the target picture lie in the photo.

    Parameters
    ----------
    origin : (x, y)
        First pixel of the box.
    displacement : ndarray of shape (h, w, 2), float32, pixels
        Source position minus target position; exactly 0 where nothing moves.
    fragments : Fragments
        What the pixels of a smaller box see of the mesh; the box starts at `fragments_origin`.
    layer : ndarray, uint8
        Kind of what they see (`HEAD`, `INNER`), 0 for none, and for the neck.
    fragments_origin : (x, y)
        First pixel of that box.
    breaks : ndarray, bool
        Pixels of that box at whose right or lower side one surface may end before another.
    share : ndarray of shape (h, w), float32
        How far the mesh itself decides a pixel's displacement.
    smallest_jacobian : float
        Smallest determinant of the map, but at true occlusions.
    """

    origin: tuple[int, int]
    displacement: NDArray[np.float32]
    fragments: Fragments
    layer: NDArray[np.uint8]
    fragments_origin: tuple[int, int]
    breaks: NDArray[np.bool_]
    share: NDArray[np.float32]
    smallest_jacobian: float


class HeadField:
    """Inverse maps from target views of one head to the photo that it was fitted to.

    Parameters
    ----------
    surface : SourceSurface
        What the photo shows.
    size : (height, width)
        Size of the photo.
    hair, reach, neck : float
        As shares of the head's size: how far out everything follows nearly rigidly; how far beyond that the field
        ends, or farther where displacements are large; how far below the chin nothing moves.
    outline : float
        How firmly the photo's silhouette follows the mesh's, beside a membrane of stiffness 1.
    """

    def __init__(
        self,
        surface: SourceSurface,
        size: tuple[int, int],
        *,
        hair: float = 0.14,
        reach: float = 0.22,
        neck: float = 0.24,
        outline: float = 4.0,
    ) -> None:
        self.surface, self.size, self._outline = surface, size, outline
        self._followed: NDArray[np.int32] | None = None
        self._hair, self._reach, self._neck = (float(share * surface.head_size) for share in (hair, reach, neck))
        self.step = max(1, round(surface.head_size / _CELLS))
        rows, cols = -(-size[0] // self.step), -(-size[1] // self.step)
        self._lattice = (rows, cols)
        self._head = np.unique(surface.faces[surface.kinds != BODY])
        self._told = self._head[surface.weights[self._head, 0] > 0.2]
        below = np.unique(surface.faces[surface.kinds == BODY])
        self._moving = np.union1d(self._head, below[surface.weights[below, 3] > 0])
        self._prepare_distance()
        self._attributes = np.concatenate([surface.view.pixels.astype(np.float32), surface.weights], axis=1)
        self._table = np.array([*surface.outline_origin, surface.outline_scale], np.float32)

    def follow(self, vertices: NDArray[np.integer]) -> None:
        """Let maps look vertices (K,) up exactly where the photo shows them, see `meet_points`: rims of mouth and eyes.

        For targets whose mouth and eyes show what they show in the photo.
        """
        self._followed = np.asarray(vertices, dtype=np.int32)

    def _prepare_distance(self) -> None:
        """Measure, on the lattice's part around the head in the photo, how far each cell is from it."""
        view, s = self.surface.view, self.step
        pixels = view.pixels[self._head]
        wide = int(np.ceil(1.2 * self.surface.head_size / s))
        first = np.floor(pixels.min(axis=0) / s).astype(int) - wide
        last = np.ceil(pixels.max(axis=0) / s).astype(int) + wide
        cols, rows = (int(n) for n in last - first)
        at = (view.pixels + 0.5) / s - 0.5 - first
        seen = rasterise(at, view.depth, self.surface.faces, (rows, cols), perspective=view.perspective)
        head = seen.covered & (self.surface.kinds[np.maximum(seen.face_index, 0)] != BODY)
        head[rows // 2, cols // 2] = True  # a head of a pixel or two may cover no cell's centre
        self._first = first
        self._away = ndimage.gaussian_filter(ndimage.distance_transform_edt(~head) * s, 1.0).astype(np.float32)
        self._source_box = (first + wide, last - wide)

    def _distance_at(self, x: NDArray[np.float64], y: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return the distance of places (pixels) from the head in the photo, pixels; continuous in the place."""
        rows, cols = self._away.shape
        i, j = (y + 0.5) / self.step - 0.5 - self._first[1], (x + 0.5) / self.step - 0.5 - self._first[0]
        k, m = np.clip(i, 0, rows - 1), np.clip(j, 0, cols - 1)
        beyond = self.step * np.hypot(i - k, j - m)
        return np.asarray(ndimage.map_coordinates(self._away, [k, m], order=1, mode="nearest") + beyond)

    def _distance(self, window: tuple[int, int, int, int], target: MeshView) -> NDArray[np.float64]:
        """Return how far each cell is from where the head was and is: no jumps from frame to frame, (rows, columns).

        The head's silhouette in the target is taken as the photo's, moved by the best similarity.
        """
        top, left, rows, cols = window
        y, x = (np.mgrid[top : top + rows, left : left + cols] + 0.5) * self.step - 0.5
        then, now = (v.pixels[self._head] @ (1.0, 1.0j) for v in (self.surface.view, target))
        arms = then - then.mean()
        turn = (arms.conj() @ (now - now.mean())) / max(float((np.abs(arms) ** 2).sum()), 1e-9)
        if abs(turn) < 0.05:
            turn = 1.0 + 0.0j
        back = (x + 1j * y - now.mean()) / turn + then.mean()
        return np.minimum(self._distance_at(x, y), abs(turn) * self._distance_at(back.real, back.imag))

    def map_of(self, target: MeshView) -> HeadMap | None:
        """Return the map from a target view, or None where nothing moves.

        Raises
        ------
        ShapeError
            If the view does not have the face's vertices.
        ValueRangeError
            If the head lies wholly outside the picture, or not wholly before the camera.
        """
        surface = self.surface
        check_shape("target.pixels", target.pixels, len(surface.weights), 2)
        source = surface.view.pixels
        motion = source[self._head] - target.pixels[self._head]
        if not np.abs(motion).max() > 0:
            return None
        boxes = self._boxes(target)
        x0, y0, x1, y1 = boxes
        shifted = target.pixels - (x0, y0)
        seen = rasterise(shifted, target.depth, surface.faces, (y1 - y0, x1 - x0), perspective=target.perspective)
        told = source[self._told] - target.pixels[self._told]
        largest = float(np.linalg.norm(told, axis=1).max()) if len(told) else 0.0
        window, reach = self._window(boxes, largest)
        cells = np.zeros((8, window[2], window[3]), np.float32)
        own, blend, layer = gather_skin(
            seen.face_index,
            seen.barycentric,
            (x0, y0),
            surface.faces,
            surface.kinds,
            self._attributes,
            surface.outline,
            self._table,
            self.step,
            window,
            cells,
            np.float32(_FAR * surface.head_size),
            np.float32(self._outline / _DATA * self.step),  # a cell has about `step` pixels of outline
            (np.float32(self.size[0]), np.float32(self.size[1])),
            np.float32(_BAND * surface.head_size),
        )
        field, solid = self._extend(cells, window, reach, largest, target)
        s = self.step
        left, top = window[1] * s, window[0] * s
        size = (min(window[2] * s, self.size[0] - top), min(window[3] * s, self.size[1] - left))
        displacement, share = compose(
            field, solid, (left, top), size, window, s, own, blend, (x0, y0), np.float32(_LEAST)
        )
        if self._followed is not None:
            moved, shown = (view.pixels[self._followed] for view in (target, surface.view))
            meet_points(displacement, (left, top), moved, shown, surface.head_size)
        breaks = mark_breaks(seen.depth, layer, np.float32(self._depth_jump(target)))
        done: Untangled = untangle(displacement, breaks, (x0 - left, y0 - top))
        return HeadMap((left, top), displacement, seen, layer, (x0, y0), breaks, share, done.smallest)

    def _boxes(self, target: MeshView) -> tuple[int, int, int, int]:
        """Return the box (x0, y0, x1, y1) of the target's head and neck in the picture; refuse one that has none."""
        nearest = float(target.depth[self._head].min()) if target.perspective else np.inf
        if not nearest > 0:
            raise ValueRangeError(
                f"the head must lie before the camera to be drawn, got a view with a depth of {nearest:.1f} mm: "
                "move it along the camera's axis."
            )
        pixels = target.pixels[self._moving]
        lo, hi = np.floor(pixels.min(axis=0)) - 1, np.ceil(pixels.max(axis=0)) + 2
        x0, y0 = np.maximum(lo, 0)
        x1, y1 = np.minimum(hi, (self.size[1], self.size[0]))
        if not (x1 > x0 and y1 > y0):
            raise ValueRangeError(
                f"the head must lie at least partly in the picture of {self.size[1]} x {self.size[0]} pixels, got "
                f"a view of it from ({lo[0]:.0f}, {lo[1]:.0f}) to ({hi[0]:.0f}, {hi[1]:.0f}): move it less."
            )
        return int(x0), int(y0), int(x1), int(y1)

    def _window(self, box: tuple[int, int, int, int], largest: float) -> tuple[tuple[int, int, int, int], float]:
        """Return first row, first column, rows and columns of the lattice's part that moves, and its reach, pixels."""
        reach = self._hair + max(self._reach, _PER_DISPLACEMENT * largest)
        s = self.step
        top, left, bottom, right = box[1] // s, box[0] // s, -(-box[3] // s), -(-box[2] // s)
        first, last = self._source_box
        top, left = min(top, max(first[1], 0)), min(left, max(first[0], 0))
        bottom, right = max(bottom, min(last[1], self._lattice[0])), max(right, min(last[0], self._lattice[1]))
        wide = int(np.ceil(reach / s)) + 3
        # coarser grids of the membrane lie alike from frame to frame
        top, left = (max(int(k) - wide, 0) // _ALIGNED * _ALIGNED for k in (top, left))
        bottom, right = min(int(bottom) + wide, self._lattice[0]), min(int(right) + wide, self._lattice[1])
        return (top, left, bottom - top, right - left), reach

    def _extend(
        self,
        cells: NDArray[np.float32],
        window: tuple[int, int, int, int],
        reach: float,
        largest: float,
        target: MeshView,
    ) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
        """Return the field (2, rows, columns) on the lattice, and how solid the head's silhouette is there."""
        surface, s = self.surface, self.step
        top, left, rows, cols = window
        area = np.float32(s * s)
        cover = cells[0] / area
        distance = self._distance(window, target)
        hair = self._hair
        away = np.clip((distance - hair) / max(reach - hair, 1e-6), 0, 1)
        stiffness = _SOFT + (1 - _SOFT) * np.clip(2 - distance / hair, 0, 1)
        scale = _DATA / area
        weight = np.empty((2, rows, cols), np.float32)
        weight[:] = scale * (cells[1] + cells[4])
        moment = scale * cells[2:4]
        # beside the jaw the neck is squeezed or stretched, there is no seam
        free = np.clip(distance / (_FREE * surface.head_size), 0, 1).astype(np.float32)
        weight += scale * free * cells[5]
        moment += scale * free * cells[6:8]
        weight += self._pinned(window, largest, target)
        # nothing is looked up beyond the picture's border
        if left == 0:
            weight[0, :, 0] += _BORDER
        if left + cols == self._lattice[1]:
            weight[0, :, -1] += _BORDER
        if top == 0:
            weight[1, 0] += _BORDER
        if top + rows == self._lattice[0]:
            weight[1, -1] += _BORDER
        field = stretch_membrane(weight, moment, stiffness, away >= 1)
        solid = ndimage.minimum_filter(np.minimum(cover, 1), 3, mode="nearest")
        return field, solid.astype(np.float32)

    def _pinned(self, window: tuple[int, int, int, int], largest: float, target: MeshView) -> NDArray[np.float32]:
        """Return how firmly each cell is held where it is: the base of the neck, shoulders, (rows, columns)."""
        surface, s = self.surface, self.step
        top, left, rows, cols = window
        x = (np.arange(cols) + left + 0.5) * s - 0.5
        y = (np.arange(rows) + top + 0.5) * s - 0.5
        moved = target.pixels[self.surface.chin_vertex]
        lowest = max(float(surface.chin @ surface.down), float(moved @ surface.down))
        below = y[:, None] * surface.down[1] + x[None, :] * surface.down[0] - lowest
        start = 0.04 * surface.head_size
        length = max(self._neck, 1.6 * largest)
        t = np.clip((below - start) / length, 0, 1)
        return np.asarray(_PINNED * t * t, dtype=np.float32)

    def _depth_jump(self, target: MeshView) -> float:
        """Return the step in depth, millimetres, between neighbouring pixels of two different surfaces."""
        vertices = target.camera_vertices[self._head]
        pixels = target.pixels[self._head]
        millimetres = np.ptp(vertices[:, 1]) / max(float(np.ptp(pixels[:, 1])), 1e-6)
        return 1.0 + 4.0 * float(millimetres)


def displacement_field(source: MeshView, target: MeshView, face: Face, size: tuple[int, int]) -> NDArray[np.float32]:
    """Return, for every pixel of the target picture, where it lies in the source picture, relative to itself.

    Parameters
    ----------
    source, target : MeshView
        The mesh as both pictures see it, all parts.
    face : Face
        Its topology.
    size : (height, width)
        Size of both pictures.

    Returns
    -------
    ndarray of shape (H, W, 2), float32, pixels
        Source position minus target position; exactly zero beyond the margin.

    Raises
    ------
    ShapeError
        If a view does not have the face's vertices.
    ValueRangeError
        If the target's head lies wholly outside the picture, or not wholly before the camera.
    """
    result = np.zeros((*size, 2), np.float32)
    found = HeadField(SourceSurface.of(source, face), size).map_of(target)
    if found is not None:
        (x, y), (h, w) = found.origin, found.displacement.shape[:2]
        result[y : y + h, x : x + w] = found.displacement
    return result
