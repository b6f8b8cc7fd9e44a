"""Rigid registration beside trimesh's: similarity of point pairs (procrustes), and rigid ICP to a mesh (icp).

Ours is the least-squares similarity (Umeyama); trimesh takes the scale from the two spreads, which differs where
there is noise: the table has both residuals. Our ICP is the loop over our closest points and our rigid motion: same
start, same number of rounds, nothing rejected on either side. Non-rigid registration (nricp_amberg) has no counterpart
yet.
"""

from __future__ import annotations

import numpy as np

from benchmarks.common import Table, benchmark_face, best_ms, has_peer, quick_from_command_line
from facewright.camera.rotation import rotation_from_head_angles
from facewright.faces.face import Face
from facewright.mesh.closest_point import ClosestPoints
from facewright.numeric.similarity import Similarity, estimate_similarity

ROUNDS = 20
NOISE_MM = 0.3
#: From the face to the scan; ICP goes without the scale.
TRUTH = Similarity(1.03, rotation_from_head_angles(12.0, -6.0, 4.0), np.array([5.0, -8.0, 6.0]))


def main() -> None:
    quick = quick_from_command_line(__doc__)
    face = benchmark_face().skin()
    table = Table()
    compare_pairs(face, table, repeats=20 if quick else 100)
    compare_icp(face, table, n_points=500 if quick else 2000, repeats=1 if quick else 3)
    table.show()
    print("  trimesh.registration.nricp_amberg: not compared, there is no non-rigid registration of ours yet")


def compare_pairs(face: Face, table: Table, repeats: int) -> None:
    """Time the similarity of the landmarks, and of all vertices."""
    rng = np.random.default_rng(0)
    vertices = face.mean_shape.astype(np.float64)
    marks = face.topology.landmarks["ibug68"]
    with_trimesh = has_peer("trimesh")
    for source in (vertices[marks[marks >= 0]], vertices):
        target = TRUTH.apply(source) + rng.normal(0.0, NOISE_MM, source.shape)
        found = estimate_similarity(source, target)
        ours = best_ms(lambda: estimate_similarity(source, target), repeats)  # noqa: B023  called in this round
        what = f"similarity of {len(source)} pairs"
        if not with_trimesh:
            table.ours(what, ours)
            continue
        from trimesh.registration import procrustes

        peer = best_ms(lambda: procrustes(source, target, reflection=False), repeats)  # noqa: B023
        theirs = procrustes(source, target, reflection=False)[1]
        note = f"residual {rms(found.apply(source) - target):.4f} mm, theirs {rms(theirs - target):.4f}"
        table.versus(what, ours, "trimesh procrustes", peer, note)


def compare_icp(face: Face, table: Table, n_points: int, repeats: int) -> None:
    """Time ICP from points of a scan to the face, the tree of the mesh included."""
    rng = np.random.default_rng(1)
    vertices, faces = face.mean_shape.astype(np.float64), face.topology.faces
    scan = TRUTH._replace(scale=1.0).apply(vertices[rng.choice(len(vertices), n_points, replace=False)])
    scan += rng.normal(0.0, NOISE_MM, scan.shape)
    ours = best_ms(lambda: icp(scan, vertices, faces), repeats)
    what = f"ICP, {n_points} points, {ROUNDS} rounds"
    if not has_peer("trimesh", "rtree"):
        table.ours(what, ours)
        return
    import trimesh

    def peer() -> tuple[np.ndarray, np.ndarray, float]:
        mesh = trimesh.Trimesh(vertices, faces, process=False)
        options = {"threshold": -np.inf, "max_iterations": ROUNDS, "reflection": False, "scale": False}
        return trimesh.registration.icp(scan, mesh, **options)

    apart = np.linalg.norm(peer()[1] - icp(scan, vertices, faces).apply(scan), axis=1).max()
    table.versus(what, ours, "trimesh icp", best_ms(peer, repeats), f"moved points to {apart:.0e} mm")


def icp(points: np.ndarray, vertices: np.ndarray, faces: np.ndarray) -> Similarity:
    """Move points onto a mesh: closest points and the rigid motion to them in turn."""
    search = ClosestPoints(vertices, faces)
    moved, found = points, Similarity(1.0, np.eye(3), np.zeros(3))
    for _ in range(ROUNDS):
        step = estimate_similarity(moved, search.query(moved).points, with_scale=False)
        found, moved = step.compose(found), step.apply(moved)
    return found


def rms(offsets: np.ndarray) -> float:
    """Return the root mean square length of vectors (N, 3)."""
    return float(np.sqrt((offsets**2).sum(axis=1).mean()))


if __name__ == "__main__":
    main()
