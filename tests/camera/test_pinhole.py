import numpy as np
import pytest

from facewright.camera.pinhole import (
    Intrinsics,
    RigidMotion,
    estimate_rigid_motion,
    pinhole_jacobian,
    pixel_by_point,
    rigid_from_weak,
)
from facewright.camera.rotation import rotation_angle, rotation_from_head_angles, rotation_from_vector
from facewright.camera.weak_perspective import WeakPerspective
from facewright.errors import DegenerateError, ShapeError, ValueRangeError

K = Intrinsics(800.0, 820.0, 310.0, 250.0)


@pytest.fixture
def points(rng):
    return rng.normal(size=(30, 3)) * [60.0, 80.0, 30.0]


def motion(rng):
    return RigidMotion(rotation_from_head_angles(*rng.uniform(-40, 40, 3)), np.array([*rng.uniform(-60, 60, 2), 600.0]))


def test_projection_agrees_with_the_matrix(points, rng):
    seen = motion(rng).apply(points)
    homogeneous = seen @ K.matrix.T
    np.testing.assert_allclose(K.project(seen), homogeneous[:, :2] / homogeneous[:, 2:])


def test_the_axis_meets_the_principal_point():
    camera = Intrinsics.for_image((480, 640))
    np.testing.assert_allclose(camera.project(np.array([0.0, 0.0, 5.0])), [319.5, 239.5])
    assert camera.focal_x == 960.0


def test_motions_form_a_group(points, rng):
    a, b = motion(rng), motion(rng)
    np.testing.assert_allclose(a.after(b).apply(points), a.apply(b.apply(points)))
    np.testing.assert_allclose(a.inverse().apply(a.apply(points)), points)


def test_pose_is_recovered_from_exact_points(points, rng):
    for _ in range(10):
        truth = motion(rng)
        found = estimate_rigid_motion(points, K.project(truth.apply(points)), K)
        assert rotation_angle(found.rotation, truth.rotation) < 1e-6
        np.testing.assert_allclose(found.translation, truth.translation, atol=1e-3)


def test_jacobians_agree_with_finite_differences(points, rng):
    pose, h = motion(rng), 1e-6
    seen = pose.apply(points)
    J = pinhole_jacobian(seen, seen - pose.translation, K)
    for i, e in enumerate(np.eye(6)):
        up, down = (
            RigidMotion(rotation_from_vector(s * h * e[:3]) @ pose.rotation, pose.translation + s * h * e[3:])
            for s in (1, -1)
        )
        numeric = (K.project(up.apply(points)) - K.project(down.apply(points))) / (2 * h)
        np.testing.assert_allclose(J[:, :, i], numeric, rtol=1e-5, atol=1e-4)
    np.testing.assert_allclose(J[:, :, 3:], pixel_by_point(seen, K))


def test_weak_perspective_becomes_the_pose_that_looks_the_same_at_the_centre(points, rng):
    weak = WeakPerspective(1.3, rotation_from_head_angles(10, 5, -5), np.array([300.0, 200.0]))
    centre = points.mean(axis=0)
    square = Intrinsics(800.0, 800.0, 310.0, 250.0)
    pose = rigid_from_weak(weak, square, centre)
    np.testing.assert_allclose(square.project(pose.apply(centre)), weak.project(centre))
    assert square.focal_x / pose.apply(centre)[2] == pytest.approx(1.3)


def test_refuses_bad_input(points, rng):
    pixels = K.project(motion(rng).apply(points))
    with pytest.raises(ShapeError):
        estimate_rigid_motion(points, pixels[:-1], K)
    with pytest.raises(DegenerateError):
        estimate_rigid_motion(points * [1, 1, 0], pixels, K)
    with pytest.raises(ValueRangeError):
        estimate_rigid_motion(points, pixels * np.nan, K)
    for bad in ((0.0, 1.0, 0.0, 0.0), (1.0, -1.0, 0.0, 0.0), (1.0, 1.0, np.nan, 0.0)):
        with pytest.raises(ValueRangeError):
            Intrinsics(*bad)
