"""Open3D's volume behind the interface of `DepthVolume`, its half pixels put right.

Measured with Open3D 0.19 (see tests): ``VoxelBlockGrid.integrate`` cuts pixel coordinates off to whole numbers, so
that it wants the principal point half a pixel further where the centre of the first pixel is (0, 0). Its ``ray_cast``
reads the voxel below instead of interpolating: its depths are off by 0.9 mm, and by 0.2 mm after moving the camera by
half a voxel. So surfaces are looked at through the grid's triangle mesh, which has no bias (below 0.03 mm on a ball at
1.5 mm voxels) but is slower than `DepthVolume`: about 150 ms of processor time for a view after frames were taken in,
against 25.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from facewright.camera.pinhole import Intrinsics, RigidMotion
from facewright.capture.volume import SurfaceView
from facewright.errors import MissingExtraError, ValueRangeError
from facewright.numeric.check import check_shape

_BLOCK = 8
_MM = 1000.0  # Open3D computes in float32: metres, as it expects
_FAR_M = 10.0


class Open3DVolume:
    """Signed distances in Open3D's `VoxelBlockGrid`, seen through the triangle mesh of their zero.

    The nearest pixel's depth goes into a voxel (`DepthVolume` interpolates), which shows as noise on slopes. The mesh
    is made once between two calls of `integrate`.

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
    MissingExtraError
        If Open3D is not installed.
    ValueRangeError
        If the box is empty.
    """

    def __init__(
        self, low: NDArray[np.floating], high: NDArray[np.floating], voxel_mm: float = 1.5, truncation_mm: float = 6.0
    ) -> None:
        size = np.asarray(high, np.float64) - low
        if not (size > 0).all() or not voxel_mm > 0 or not truncation_mm >= voxel_mm:
            raise ValueRangeError(f"volume must have positive extents and voxels, got {size.tolist()}, {voxel_mm} mm.")
        self._o3d = require_open3d()
        core = self._o3d.core
        self.voxel_mm, self.truncation_mm = float(voxel_mm), float(truncation_mm)
        edge = self.voxel_mm * _BLOCK
        self._low, self._high = np.floor(np.asarray(low) / edge), np.floor(np.asarray(high) / edge)
        # a surface crosses few of the box's blocks; the grid grows where there are more
        n_blocks = int(np.clip(0.2 * np.prod(size / edge), 500, 20_000))
        self._grid = self._o3d.t.geometry.VoxelBlockGrid(
            ("tsdf", "weight"), (core.float32, core.float32), ((1), (1)), voxel_mm / _MM, _BLOCK, n_blocks,
            core.Device("CPU:0"),
        )  # fmt: skip
        self._scenes: dict[float, tuple[Any, NDArray[np.int32], NDArray[np.float32]]] = {}
        self._empty = True

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
            0 for pixels to leave out, 1 for others: the grid knows no other weights.

        Raises
        ------
        ValueRangeError
            If a share is neither 0 nor 1.
        """
        sizes = check_shape("depth", depth, "H", "W")
        if share is not None:
            check_shape("share", share, "H", "W", **sizes)
            if not np.isin(share, (0.0, 1.0)).all():
                raise ValueRangeError('share must be 0 or 1 with the engine "open3d", got others: use "numba".')
            depth = np.where(share > 0, depth, 0)
        if not depth.any():
            return
        core = self._o3d.core
        image = self._o3d.t.geometry.Image(core.Tensor(np.ascontiguousarray(depth, np.float32)))
        matrix = intrinsics.matrix
        matrix[:2, 2] += 0.5  # pixel coordinates are cut off to whole numbers
        K, E = core.Tensor(matrix), core.Tensor(_extrinsic(volume_from_camera.inverse()))
        reach = self.truncation_mm / self.voxel_mm
        blocks = self._grid.compute_unique_block_coordinates(image, K, E, _MM, _FAR_M, reach)
        places = blocks.numpy()
        inside = ((places >= self._low) & (places <= self._high)).all(axis=1)
        if not inside.any():
            return
        self._grid.integrate(core.Tensor(places[inside]), image, K, E, _MM, _FAR_M, reach)
        self._empty = False
        self._scenes.clear()

    def view(
        self,
        intrinsics: Intrinsics,
        volume_from_camera: RigidMotion,
        size: tuple[int, int],
        least_weight: float = 0.5,
    ) -> SurfaceView:
        """Cast a ray through every pixel centre onto the mesh; normals are interpolated between its vertices.

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
        depth, normals = np.zeros(size, np.float32), np.zeros((*size, 3), np.float32)
        view = SurfaceView(depth, normals, intrinsics, volume_from_camera)
        if self._empty:
            return view
        scene, triangles, vertex_normals = self._scene(least_weight)
        if not len(triangles):
            return view
        rays = _rays(intrinsics, volume_from_camera, size)
        hits = scene.cast_rays(self._o3d.core.Tensor(rays))
        # rays have length 1 along the axis, so that the place on the ray is the depth
        z = hits["t_hit"].numpy()
        seen = np.isfinite(z)
        corners = triangles[hits["primitive_ids"].numpy()[seen].astype(np.int64)]
        n = _interpolate(vertex_normals[corners], hits["primitive_uvs"].numpy()[seen])
        # a surface seen from within was not seen by the camera
        front = np.einsum("ij,ij->i", n, rays[seen][:, 3:]) < 0
        seen[seen] = front
        depth[seen] = z[seen] * np.float32(_MM)
        normals[seen] = n[front]
        return view

    def _scene(self, least_weight: float) -> tuple[Any, NDArray[np.int32], NDArray[np.float32]]:
        """Return the mesh's scene, triangles (F, 3) and vertex normals (V, 3)."""
        if least_weight not in self._scenes:
            scene = self._o3d.t.geometry.RaycastingScene()
            triangles, normals = np.zeros((0, 3), np.int32), np.zeros((0, 3), np.float32)
            mesh = self._mesh(least_weight)
            if mesh is not None:
                scene.add_triangles(mesh)
                triangles, normals = mesh.triangle.indices.numpy(), mesh.vertex.normals.numpy()
            self._scenes[least_weight] = (scene, triangles, normals)
        return self._scenes[least_weight]

    def _mesh(self, least_weight: float) -> Any:
        """Return the mesh of the zero, or None where there is no surface."""
        try:
            mesh = self._grid.extract_triangle_mesh(least_weight, -1)
        except RuntimeError as error:
            if "shape {0}" in str(error):  # how Open3D 0.19 says that there are no vertices
                return None
            raise
        return mesh if "indices" in mesh.triangle and len(mesh.triangle.indices) else None


def require_open3d() -> Any:
    """Import Open3D.

    Raises
    ------
    MissingExtraError
        If it is not installed.
    """
    try:
        import open3d
    except ImportError as error:
        raise MissingExtraError(
            'fusing with the engine "open3d" needs the open3d package, install it with '
            'pip install "facewright[capture]" or use the engine "numba".'
        ) from error
    return open3d


def _extrinsic(camera_from_volume: RigidMotion) -> NDArray[np.float64]:
    """Return the matrix (4, 4) of a motion, metres."""
    out = np.eye(4)
    out[:3, :3], out[:3, 3] = camera_from_volume.rotation, camera_from_volume.translation / _MM
    return out


def _rays(intrinsics: Intrinsics, pose: RigidMotion, size: tuple[int, int]) -> NDArray[np.float32]:
    """Return origin (m) and direction of the ray through each pixel centre, shape (H, W, 6)."""
    directions = np.ones((*size, 3))
    directions[..., 0] = (np.arange(size[1]) - intrinsics.centre_x) / intrinsics.focal_x
    directions[..., 1] = ((np.arange(size[0]) - intrinsics.centre_y) / intrinsics.focal_y)[:, None]
    out = np.empty((*size, 6), np.float32)
    out[..., :3] = pose.translation / _MM
    out[..., 3:] = directions @ pose.rotation.T
    return out


def _interpolate(corners: NDArray[np.float32], uv: NDArray[np.float32]) -> NDArray[np.float32]:
    """Return unit normals (N, 3) between those of the corners (N, 3, 3) by barycentric coordinates (N, 2)."""
    u, v = uv[:, :1], uv[:, 1:]
    n = (1.0 - u - v) * corners[:, 0] + u * corners[:, 1] + v * corners[:, 2]
    return np.asarray(n / np.maximum(np.linalg.norm(n, axis=1, keepdims=True), 1e-12), np.float32)
