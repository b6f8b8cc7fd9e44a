"""Closest points, geodesics and deformation transfer on the 11K mesh, beside trimesh and Open3D."""

from __future__ import annotations

import numpy as np

from benchmarks.common import Table, benchmark_face, best_ms, has_peer, quick_from_command_line
from facewright.deform.deformation_transfer import DeformationTransfer
from facewright.mesh.closest_point import ClosestPoints
from facewright.mesh.geodesics import HeatGeodesics, path_distances


def closest(table: Table, vertices: np.ndarray, faces: np.ndarray, points: np.ndarray, repeats: int) -> None:
    """Compare closest points on the mesh, and building the search."""
    search = ClosestPoints(vertices, faces)
    distances = search.query(points).distances
    ours = best_ms(lambda: search.query(points), repeats)
    build = best_ms(lambda: ClosestPoints(vertices, faces), repeats)
    what = f"{len(points)} closest points"
    with_trimesh, with_open3d = has_peer("trimesh", "rtree"), has_peer("open3d")
    if with_trimesh:
        import trimesh

        def peer() -> np.ndarray:
            return trimesh.proximity.closest_point(trimesh.Trimesh(vertices, faces, process=False), points)[1]

        note = f"to {np.abs(peer() - distances).max():.0e} mm"
        table.versus(f"{what}, with building", build + ours, "trimesh", best_ms(peer, max(repeats // 3, 1)), note)
    if with_open3d:
        import open3d

        corners = open3d.core.Tensor(vertices.astype(np.float32))
        triangles = open3d.core.Tensor(faces.astype(np.uint32))
        queries = open3d.core.Tensor(points.astype(np.float32))

        def distances_of_scene() -> np.ndarray:
            scene = open3d.t.geometry.RaycastingScene()
            scene.add_triangles(corners, triangles)
            return scene.compute_distance(queries).numpy()

        note = f"to {np.abs(distances_of_scene() - distances).max():.0e} mm (theirs is float32)"
        table.versus(f"{what}, with building", build + ours, "Open3D", best_ms(distances_of_scene, repeats), note)
    table.ours(f"{what}, search built before", ours)


def geodesics(table: Table, vertices: np.ndarray, faces: np.ndarray, repeats: int) -> None:
    """Time geodesics from one vertex."""
    sources = np.arange(0, len(vertices), 300)
    table.ours(
        "geodesics along paths, a vertex",
        best_ms(lambda: path_distances(vertices, faces, sources), repeats) / len(sources),
    )
    heat = HeatGeodesics(vertices, faces)
    table.ours("heat method, factoring", best_ms(lambda: HeatGeodesics(vertices, faces), repeats))
    table.ours("heat method, a vertex", best_ms(lambda: heat.distances(sources[:1]), repeats))


def transfer(table: Table, vertices: np.ndarray, faces: np.ndarray, deltas: np.ndarray, repeats: int) -> None:
    """Time deformation transfer."""
    target = vertices * [1.1, 0.95, 1.0]
    carrier = DeformationTransfer(vertices, target, faces)
    build = best_ms(lambda: DeformationTransfer(vertices, target, faces), repeats)
    table.ours("deformation transfer, set-up", build)
    table.ours("one expression", best_ms(lambda: carrier.transfer(vertices + deltas[0]), repeats))
    batch = best_ms(lambda: carrier.transfer(vertices + deltas), repeats) / len(deltas)
    table.ours(f"each of {len(deltas)} together", batch)


def main() -> None:
    repeats = 2 if quick_from_command_line(__doc__) else 7
    face = benchmark_face().skin()
    vertices, faces = face.mean_shape.astype(np.float64), face.topology.faces
    table = Table()
    points = vertices + np.random.default_rng(0).normal(size=vertices.shape) * 3
    closest(table, vertices, faces, points, repeats)
    geodesics(table, vertices, faces, repeats)
    transfer(table, vertices, faces, face.blendshape_deltas.astype(np.float64), repeats)
    table.show()
    print("  points are vertices with 3 mm noise; geodesics and deformation transfer have no peer on the package index")


if __name__ == "__main__":
    main()
