import numpy as np
import pytest

from facewright.camera.depth_map import back_project
from facewright.camera.rotation import rotation_angle
from facewright.errors import DegenerateError, ShapeError
from facewright.imaging.scan_views import ScanViewer, axis_rotations, even_rotations, scan_albedo
from facewright.io.mesh_data import MeshData
from facewright.mesh.closest_point import closest_points


@pytest.fixture(scope="module")
def scan(builtin_face):
    """The built-in face's skin as a scan in metres, far from its origin."""
    face = builtin_face.skin()
    return MeshData(0.001 * face.mean_shape.astype(np.float64) + [5.0, -3.0, 2.0], face.topology.faces)


def test_depth_leads_back_to_the_scan(scan, rng):
    viewer = ScanViewer(scan)
    for rotation in even_rotations(5):
        view = viewer.view(rotation, size=96)
        points = back_project(view.depth, view.intrinsics)[view.depth > 0]
        assert len(points) > 500
        away = closest_points(scan.vertices, scan.faces, view.to_scan(points)).distances
        assert away.max() < 1e-6


def test_model_space_is_seen_upright(scan):
    view = ScanViewer(scan).view(np.eye(3), size=64)
    top = scan.vertices[scan.vertices[:, 1].argmax()]
    rotation, translation = view.camera_from_scan
    pixel = view.intrinsics.project(rotation @ top + translation)
    assert pixel[1] < 20  # y points down in a picture
    left = scan.vertices[scan.vertices[:, 0].argmax()]
    assert view.intrinsics.project(rotation @ left + translation)[0] > 32  # the person's left is the picture's right


def test_what_is_before_the_middle_is_cut_away(scan):
    wall = scan.vertices.mean(axis=0) + 0.5 * np.array([[-1, -1, 1.0], [1, -1, 1], [0, 1.5, 1]])
    n = len(scan.vertices)
    both = MeshData(np.concatenate([scan.vertices, wall]), np.concatenate([scan.faces, [[n, n + 1, n + 2]]]))
    middle, radius = scan.vertices.mean(axis=0), 0.15
    clear = ScanViewer(scan).view(np.eye(3), middle=middle, radius=radius, size=64)
    seen = ScanViewer(both).view(np.eye(3), middle=middle, radius=radius, size=64)
    np.testing.assert_allclose(seen.depth, clear.depth)


def test_a_picture_of_nothing_is_blank(scan):
    view = ScanViewer(scan).view(np.eye(3), middle=np.array([100.0, 0, -100.0]), radius=0.1, size=32)
    assert (view.depth == 0).all()


def test_colours_come_from_texture_then_vertices(builtin_face, rng):
    topology = builtin_face.topology
    red = np.zeros((8, 8, 3), np.uint8)
    red[..., 0] = 200
    vertices = builtin_face.mean_shape
    textured = MeshData(vertices, topology.faces, uv=topology.uv, uv_faces=topology.uv_faces)
    view = ScanViewer(textured, red).view(np.eye(3), size=48)
    mean = view.image[view.depth > 0].mean(axis=0)
    assert mean[0] > 3 * mean[1]
    # also where a part of the triangles is cut away
    near = ScanViewer(textured, red).view(np.eye(3), middle=np.array([0, 0, -60.0]), radius=60.0, size=48)
    mean = near.image[near.depth > 0].mean(axis=0)
    assert mean[0] > 3 * mean[1]
    green = np.tile(np.array([0, 200, 0], np.uint8), (len(vertices), 1))
    view = ScanViewer(MeshData(vertices, topology.faces, vertex_colors=green)).view(np.eye(3), size=48)
    mean = view.image[view.depth > 0].mean(axis=0)
    assert mean[1] > 3 * mean[0]
    with pytest.raises(ShapeError, match="texture coordinates"):
        scan_albedo(MeshData(vertices, topology.faces), red)


def test_spikes_do_not_set_the_size(scan):
    spiky = scan.vertices.copy()
    spiky[::500] += [30.0, 0, 0]
    viewer, clean = ScanViewer(MeshData(spiky, scan.faces)), ScanViewer(scan)
    assert viewer.radius == pytest.approx(clean.radius, rel=0.1)


def test_without_surface_there_is_nothing_to_see():
    with pytest.raises(DegenerateError, match="triangles"):
        ScanViewer(MeshData(np.eye(3), np.empty((0, 3), np.int32)))
    with pytest.raises(DegenerateError, match="extent"):
        ScanViewer(MeshData(np.ones((3, 3)), np.array([[0, 1, 2]], np.int32)))
    rng = np.random.default_rng(0)
    with pytest.raises(DegenerateError, match="form a surface"):
        ScanViewer(MeshData(rng.normal(size=(3000, 3)), rng.integers(0, 3000, (6000, 3)).astype(np.int32)))


def test_axis_rotations_are_the_24():
    rotations = np.array(axis_rotations())
    assert len(np.unique(rotations.reshape(24, 9), axis=0)) == 24
    np.testing.assert_allclose(np.linalg.det(rotations), 1.0)
    np.testing.assert_array_equal(rotations[0], np.eye(3))


def test_even_rotations_leave_no_gap(rng):
    rotations = even_rotations(72)
    for R in rotations:
        np.testing.assert_allclose(R @ R.T, np.eye(3), atol=1e-12)
        assert np.linalg.det(R) > 0
    every = rotations + axis_rotations()
    probes = [np.linalg.qr(rng.normal(size=(3, 3)))[0] for _ in range(100)]
    probes = [q * np.sign(np.linalg.det(q)) for q in probes]
    worst = max(min(rotation_angle(q, R) for R in every) for q in probes)
    assert np.rad2deg(worst) < 50.0
