"""Closest points, geodesics and deformation transfer on the 11K mesh, beside peers from the package index.

Peers that are not installed are left out: trimesh needs rtree; Open3D is `pip install open3d-cpu`.
"""

from __future__ import annotations

import os
from collections.abc import Callable
from pathlib import Path
from time import perf_counter

import numpy as np

from facewright.deform.deformation_transfer import DeformationTransfer
from facewright.errors import MissingFaceError
from facewright.faces import load_face
from facewright.mesh.closest_point import ClosestPoints
from facewright.mesh.geodesics import HeatGeodesics, path_distances

REPEATS = 5


def median_ms(work: Callable[[], object]) -> float:
    work()
    times = []
    for _ in range(REPEATS):
        start = perf_counter()
        work()
        times.append(perf_counter() - start)
    return 1e3 * float(np.median(times))


def closest(vertices: np.ndarray, faces: np.ndarray, points: np.ndarray) -> None:
    search = ClosestPoints(vertices, faces)
    distances = search.query(points).distances
    build = median_ms(lambda: ClosestPoints(vertices, faces))
    ours = median_ms(lambda: search.query(points))
    print(f"closest points, {len(points)} queries at 3 mm noise: ours {ours:.1f} ms + {build:.1f} ms to build")
    try:
        import rtree  # noqa: F401  trimesh imports it late
        import trimesh

        mesh = trimesh.Trimesh(vertices, faces, process=False)
        peer = median_ms(lambda: trimesh.proximity.closest_point(mesh, points))
        worst = np.abs(trimesh.proximity.closest_point(mesh, points)[1] - distances).max()
        print(f"  trimesh {peer:.1f} ms, ratio {peer / ours:.1f}, largest difference {worst:.1e} mm")
    except ImportError:
        print("  trimesh with rtree: not installed")
    try:
        import open3d

        scene = open3d.t.geometry.RaycastingScene()
        scene.add_triangles(
            open3d.core.Tensor(vertices.astype(np.float32)), open3d.core.Tensor(faces.astype(np.uint32))
        )
        queries = open3d.core.Tensor(points.astype(np.float32))
        peer = median_ms(lambda: scene.compute_closest_points(queries))
        print(f"  Open3D {peer:.1f} ms, ratio {peer / ours:.1f} (single precision)")
    except ImportError:
        print("  Open3D: not installed")


def geodesics(vertices: np.ndarray, faces: np.ndarray) -> None:
    sources = np.arange(0, len(vertices), 300)
    each = median_ms(lambda: path_distances(vertices, faces, sources)) / len(sources)
    heat = HeatGeodesics(vertices, faces)
    build = median_ms(lambda: HeatGeodesics(vertices, faces))
    one = median_ms(lambda: heat.distances(sources[:1]))
    print(f"geodesics from one vertex: paths {each:.1f} ms, heat method {one:.1f} ms + {build:.1f} ms to factor")


def transfer(vertices: np.ndarray, faces: np.ndarray, deltas: np.ndarray) -> None:
    target = vertices * [1.1, 0.95, 1.0]
    build = median_ms(lambda: DeformationTransfer(vertices, target, faces))
    carrier = DeformationTransfer(vertices, target, faces)
    one = median_ms(lambda: carrier.transfer(vertices + deltas[0]))
    batch = median_ms(lambda: carrier.transfer(vertices + deltas)) / len(deltas)
    print(f"deformation transfer: set-up {build:.1f} ms, one expression {one:.1f} ms, each of 46 {batch:.1f} ms")


def main() -> None:
    compact = Path(os.environ.get("FACEWRIGHT_TEST_DATA", "") or "/nonexistent") / "ict_facekit.npz"
    try:
        face = load_face(compact if compact.is_file() else "ict").skin()
    except MissingFaceError:
        face = load_face("builtin").skin()
    vertices, faces = face.mean_shape.astype(np.float64), face.topology.faces
    print(f"mesh: {face.name}, {len(vertices)} vertices, {os.cpu_count()} cores")
    closest(vertices, faces, vertices + np.random.default_rng(0).normal(size=vertices.shape) * 3)
    geodesics(vertices, faces)
    transfer(vertices, faces, face.blendshape_deltas.astype(np.float64))


if __name__ == "__main__":
    main()
