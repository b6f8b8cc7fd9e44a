"""A truncated signed distance volume of what depth maps saw (Curless and Levoy 1996; KinectFusion)."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from facewright.camera.pinhole import Intrinsics, RigidMotion
from facewright.capture._volume_kernels import BLOCK, TILE, cast_rays, depth_ranges, integrate_blocks, mark_blocks
from facewright.errors import ValueRangeError
from facewright.numeric.check import check_shape
from facewright.numeric.threads import for_blocks

#: Neighbouring depths further apart, mm, are not interpolated: an edge lies between them.
_STEP_MM = 6.0


class SurfaceView(NamedTuple):
    """What a camera sees of a surface.

    Parameters
    ----------
    depth : ndarray of shape (H, W), float32, millimetres
        Along the optical axis; 0 where it sees nothing.
    normals : ndarray of shape (H, W, 3), float32
        Unit normals in the frame of the volume, outwards; undefined where there is no depth.
    intrinsics : Intrinsics
        The camera.
    volume_from_camera : RigidMotion
        Its pose.
    """

    depth: NDArray[np.float32]
    normals: NDArray[np.float32]
    intrinsics: Intrinsics
    volume_from_camera: RigidMotion


class DepthVolume:
    """Signed distances on a grid of cubic voxels; only blocks of 8 x 8 x 8 voxels near a surface are worked on.

    Every voxel is computed by itself and in one order, so that equal frames give bit-equal volumes with any number of
    threads.

    Parameters
    ----------
    low, high : ndarray of shape (3,), millimetres
        Corners of the box to cover.
    voxel_mm : float
        Edge of a voxel.
    truncation_mm : float
        Distances are cut here.

    Raises
    ------
    ValueRangeError
        If the box is empty, or would need more than 2^27 voxels.
    """

    def __init__(
        self, low: NDArray[np.floating], high: NDArray[np.floating], voxel_mm: float = 1.5, truncation_mm: float = 6.0
    ) -> None:
        size = np.asarray(high, np.float64) - low
        if not (size > 0).all() or not voxel_mm > 0 or not truncation_mm >= voxel_mm:
            raise ValueRangeError(f"volume must have positive extents and voxels, got {size.tolist()}, {voxel_mm} mm.")
        blocks = np.ceil(size / (voxel_mm * BLOCK)).astype(int) + 1
        if blocks.prod() * BLOCK**3 > 2**27:
            raise ValueRangeError(f"volume must hold at most 2^27 voxels, got {blocks.prod() * BLOCK**3}.")
        self.origin = np.asarray(low, np.float64).copy()
        self.voxel_mm, self.truncation_mm = float(voxel_mm), float(truncation_mm)
        shape = tuple(int(n) for n in blocks[::-1])
        self.tsdf = np.zeros([n * BLOCK for n in shape], np.float32)
        self.weight = np.zeros(self.tsdf.shape, np.float32)  # unlike zeros_like, touches no memory
        self.active = np.zeros(shape, np.bool_)

    def integrate(
        self,
        depth: NDArray[np.float32],
        intrinsics: Intrinsics,
        volume_from_camera: RigidMotion,
        share: NDArray[np.float32] | None = None,
    ) -> None:
        """Take in a depth map.

        Parameters
        ----------
        depth : ndarray of shape (H, W), float32, millimetres
            0 where there is none.
        intrinsics : Intrinsics
            Its camera.
        volume_from_camera : RigidMotion
            Its pose.
        share : ndarray of shape (H, W), float32, optional
            Weight of each pixel, from 0; all 1 where absent.
        """
        sizes = check_shape("depth", depth, "H", "W")
        depth = np.ascontiguousarray(depth, np.float32)
        share = np.ones_like(depth) if share is None else np.ascontiguousarray(share, np.float32)
        check_shape("share", share, "H", "W", **sizes)
        camera = camera_row(intrinsics)
        marked = np.zeros_like(self.active)
        to, back = volume_from_camera, volume_from_camera.inverse()
        mark_blocks(
            depth, camera, _c(to.rotation), to.translation, self.origin, self.voxel_mm, self.truncation_mm, marked
        )
        self.active |= marked
        blocks = np.argwhere(marked)

        def work(first: int, last: int) -> None:
            integrate_blocks(
                self.tsdf, self.weight, blocks, first, last, depth, share, camera, _c(back.rotation), back.translation,
                self.origin, self.voxel_mm, self.truncation_mm, _STEP_MM,
            )  # fmt: skip

        for_blocks(len(blocks), max(128, len(blocks) // 8), work)

    def view(
        self,
        intrinsics: Intrinsics,
        volume_from_camera: RigidMotion,
        size: tuple[int, int],
        least_weight: float = 0.5,
    ) -> SurfaceView:
        """Cast a ray through every pixel centre.

        Parameters
        ----------
        intrinsics : Intrinsics
            The camera.
        volume_from_camera : RigidMotion
            Its pose.
        size : (height, width)
            Pixels.
        least_weight : float
            Voxels with less are treated as unseen.
        """
        depth = np.zeros(size, np.float32)
        normals = np.zeros((*size, 3), np.float32)
        pose, camera = volume_from_camera, camera_row(intrinsics)
        back = pose.inverse()
        tiles = (-(-size[0] // TILE), -(-size[1] // TILE))
        near, far = np.full(tiles, np.inf), np.zeros(tiles)
        depth_ranges(
            self.active, camera, _c(back.rotation), back.translation, self.origin, self.voxel_mm, *size, near, far
        )

        def work(first: int, last: int) -> None:
            cast_rays(
                self.tsdf, self.weight, self.active, first, last, camera, _c(pose.rotation), pose.translation,
                self.origin, self.voxel_mm, self.truncation_mm, least_weight, near, far, depth, normals,
            )  # fmt: skip

        for_blocks(size[0], max(16, size[0] // 8), work)
        return SurfaceView(depth, normals, intrinsics, volume_from_camera)


def camera_row(intrinsics: Intrinsics) -> NDArray[np.float64]:
    """Return fx, fy, cx, cy for the kernels."""
    return np.array([intrinsics.focal_x, intrinsics.focal_y, intrinsics.centre_x, intrinsics.centre_y])


def _c(array: NDArray[np.float64]) -> NDArray[np.float64]:
    return np.ascontiguousarray(array, np.float64)
