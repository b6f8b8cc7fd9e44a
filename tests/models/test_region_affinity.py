import numpy as np
import pytest

from facewright.errors import FacewrightError, ShapeError, ValueRangeError
from facewright.models.region_affinity import nearness, region_affinity, still_coordinates, vertex_correlation


def strip(n: int) -> tuple[np.ndarray, np.ndarray]:
    """Two rows of n vertices 10 mm apart, joined by triangles."""
    x = np.arange(n) * 10.0
    vertices = np.concatenate([np.stack([x, 0 * x, 0 * x], 1), np.stack([x, 0 * x + 10.0, 0 * x], 1)])
    i = np.arange(n - 1)
    faces = np.concatenate([np.stack([i, i + 1, i + n], 1), np.stack([i + 1, i + 1 + n, i + n], 1)])
    return vertices, faces.astype(np.int32)


def test_correlation_is_the_mean_of_three_correlation_matrices(rng):
    positions = rng.normal(size=(50, 7, 3))
    naive = np.mean([np.corrcoef(positions[:, :, axis], rowvar=False) for axis in range(3)], axis=0)
    np.testing.assert_allclose(vertex_correlation(positions), naive, atol=1e-12)


def test_still_coordinates_are_left_out_of_the_mean(rng):
    positions = rng.normal(size=(50, 4, 3))
    positions[:, 0, 1] = 3.0  # one coordinate of one vertex
    positions[:, 3] = [1.0, 2.0, 3.0]  # a vertex that never moves
    C = vertex_correlation(positions)
    r = [np.corrcoef(positions[:, 0, a], positions[:, 1, a])[0, 1] for a in (0, 2)]
    assert C[0, 1] == pytest.approx(np.mean(r), abs=1e-12)
    assert C[3, 3] == 1.0 and (C[3, :3] == 0.0).all()
    assert still_coordinates(positions).sum() == 4


@pytest.mark.parametrize(
    ("positions", "words"),
    [
        (np.zeros((1, 4, 3)), "at least 2 frames"),
        (np.ones((5, 4, 3)), "vertices that move"),
        (np.full((5, 4, 3), np.nan), "finite"),
        (np.zeros((5, 4)), "positions"),
    ],
)
def test_correlation_refuses_what_has_none(positions, words):
    with pytest.raises(FacewrightError, match=words):
        vertex_correlation(positions)


def test_nearness_falls_along_the_edges():
    vertices, faces = strip(6)
    near = nearness(vertices, faces, 10.0)
    np.testing.assert_allclose(near[0, :6], np.exp(-np.arange(6.0)), rtol=1e-12)
    np.testing.assert_allclose(near, near.T)
    assert near[0, 7] == pytest.approx(np.exp(-2.0))  # across: two edges, the diagonal runs the other way
    assert nearness(vertices, faces)[0, 5] < np.exp(-4.9)  # near zero at 50 mm with the paper's radius


def test_nearness_refuses_two_pieces_and_bad_radii():
    vertices, faces = strip(4)
    twice = np.concatenate([vertices, vertices + 100.0]), np.concatenate([faces, faces + len(vertices)])
    with pytest.raises(ValueRangeError, match="2 pieces of 8, 8 vertices"):
        nearness(*twice)
    for radius in (0.0, -1.0, np.inf):
        with pytest.raises(ValueRangeError, match="radius_mm"):
            nearness(vertices, faces, radius)


def test_affinity_mixes_thresholded_correlation_and_nearness():
    C = np.array([[1.0, 0.69, 0.8], [0.69, 1.0, -0.9], [0.8, -0.9, 1.0]])
    near = np.array([[1.0, 0.5, 0.1], [0.5, 1.0, 0.2], [0.1, 0.2, 1.0]])
    A = region_affinity(C, near)
    assert A[0, 1] == pytest.approx(0.3 * 0.5)  # below 0.7: distance alone
    assert A[0, 2] == pytest.approx(0.7 * 0.8 + 0.3 * 0.1)
    assert A[1, 2] == pytest.approx(0.3 * 0.2)
    np.testing.assert_allclose(region_affinity(C, near, share=0.0), near)
    assert region_affinity(C, near, share=1.0, threshold=0.0)[0, 1] == 0.69


def test_affinity_refuses_other_shapes_and_parameters():
    with pytest.raises(ShapeError, match="near"):
        region_affinity(np.eye(3), np.eye(4))
    for options in ({"share": 1.1}, {"threshold": -0.1}):
        with pytest.raises(ValueRangeError, match=next(iter(options))):
            region_affinity(np.eye(3), np.eye(3), **options)
