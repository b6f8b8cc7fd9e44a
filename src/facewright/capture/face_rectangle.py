"""Where the face is: the face rectangle of the reference frame, and the part of space that belongs to the head."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from facewright.camera.pinhole import Intrinsics, RigidMotion
from facewright.capture._tracking_kernels import keep_region
from facewright.capture.volume import camera_row
from facewright.errors import NoFaceError, ValueRangeError
from facewright.landmarks.points import Landmarks

Rectangle = tuple[int, int, int, int]

#: Of a head seen from the front, mm: what is searched where no detector tells the rectangle.
_HEAD_SIZE_MM = (200.0, 250.0)
#: From the nearest point of the face back to behind the ears.
HEAD_DEPTH_MM = 190.0
_BEFORE_FACE_MM = 40.0
_NECK_DEPTH_MM = 60.0
#: Where the chin is in a face rectangle, as a share of its height, if no landmarks tell.
_CHIN = 0.86
#: What a face must at least cover, square millimetres.
_LEAST_AREA_MM2 = 5_000.0
#: Pixels with depth that a face rectangle must hold.
_LEAST_PIXELS = 400
#: A pixel off its neighbour by more lies at an edge of depth.
EDGE_MM = 15.0


@dataclass(frozen=True, eq=False)
class HeadRegion:
    """The part of space that belongs to the head: a frustum of the reference camera, whose frame it is in.

    Parameters
    ----------
    intrinsics : Intrinsics
        The reference camera, full picture.
    box : (left, top, right, bottom), float
        Sides in its picture, pixels.
    near_mm, far_mm : float
        Depths it lies between.
    """

    intrinsics: Intrinsics
    box: tuple[float, float, float, float]
    near_mm: float
    far_mm: float

    @property
    def corners(self) -> NDArray[np.float64]:
        """The frustum's corners, shape (8, 3), millimetres."""
        k = self.intrinsics
        return np.array(
            [
                [(u - k.centre_x) / k.focal_x * z, (v - k.centre_y) / k.focal_y * z, z]
                for z in (self.near_mm, self.far_mm)
                for u in (self.box[0], self.box[2])
                for v in (self.box[1], self.box[3])
            ]
        )

    def grown(self, margin_mm: float) -> HeadRegion:
        """Return the region grown by a margin on all sides."""
        pixels = margin_mm * self.intrinsics.focal_x / self.near_mm
        left, top, right, bottom = self.box
        return HeadRegion(
            self.intrinsics,
            (left - pixels, top - pixels, right + pixels, bottom + pixels),
            max(self.near_mm - margin_mm, 1.0),
            self.far_mm + margin_mm,
        )

    def above(self, row: float) -> HeadRegion:
        """Return the part that moves as one with the skull: above a row of the picture, and not as far back.

        The neck bends and its lower end stays with the shoulders: tracked with it, turns come out 8 % too small.
        """
        left, top, right, bottom = self.box
        far = max(self.far_mm - _NECK_DEPTH_MM, self.near_mm + 0.5 * HEAD_DEPTH_MM)
        return HeadRegion(self.intrinsics, (left, top, right, min(row, bottom)), self.near_mm, far)

    def keep(
        self, depth: NDArray[np.float32], intrinsics: Intrinsics, region_from_frame: RigidMotion
    ) -> NDArray[np.float32]:
        """Return a frame's depth (H, W) where it lies in the region and not at an edge of depth; 0 elsewhere."""
        out = np.empty_like(depth)
        keep_region(
            depth, camera_row(intrinsics), np.ascontiguousarray(region_from_frame.rotation),
            region_from_frame.translation, camera_row(self.intrinsics), np.array(self.box, np.float64),
            self.near_mm, self.far_mm, EDGE_MM, out,
        )  # fmt: skip
        return out


def head_region(depth: NDArray[np.float32], intrinsics: Intrinsics, rectangle: Rectangle, frame: int) -> HeadRegion:
    """Return the head's region from the reference frame's depth (H, W) in the face rectangle.

    Raises
    ------
    NoFaceError
        If the rectangle holds too little depth.
    """
    left, top, right, bottom = rectangle
    inside = depth[top:bottom, left:right]
    high, wide = inside.shape
    # the middle half: the corners of the rectangle may see the wall or a shoulder
    middle = inside[high // 4 : high - high // 4, wide // 4 : wide - wide // 4]
    seen = middle[middle > 0]
    if np.count_nonzero(inside) < _LEAST_PIXELS or seen.size < _LEAST_PIXELS // 8:
        raise NoFaceError(
            f"frame {frame} must have depth in the face rectangle {rectangle}, got {np.count_nonzero(inside)} pixels: "
            "the face is out of the camera's view or range, or the rectangle is elsewhere."
        )
    nearest = float(np.percentile(seen, 2.0))
    side = 0.10 * max(wide, high)
    box = (left - side, top - side, right - 1 + side, bottom - 1 + side)
    return HeadRegion(intrinsics, box, max(nearest - _BEFORE_FACE_MM, 1.0), nearest + HEAD_DEPTH_MM)


def chin_row(rectangle: Rectangle, landmarks: Landmarks | None) -> float:
    """Return the row of the picture at which the head ends below."""
    if landmarks is not None:
        return landmarks.box[3]
    return rectangle[1] + _CHIN * (rectangle[3] - rectangle[1])


def check_rectangle(rectangle: Rectangle, size: tuple[int, int]) -> Rectangle:
    """Return a given face rectangle as plain integers, cut at the picture's border.

    Raises
    ------
    ValueRangeError
        If it is not (left, top, right, bottom) with at least 16 pixels a side inside the picture.
    """
    values = np.asarray(rectangle)
    if values.shape != (4,) or values.dtype.kind not in "iuf" or not np.isfinite(values).all():
        raise ValueRangeError(f"rectangle must be (left, top, right, bottom) in pixels, got {rectangle!r}.")
    height, width = size
    left, top, right, bottom = (int(v) for v in values)
    cut = max(left, 0), max(top, 0), min(right, width), min(bottom, height)
    if cut[2] - cut[0] < 16 or cut[3] - cut[1] < 16:
        raise ValueRangeError(
            f"rectangle must cover at least 16 x 16 pixels of the picture ({width} x {height}), got {rectangle!r}."
        )
    return cut


def rectangle_from_landmarks(landmarks: Landmarks, size: tuple[int, int]) -> Rectangle:
    """Return the face rectangle round detected landmarks, up to the hair line, within a picture of `size` (H, W)."""
    left, top, right, bottom = landmarks.box
    wide, high = right - left, bottom - top
    # the schemes with few points end at the brows
    above = 0.12 if landmarks.scheme == "mediapipe478" else 0.40
    around = (left - 0.15 * wide, top - above * high, right + 0.15 * wide + 1, bottom + 0.08 * high + 1)
    return check_rectangle((int(around[0]), int(around[1]), int(around[2]), int(around[3])), size)


def rectangle_from_depth(depth: NDArray[np.float32], intrinsics: Intrinsics, frame: int) -> Rectangle:
    """Guess the face rectangle where no detector tells it: the uppermost near thing of a face's size.

    Parameters
    ----------
    depth : ndarray of shape (H, W), float32, millimetres
        The reference frame.
    intrinsics : Intrinsics
        Its camera.
    frame : int
        Its number, for the message.

    Raises
    ------
    NoFaceError
        If nothing of a head's size has depth.
    """
    from scipy.ndimage import find_objects, label

    step = 2
    small = depth[::step, ::step].astype(np.float64)
    focal = intrinsics.focal_x / step
    nearest = _nearest_surface(small, focal)
    message = f"frame {frame} must have depth of a head, got {np.count_nonzero(depth)} pixels with depth."
    if nearest is None:
        raise NoFaceError(message)
    near = (small > 0) & (small < nearest + 0.6 * HEAD_DEPTH_MM)
    parts, _ = label(near)
    areas = np.bincount(parts.ravel(), weights=np.where(near, (small / focal) ** 2, 0.0).ravel())
    areas[0] = 0.0
    large = np.flatnonzero(areas >= _LEAST_AREA_MM2)
    if not large.size:
        raise NoFaceError(message)
    # the uppermost: the chest may be nearer and larger; parts are numbered by the row of their first pixel
    rows, columns = find_objects((parts == large[0]).astype(np.int32))[0]
    scale = intrinsics.focal_x / (nearest + 40.0)
    left, right = _around(columns.start * step, columns.stop * step, _HEAD_SIZE_MM[0] * scale)
    top, bottom = _around(rows.start * step, rows.stop * step, _HEAD_SIZE_MM[1] * scale, from_start=True)
    return check_rectangle((left, top, right, bottom), (depth.shape[0], depth.shape[1]))


def _nearest_surface(depth: NDArray[np.floating], focal: float) -> float | None:
    """Return the depth at which the nearest thing of a face's area begins, or None."""
    values = np.sort(depth[depth > 0].astype(np.float64))
    if not values.size:
        return None
    # square millimetres that each pixel covers, summed from the nearest on: a face has some 100 square centimetres
    area = np.cumsum((values / focal) ** 2)
    if area[-1] < _LEAST_AREA_MM2:
        return None
    return float(values[np.searchsorted(area, 1_000.0)])


def _around(start: int, stop: int, most: float, from_start: bool = False) -> tuple[int, int]:
    """Cut an interval to a length: about its middle, or from its start (the head is above the chest)."""
    if stop - start <= most:
        return start, stop
    first = start if from_start else 0.5 * (start + stop - most)
    return int(first), int(first + most)
