import numpy as np
import pytest

from facewright.camera.rotation import rotation_angle, rotation_from_head_angles
from facewright.camera.weak_perspective import WeakPerspective, estimate_weak_perspective
from facewright.errors import DegenerateError, ShapeError, ValueRangeError


@pytest.fixture
def points(rng):
    return rng.normal(size=(40, 3)) * [60.0, 80.0, 30.0]


def camera(rng):
    R = rotation_from_head_angles(*rng.uniform(-40, 40, 3))
    return WeakPerspective(float(rng.uniform(0.5, 5)), R, rng.uniform(0, 500, 2))


def test_recovers_the_camera_from_exact_points(points, rng):
    for _ in range(20):
        truth = camera(rng)
        found = estimate_weak_perspective(points, truth.project(points))
        assert found.scale == pytest.approx(truth.scale, rel=1e-9)
        assert rotation_angle(found.rotation, truth.rotation) < 1e-8
        np.testing.assert_allclose(found.translation, truth.translation, atol=1e-6)


def test_is_the_minimum_under_noise(points, rng):
    """No small change of the six parameters lowers the weighted error: finite differences of eq. (14)."""
    from facewright.camera.rotation import rotation_from_vector

    truth, w = camera(rng), rng.uniform(0.1, 2.0, len(points))
    pixels = truth.project(points) + rng.normal(0, 2.0, (len(points), 2))
    found = estimate_weak_perspective(points, pixels, w)

    def error(step):
        moved = WeakPerspective(
            found.scale * np.exp(step[3]), rotation_from_vector(step[:3]) @ found.rotation, found.translation + step[4:]
        )
        return float(w @ ((moved.project(points) - pixels) ** 2).sum(axis=1))

    h = 1e-5
    gradient = [(error(h * e) - error(-h * e)) / (2 * h) for e in np.eye(6)]
    curvature = [(error(h * e) + error(-h * e) - 2 * error(0 * e)) / h**2 for e in np.eye(6)]
    assert np.abs(np.array(gradient) / np.array(curvature)).max() < 1e-6
    assert min(curvature) > 0


def test_zero_weights_ignore_points(points, rng):
    truth = camera(rng)
    pixels = truth.project(points)
    pixels[:5] += 1000.0
    w = np.ones(len(points))
    w[:5] = 0.0
    assert rotation_angle(estimate_weak_perspective(points, pixels, w).rotation, truth.rotation) < 1e-8


def test_a_start_is_refined(points, rng):
    truth = camera(rng)
    turn = rotation_from_head_angles(5, 5, 5) @ np.diag([1, -1, -1])
    near = WeakPerspective(truth.scale * 1.2, turn @ truth.rotation, truth.translation)
    found = estimate_weak_perspective(points, truth.project(points), start=near, iterations=30)
    assert rotation_angle(found.rotation, truth.rotation) < 1e-7


def test_equivariance(points, rng):
    """Turning the model by Q turns the camera by Q^T and nothing else."""
    truth, Q = camera(rng), rotation_from_head_angles(20, 10, -30)
    pixels = truth.project(points) + rng.normal(0, 1, (len(points), 2))
    a, b = estimate_weak_perspective(points, pixels), estimate_weak_perspective(points @ Q.T, pixels)
    assert rotation_angle(a.rotation, b.rotation @ Q) < 1e-7
    assert a.scale == pytest.approx(b.scale, rel=1e-7)


@pytest.mark.parametrize(
    ("change", "error"),
    [
        (lambda p, q: (p[:3], q[:3]), DegenerateError),
        (lambda p, q: (p * [1, 1, 0], q), DegenerateError),
        (lambda p, q: (p * [1, 0, 0], q), DegenerateError),
        (lambda p, q: (p, 0 * q), DegenerateError),
        (lambda p, q: (p, q[:-1]), ShapeError),
        (lambda p, q: (p, np.where(np.arange(len(q))[:, None] == 3, np.nan, q)), ValueRangeError),
    ],
)
def test_refuses_what_gives_no_pose(points, rng, change, error):
    pixels = camera(rng).project(points)
    with pytest.raises(error):
        estimate_weak_perspective(*change(points, pixels))


def test_refuses_bad_weights(points, rng):
    pixels = camera(rng).project(points)
    with pytest.raises(ValueRangeError):
        estimate_weak_perspective(points, pixels, -np.ones(len(points)))
    with pytest.raises(DegenerateError):
        estimate_weak_perspective(points, pixels, np.zeros(len(points)))
    with pytest.raises(ValueRangeError):
        WeakPerspective(0.0, np.eye(3), np.zeros(2))
