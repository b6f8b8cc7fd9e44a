import numpy as np
import pytest

from facewright.camera.pinhole import Intrinsics, RigidMotion
from facewright.camera.rotation import rotation_from_head_angles
from facewright.fitting.dense_model import DenseModel, FramePose
from facewright.landmarks.dense import head_plane


@pytest.fixture(scope="module")
def dense(small_model):
    return DenseModel(small_model)


def make_state(dense, rng):
    person = dense.person(0.5 * rng.normal(size=dense.n_identity), 0.5 * rng.normal(size=dense.n_modes))
    R = rotation_from_head_angles(*rng.uniform(-15, 15, 3))
    pose = FramePose(RigidMotion(R, np.array([5.0, -8.0, 600.0])), Intrinsics.for_image((480, 640), 900.0))
    return person, pose, rng.uniform(0.1, 0.5, dense.n_shapes)


def test_points_are_the_model_s_vertices(dense, small_model, rng):
    c = 0.5 * rng.normal(size=dense.n_identity)
    person = dense.person(c, np.zeros(dense.n_modes))
    rig = small_model.blendshapes(dense.identity_of(person))
    np.testing.assert_allclose(person.neutral, rig.neutral[dense.points.vertices], atol=1e-2)
    np.testing.assert_allclose(person.deltas.transpose(2, 0, 1), rig.deltas[:, dense.points.vertices], atol=1e-2)


def test_what_is_predicted_leaves_no_residual(dense, rng):
    person, pose, beta = make_state(dense, rng)
    found = dense.predict(person, pose, beta)
    assert np.abs(dense.residual(found, person, pose, beta)).max() < 1e-2


def test_derivatives_by_coefficients_and_the_shared_unknowns(dense, rng):
    """Finite differences, in a plane that is held still."""
    person, pose, beta = make_state(dense, rng)
    found = dense.predict(person, pose, beta) + rng.normal(0, 1, (dense.points.n_points, 2))
    system = dense.system(found, person, pose, beta, shared=True)
    np.testing.assert_allclose(system.residual, dense.residual(found, person, pose, beta), atol=2e-3)
    h = 1e-2
    for i in rng.integers(0, dense.n_shapes, 4):
        step = np.eye(dense.n_shapes)[i] * h
        numeric = (
            dense.residual(found, person, pose, beta + step) - dense.residual(found, person, pose, beta - step)
        ) / (2 * h)
        np.testing.assert_allclose(system.by_own[:, 6 + i], numeric, atol=0.02 * np.abs(numeric).max() + 0.05)
    for k in (0, 1, dense.n_identity, dense.n_identity + 30):
        n = dense.n_identity
        moved = []
        for sign in (1.0, -1.0):
            c, q = person.c.copy(), person.q.copy()
            (c if k < n else q)[k if k < n else k - n] += sign * h
            moved.append(dense.residual(found, dense.person(c, q), pose, beta))
        numeric = (moved[0] - moved[1]) / (2 * h)
        np.testing.assert_allclose(system.by_shared[:, k], numeric, atol=0.02 * np.abs(numeric).max() + 0.05)
    plane = head_plane(pose.motion.rotation, pose.scale)
    for j in range(6):
        step = np.eye(6)[j] * (1e-3 if j not in (3, 4) else 0.1)
        size = step[j]
        there, back = (dense.residual(found, person, pose.moved(s * step), beta, plane) for s in (1.0, -1.0))
        numeric = (there - back) / (2 * size)
        error = np.linalg.norm(system.by_own[:, j] - numeric) / np.linalg.norm(numeric)
        assert error < 0.05, j


def test_zooming_keeps_the_size_of_the_head(dense, rng):
    _, pose, _ = make_state(dense, rng)
    far = pose.zoomed(0.3)
    assert far.scale == pytest.approx(pose.scale)
    assert far.intrinsics.focal_x == pytest.approx(pose.intrinsics.focal_x * np.exp(0.3))
