import numpy as np
import pytest

from facewright.camera.rotation import (
    cross_matrix,
    head_angles_from_rotation,
    rotation_angle,
    rotation_from_head_angles,
    rotation_from_vector,
)
from facewright.errors import ShapeError


def test_rotation_vector_is_orthogonal_and_turns_by_its_length(rng):
    for _ in range(20):
        w = rng.normal(size=3)
        R = rotation_from_vector(w)
        np.testing.assert_allclose(R @ R.T, np.eye(3), atol=1e-12)
        assert np.linalg.det(R) == pytest.approx(1.0)
        np.testing.assert_allclose(R @ w, w, atol=1e-12)
        assert rotation_angle(np.eye(3), R) == pytest.approx(min(np.linalg.norm(w), 2 * np.pi - np.linalg.norm(w)))


def test_small_rotation_vectors_agree_with_the_formula():
    w = np.array([1e-9, -2e-9, 3e-9])
    np.testing.assert_allclose(rotation_from_vector(w), np.eye(3) + cross_matrix(w), atol=1e-17)
    assert rotation_angle(np.eye(3), rotation_from_vector(w)) == pytest.approx(np.linalg.norm(w))


def test_cross_matrix(rng):
    a, b = rng.normal(size=(2, 3))
    np.testing.assert_allclose(cross_matrix(a) @ b, np.cross(a, b))


@pytest.mark.parametrize("angles", [(0, 0, 0), (35, -20, 15), (-80, 40, -170), (10, 0, 0), (0, 10, 0), (0, 0, 10)])
def test_head_angles_round_trip(angles):
    np.testing.assert_allclose(head_angles_from_rotation(rotation_from_head_angles(*angles)), angles, atol=1e-9)


def test_head_angles_mean_what_they_say():
    # model: y up, face along +z, subject's left +x; camera: x right, y down, z away
    np.testing.assert_allclose(rotation_from_head_angles(0, 0, 0) @ [0, 0, 1], [0, 0, -1], atol=1e-12)
    assert (rotation_from_head_angles(30, 0, 0) @ [0, 0, 1])[0] > 0.4  # own left is the picture's right
    assert (rotation_from_head_angles(0, 30, 0) @ [0, 0, 1])[1] < -0.4  # looks up: y points down
    assert (rotation_from_head_angles(0, 0, 30) @ [0, 1, 0])[0] > 0.4  # top of the head to the picture's right


def test_head_angles_agree_with_the_portrait_camera():
    from facewright.imaging.portrait import portrait_view

    points = np.random.default_rng(0).normal(size=(10, 3)) * 50
    seen, _ = portrait_view(
        points, (100, 100), yaw_degrees=25, pitch_degrees=-12, roll_degrees=8, centre_mm=(0, 0, 0), distance_mm=700
    )
    np.testing.assert_allclose(points @ rotation_from_head_angles(25, -12, 8).T + [0, 0, 700], seen, atol=1e-9)


def test_rotation_vector_refuses_other_shapes():
    with pytest.raises(ShapeError):
        rotation_from_vector([1.0, 2.0])
