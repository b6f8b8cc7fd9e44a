import numpy as np
import pytest

from facewright.errors import ShapeError, ValueRangeError
from facewright.numeric.mode_product import mode_product, unfold


@pytest.mark.parametrize("mode", [0, 1, 2])
def test_product_is_a_matrix_product_of_the_unfolding(rng, mode):
    T = rng.normal(size=(3, 4, 5))
    M = rng.normal(size=(6, T.shape[mode]))
    product = mode_product(T, M, mode)
    np.testing.assert_allclose(unfold(product, mode), M @ unfold(T, mode), atol=1e-12)
    np.testing.assert_allclose(mode_product(T, M[0], mode), product.take(0, axis=mode), atol=1e-12)


def test_products_along_different_modes_commute(rng):
    T, A, B = rng.normal(size=(3, 4, 5)), rng.normal(size=(2, 4)), rng.normal(size=(6, 5))
    one, other = mode_product(mode_product(T, A, 1), B, 2), mode_product(mode_product(T, B, 2), A, 1)
    np.testing.assert_allclose(one, other, atol=1e-12)
    np.testing.assert_allclose(one, np.einsum("abc,ib,jc->aij", T, A, B), atol=1e-12)


def test_refuses():
    with pytest.raises(ValueRangeError):
        unfold(np.zeros((2, 2)), 2)
    with pytest.raises(ValueRangeError):
        mode_product(np.zeros((2, 2)), np.eye(2), -1)
    with pytest.raises(ShapeError):
        mode_product(np.zeros((2, 3)), np.eye(2), 1)
