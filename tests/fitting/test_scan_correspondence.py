import numpy as np
import pytest

from facewright.errors import NoFaceError
from facewright.fitting.scan_correspondence import Gates, ScanSurface, exposed_vertices, seen_from_camera
from facewright.fitting.scan_target import ScanTarget


def sheet(n=21, spacing=2.0, z=600.0):
    """A flat grid of points facing the camera, with triangles."""
    y, x = np.mgrid[:n, :n]
    points = np.stack([x.ravel() * spacing, y.ravel() * spacing, np.full(n * n, z)], axis=1)
    i = np.arange(n * n).reshape(n, n)
    a, b, c, d = i[:-1, :-1].ravel(), i[1:, :-1].ravel(), i[1:, 1:].ravel(), i[:-1, 1:].ravel()
    faces = np.concatenate([np.stack([a, b, c], 1), np.stack([a, c, d], 1)]).astype(np.int32)
    return points, faces


def surface(points, faces):
    normals = np.tile([0.0, 0.0, -1.0], (len(points), 1))
    return ScanSurface(ScanTarget(points, normals, faces, np.full((74, 3), np.nan), np.zeros(74)))


def test_gates_of_distance_direction_and_rim():
    scan = surface(*sheet())
    vertices = np.array([[20.0, 20, 599], [20, 20, 585], [20, 20, 599], [-3.0, 20, 600]])
    normals = np.array([[0, 0, -1.0], [0, 0, -1], [1.0, 0, 0], [0, 0, -1]])
    matches = scan.match(vertices, normals, np.arange(4), Gates(5.0))
    assert matches.vertices.tolist() == [0], "too far, turned away and beyond the rim stay unmatched"
    np.testing.assert_allclose(matches.points[0], [20, 20, 600], atol=1e-9)


def test_outliers_lose_their_weight(rng):
    scan = surface(*sheet(41))
    vertices = np.column_stack([rng.uniform(10, 70, (300, 2)), 600 + rng.normal(0, 0.2, 300)])
    vertices[:20, 2] -= 4.0  # hair
    matches = scan.match(vertices, np.tile([0, 0, -1.0], (300, 1)), np.arange(300), Gates(10.0))
    assert not np.isin(np.arange(20), matches.vertices).any()
    assert len(matches.vertices) > 270 and matches.weights.mean() > 0.7


def test_nothing_near_gives_no_matches():
    scan = surface(*sheet())
    matches = scan.match(np.zeros((1, 3)), np.array([[0, 0, -1.0]]), np.arange(1), Gates(5.0))
    assert len(matches.vertices) == 0 and matches.points.shape == (0, 3)


def test_what_lies_behind_is_not_seen():
    front, faces = sheet(11, 2.0, 500.0)
    back, more = sheet(31, 2.0, 520.0)
    seen = seen_from_camera(
        np.concatenate([front, back - [20, 20, 0]]), np.concatenate([faces, more + len(front)]), None
    )
    assert seen[: len(front)].all()
    behind = ((back[:, :2] - 20 > 2) & (back[:, :2] - 20 < 18)).all(axis=1)
    assert not seen[len(front) :][behind].any()
    beside = ((back[:, :2] - 20 < -3) | (back[:, :2] - 20 > 23)).any(axis=1)
    assert seen[len(front) :][beside].all()


def test_insides_of_the_mouth_are_never_exposed(ict_face):
    face = ict_face.skin()
    exposed = exposed_vertices(face.mean_shape.astype(float), face.topology.faces)
    assert exposed[face.topology.masks["nose"]].mean() > 0.6, "all but the insides of the nostrils"
    assert exposed[face.topology.masks["forehead"]].all()
    mouth = face.topology.masks["lips"]
    assert exposed[mouth].mean() < 0.75, "the inner halves of the lips are hidden"


def test_refuses_points_without_a_surface():
    points, _ = sheet()
    with pytest.raises(NoFaceError, match="surface"):
        surface(points, np.empty((0, 3), dtype=np.int32))
