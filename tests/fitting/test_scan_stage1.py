import numpy as np
import pytest

from facewright.camera.pinhole import RigidMotion
from facewright.camera.rotation import rotation_angle, rotation_from_vector
from facewright.errors import NoFaceError
from facewright.fitting.scan_correspondence import ScanSurface, exposed_vertices
from facewright.fitting.scan_landmarks import LandmarkTerm
from facewright.fitting.scan_stage1 import LinearShapes, Stage1Options, Visibility, fit_linear, start_pose
from facewright.fitting.scan_target import ScanTarget
from facewright.landmarks.scheme import load_scheme
from facewright.mesh.normals import vertex_normals


@pytest.fixture(scope="module")
def setting(builtin_face):
    """Shapes of eight modes, visibility, landmark term."""
    face = builtin_face.skin()
    mean = face.mean_shape.astype(float)
    basis = np.ascontiguousarray(face.identity_basis[:8].transpose(1, 2, 0), dtype=float)
    allowed = exposed_vertices(mean, face.topology.faces)
    shapes = LinearShapes(mean, basis, np.zeros(8), np.ones(8))
    return face, shapes, Visibility(face.topology.faces, allowed), LandmarkTerm(face)


def scan_of(face, vertices):
    """The mesh itself as a scan, with exact landmarks but for the contour."""
    landmarks = np.full((74, 3), np.nan)
    fixed = load_scheme("fw74").fixed
    landmarks[fixed] = vertices[face.topology.landmarks["fw74"][fixed]]
    faces = face.topology.faces
    return ScanTarget(vertices, vertex_normals(vertices, faces), faces, landmarks, np.ones(74))


def test_pose_and_coefficients_of_a_person_in_the_span_come_back(setting, rng):
    face, shapes, visibility, term = setting
    c = rng.normal(size=8)
    motion = RigidMotion(rotation_from_vector([0.2, -0.3, 0.1]), np.array([30.0, -20.0, 500.0]))
    scan = scan_of(face, motion.apply(shapes.shape(c)))
    ids = face.topology.landmarks["fw74"][15:]
    start = start_pose(shapes.base[ids], scan.landmarks[15:], np.ones(len(ids)))
    fit = fit_linear(shapes, ScanSurface(scan), term, visibility, start, Stage1Options(prior=1e-3))
    # closest points hold a little along the surface, too, so that eight rounds leave a rest
    np.testing.assert_allclose(fit.coefficients, c, atol=0.25)
    assert np.rad2deg(rotation_angle(fit.target_from_model.rotation, motion.rotation)) < 0.3
    apart = np.linalg.norm(fit.target_from_model.apply(fit.vertices) - scan.points, axis=1)
    assert apart[face.topology.masks["face_region"]].mean() < 0.25


def test_the_prior_holds_coefficients_back(setting, rng):
    face, shapes, visibility, term = setting
    scan = scan_of(face, shapes.shape(np.full(8, 1.5)))
    start = RigidMotion(np.eye(3), np.zeros(3))
    sizes = [
        np.abs(
            fit_linear(shapes, ScanSurface(scan), term, visibility, start, Stage1Options(prior=w)).coefficients
        ).mean()
        for w in (1.0, 1e5, 1e8)
    ]
    assert sizes[0] > sizes[1] > sizes[2]
    assert sizes[2] < 0.05


def test_bounds_are_kept(setting):
    face, shapes, visibility, term = setting
    bounded = LinearShapes(shapes.base, shapes.basis, shapes.mean, shapes.spread, -0.5, 0.5)
    scan = scan_of(face, shapes.shape(np.full(8, 1.5)))
    fit = fit_linear(bounded, ScanSurface(scan), term, visibility, RigidMotion(np.eye(3), np.zeros(3)), Stage1Options())
    assert np.abs(fit.coefficients).max() <= 0.5 + 1e-9


def test_one_wild_landmark_does_not_pull(setting, rng):
    face, shapes, visibility, term = setting
    scan = scan_of(face, shapes.base)
    scan.landmarks[45] += [0.0, 30.0, 0.0]
    start = RigidMotion(np.eye(3), np.zeros(3))
    fit = fit_linear(shapes, ScanSurface(scan), term, visibility, start, Stage1Options())
    assert np.linalg.norm(fit.target_from_model.apply(fit.vertices) - scan.points, axis=1).mean() < 0.3


def test_refuses_a_scan_that_is_elsewhere(setting):
    face, shapes, visibility, term = setting
    scan = scan_of(face, shapes.base)
    with pytest.raises(NoFaceError, match="within 25 mm"):
        fit_linear(
            shapes, ScanSurface(scan), term, visibility, RigidMotion(np.eye(3), np.full(3, 400.0)), Stage1Options()
        )


@pytest.mark.parametrize(
    ("points", "message"), [(np.zeros((3, 3)), "at least 4"), (np.outer(np.arange(5.0), [1, 2, 3]), "one line")]
)
def test_refuses_landmarks_without_a_pose(points, message):
    with pytest.raises(NoFaceError, match=message):
        start_pose(points, points, np.ones(len(points)))
