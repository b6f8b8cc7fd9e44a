"""Our z-buffer beside Open3D's RaycastingScene (Embree): which triangle each of 640 x 480 pixels sees, and its depth.

A face that is being fitted or drawn moves and deforms from picture to picture, so that Open3D has to build its tree
anew each time. Its parts are timed apart: the tree, and the rays with all cores and with one. Ours uses one core and
has no tree. Last, what drawing needs besides: three numbers per vertex, such as positions, interpolated at every pixel.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from benchmarks.common import Table, benchmark_face, best_ms, has_peer, quick_from_command_line
from facewright.camera.pinhole import Intrinsics, RigidMotion
from facewright.camera.rotation import rotation_from_head_angles
from facewright.imaging.rasterise import rasterise

SIZE = (480, 640)
DISTANCE_MM = 500.0


def main() -> None:
    repeats = 5 if quick_from_command_line(__doc__) else 25
    face = benchmark_face().skin()
    faces = face.topology.faces
    motion = RigidMotion(rotation_from_head_angles(20.0, 5.0, 3.0), np.array([0.0, 0.0, DISTANCE_MM]))
    seen = motion.apply(face.mean_shape.astype(np.float64))
    camera = Intrinsics.for_image(SIZE)
    fragments = rasterise(camera.project(seen), seen[:, 2], faces, SIZE)
    print(f"  {SIZE[1]} x {SIZE[0]} pixels, {fragments.covered.mean():.0%} of them see the face")
    ours = best_ms(lambda: rasterise(camera.project(seen), seen[:, 2], faces, SIZE), repeats)
    table = Table()
    if has_peer("open3d"):
        import open3d

        vertices = open3d.core.Tensor(seen.astype(np.float32))
        triangles = open3d.core.Tensor(faces.astype(np.uint32))
        rays = open3d.core.Tensor(pixel_rays(camera))

        def build() -> Any:
            scene = open3d.t.geometry.RaycastingScene()
            scene.add_triangles(vertices, triangles)
            return scene

        hit = build().cast_rays(rays)
        depth = hit["t_hit"].numpy()  # along the ray in units of z: depth
        both = fragments.covered & np.isfinite(depth)
        apart = np.abs(depth[both] - fragments.depth[both])
        differ = (fragments.covered != np.isfinite(depth)).sum()
        peer = best_ms(lambda: build().cast_rays(rays), repeats)
        note = f"depth to {np.percentile(apart, 99.9):.0e} mm (99.9 %), {differ} pixels differ in cover"
        table.versus("a new picture", ours, "Open3D, build + rays", peer, note)
        scene = build()
        # the tree is built with the first ray
        one_ray = rays[:1, :1].clone()
        table.versus("", ours, "Open3D, build alone", best_ms(lambda: build().cast_rays(one_ray), repeats))
        table.versus("", ours, "Open3D, rays alone", best_ms(lambda: scene.cast_rays(rays), repeats))
        alone = best_ms(lambda: scene.cast_rays(rays, nthreads=1), repeats)
        table.versus("", ours, "Open3D, rays alone, one core", alone)
    else:
        table.ours("a new picture", ours)
    table.ours("interpolate positions", best_ms(lambda: fragments.interpolate(faces, seen), repeats))
    table.show()


def pixel_rays(camera: Intrinsics) -> np.ndarray:
    """Return rays (H, W, 6) from the camera's centre through the pixel centres, of length 1 along z."""
    y, x = np.mgrid[: SIZE[0], : SIZE[1]]
    rays = np.zeros((*SIZE, 6), np.float32)
    rays[..., 3] = (x - camera.centre_x) / camera.focal_x
    rays[..., 4] = (y - camera.centre_y) / camera.focal_y
    rays[..., 5] = 1.0
    return rays


if __name__ == "__main__":
    main()
