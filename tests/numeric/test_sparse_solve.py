import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy import sparse

from facewright.errors import DegenerateError, ShapeError, ValueRangeError
from facewright.numeric.sparse_solve import SymmetricSolver, solve_symmetric


def random_spd(rng, n, density=0.1):
    B = sparse.random_array((n, n), density=density, rng=rng)
    return (B @ B.T + 0.1 * sparse.eye_array(n)).tocsc()


@settings(max_examples=30, deadline=None)
@given(n=st.integers(1, 60), columns=st.integers(0, 100), seed=st.integers(0, 2**32 - 1))
def test_solution_equals_the_dense_one(n, columns, seed):
    rng = np.random.default_rng(seed)
    A = random_spd(rng, n)
    B = rng.normal(size=(n, columns))
    np.testing.assert_allclose(SymmetricSolver(A).solve(B), np.linalg.solve(A.toarray(), B), atol=1e-9)


def test_one_vector_and_stacked_right_hand_sides_agree(rng):
    A = random_spd(rng, 40)
    B = rng.normal(size=(40, 5, 3))
    solver = SymmetricSolver(A)
    X = solver.solve(B)
    assert X.shape == B.shape
    np.testing.assert_allclose(solver.solve(B[:, 2, 1]), X[:, 2, 1], atol=1e-12)
    np.testing.assert_allclose(solve_symmetric(A, B[:, 0]), X[:, 0], atol=1e-12)


def test_the_input_is_not_modified_and_float32_is_taken(rng):
    A, b = random_spd(rng, 20), rng.normal(size=20).astype(np.float32)
    before, data = b.copy(), A.data.copy()
    X = SymmetricSolver(A).solve(b)
    assert X.dtype == np.float64
    np.testing.assert_array_equal(b, before)
    np.testing.assert_array_equal(A.data, data)


def test_factor_nonzeros_counts_a_dense_triangle():
    assert SymmetricSolver(sparse.csc_array(np.ones((4, 4)) + np.eye(4))).factor_nonzeros == 10


@pytest.mark.parametrize(
    ("A", "error"),
    [
        (sparse.csc_array(np.ones((2, 3))), ShapeError),
        (sparse.csc_array(np.zeros((3, 3))), DegenerateError),
        (sparse.csc_array(np.diag([1.0, -1.0])), DegenerateError),
        (sparse.csc_array(np.array([[1.0, -1.0], [-1.0, 1.0]])), DegenerateError),
        (sparse.csc_array(np.array([[1e-30, 1.0], [1.0, 1.0]])), DegenerateError),
        (sparse.csc_array(np.diag([1.0, np.nan])), ValueRangeError),
    ],
)
def test_refuses_what_is_not_positive_definite(A, error):
    with pytest.raises(error):
        SymmetricSolver(A)


def test_refuses_a_right_hand_side_of_another_size():
    with pytest.raises(ShapeError, match="n=3"):
        SymmetricSolver(sparse.eye_array(3)).solve(np.zeros(4))
