import numpy as np
import pytest


@pytest.fixture
def patch():
    """A bumpy open patch in mm: vertices, faces."""

    def make(rng, n=6, size=60.0, bump=3.0):
        y, x = np.mgrid[0 : n + 1, 0 : n + 1].astype(float)
        vertices = np.stack([x.ravel(), y.ravel(), np.zeros(x.size)], axis=1) * size / n
        vertices += bump * rng.normal(size=vertices.shape)
        k = np.arange(n * (n + 1)).reshape(n, n + 1)[:, :-1].ravel()
        return vertices, np.concatenate(
            [
                np.stack([k, k + 1, k + n + 2], axis=1),
                np.stack([k, k + n + 2, k + n + 1], axis=1),
            ]
        )

    return make
