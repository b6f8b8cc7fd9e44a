import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from facewright.errors import DegenerateError, ShapeError, ValueRangeError
from facewright.numeric.rotation import (
    matrix_from_quaternion,
    matrix_from_rotation_vector,
    nearest_rotation,
    quaternion_from_matrix,
    rotation_vector_from_matrix,
)

seeds = st.integers(0, 2**32 - 1)


def random_rotations(seed, *shape):
    return matrix_from_quaternion(np.random.default_rng(seed).normal(size=(*shape, 4)))


@settings(max_examples=30, deadline=None)
@given(seed=seeds)
def test_round_trips_and_group_axioms(seed):
    R = random_rotations(seed, 2, 3)
    assert R.shape == (2, 3, 3, 3)
    np.testing.assert_allclose(R @ np.swapaxes(R, -1, -2), np.broadcast_to(np.eye(3), R.shape), atol=1e-12)
    np.testing.assert_allclose(np.linalg.det(R), 1.0, atol=1e-12)
    np.testing.assert_allclose(matrix_from_rotation_vector(rotation_vector_from_matrix(R)), R, atol=1e-9)
    q = quaternion_from_matrix(R)
    assert (q[..., 0] >= 0).all()
    np.testing.assert_allclose(matrix_from_quaternion(3.0 * q), R, atol=1e-9)


@settings(max_examples=30, deadline=None)
@given(seed=seeds)
def test_nearest_rotation_beats_other_rotations(seed):
    M = np.random.default_rng(seed).normal(size=(3, 3))
    R = nearest_rotation(M)
    np.testing.assert_allclose(np.linalg.det(R), 1.0, atol=1e-12)
    others = random_rotations(seed + 1, 50)
    assert ((others - M) ** 2).sum(axis=(1, 2)).min() >= ((R - M) ** 2).sum() - 1e-12
    np.testing.assert_allclose(nearest_rotation(2.0 * R), R, atol=1e-12)


def test_quarter_turn_about_z_takes_x_to_y():
    R = matrix_from_rotation_vector(np.array([0.0, 0.0, np.pi / 2]))
    np.testing.assert_allclose(R @ [1, 0, 0], [0, 1, 0], atol=1e-15)
    np.testing.assert_allclose(quaternion_from_matrix(R), np.sqrt([0.5, 0, 0, 0.5]), atol=1e-15)


@pytest.mark.parametrize("function", [matrix_from_rotation_vector, matrix_from_quaternion])
def test_refuses_wrong_shapes_and_values(function):
    with pytest.raises(ShapeError):
        function(np.zeros(5))
    with pytest.raises(ValueRangeError):
        function(np.full(3 if function is matrix_from_rotation_vector else 4, np.nan))


@pytest.mark.parametrize("function", [rotation_vector_from_matrix, quaternion_from_matrix, nearest_rotation])
def test_matrix_functions_refuse_wrong_shapes(function):
    with pytest.raises(ShapeError):
        function(np.zeros((3, 2)))


def test_refuses_the_degenerate():
    with pytest.raises(DegenerateError):
        matrix_from_quaternion(np.zeros(4))
    with pytest.raises(DegenerateError):
        nearest_rotation(np.diag([1.0, 0, 0]))
    with pytest.raises(DegenerateError):
        nearest_rotation(-np.eye(3))
