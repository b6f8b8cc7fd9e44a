import numpy as np
import pytest

from facewright.errors import DegenerateError, FacewrightError
from facewright.models.region_affinity import nearness, region_affinity, vertex_correlation
from facewright.models.region_segmentation import (
    cluster_pieces,
    lonely_vertices,
    normalised_eigenvectors,
    segment_regions,
    settle_lonely,
)


def grid(columns: int, rows: int) -> tuple[np.ndarray, np.ndarray]:
    """A flat mesh of columns x rows vertices, 10 mm apart, y downwards."""
    y, x = np.mgrid[0:rows, 0:columns]
    vertices = np.stack([x.ravel() * 10.0, -y.ravel() * 10.0, 0.0 * x.ravel()], axis=1)
    i = (y[:-1, :-1] * columns + x[:-1, :-1]).ravel()
    faces = np.concatenate([np.stack([i, i + columns, i + 1], 1), np.stack([i + 1, i + columns, i + columns + 1], 1)])
    return vertices, faces.astype(np.int32)


def moving_blocks(rng, columns=12, rows=9, blocks=(3, 3), frames=300) -> tuple[np.ndarray, ...]:
    """A grid whose blocks move each by itself; (positions, vertices, faces, true labels)."""
    vertices, faces = grid(columns, rows)
    column, row = np.rint(vertices[:, 0] / 10).astype(int), np.rint(-vertices[:, 1] / 10).astype(int)
    truth = (row * blocks[1] // rows) * blocks[0] + column * blocks[0] // columns
    motion = rng.normal(size=(frames, truth.max() + 1, 3))[:, truth]
    return vertices + motion + 0.1 * rng.normal(size=motion.shape), vertices, faces, truth


def affinity_of(positions, vertices, faces):
    return region_affinity(vertex_correlation(positions), nearness(vertices, faces))


def test_blocks_that_move_by_themselves_are_found_and_k_is_theirs(rng):
    positions, vertices, faces, truth = moving_blocks(rng)
    A = affinity_of(positions, vertices, faces)
    found = segment_regions(A, vertices, faces, rng, n_regions=9).chosen
    assert found.compact and found.n_clusters == 9
    np.testing.assert_array_equal(found.labels, truth)  # numbered from the top, from the subject's right: as made
    automatic = segment_regions(A, vertices, faces, rng)
    assert automatic.chosen.compact and automatic.chosen.n_clusters >= 9
    again = segment_regions(A, vertices, faces, np.random.default_rng(3), n_regions=7).chosen.labels
    searched = segment_regions(A, vertices, faces, np.random.default_rng(3), max_regions=7).chosen.labels
    np.testing.assert_array_equal(again, searched)  # k is the same whether it was asked for or found
    if automatic.refused is not None:
        assert not automatic.refused.compact and automatic.refused.n_clusters == automatic.chosen.n_clusters + 1


def test_eigenvectors_are_those_of_the_normalised_affinity(rng):
    A = rng.random((12, 12))
    A = 0.5 * (A + A.T)
    bare = A.copy()
    np.fill_diagonal(bare, 0.0)
    L = bare / np.sqrt(np.outer(bare.sum(1), bare.sum(1)))
    vectors = normalised_eigenvectors(A, 4)
    values = np.sort(np.linalg.eigvalsh(L))[::-1]
    np.testing.assert_allclose(L @ vectors, vectors * values[:4], atol=1e-12)


def test_same_seed_same_regions(rng):
    positions, vertices, faces, _ = moving_blocks(rng, frames=40)
    A = affinity_of(positions, vertices, faces)
    one, two = (segment_regions(A, vertices, faces, np.random.default_rng(5)).chosen for _ in range(2))
    np.testing.assert_array_equal(one.labels, two.labels)
    assert one.scatter == two.scatter


def test_a_vertex_between_others_is_lonely():
    _, faces = grid(5, 5)
    labels = np.zeros(25, dtype=int)
    labels[12] = 1
    assert lonely_vertices(labels, faces).tolist() == [12]
    labels[[13, 17]] = 1  # 12, 17, 13 are a triangle
    assert lonely_vertices(labels, faces).tolist() == []


def test_ragged_vertices_join_their_neighbours():
    _, faces = grid(8, 8)
    labels = (np.arange(64) % 8 >= 4).astype(int)
    labels[3 * 8 + 6] = 0  # one vertex of the left cluster far in the right one
    assert lonely_vertices(labels, faces).tolist() == [30]
    settled, loose = settle_lonely(labels, faces, 0.2)
    assert settled[30] == 1 and not len(loose)
    assert (np.delete(settled, 30) == np.delete(labels, 30)).all()
    settled, loose = settle_lonely(labels, faces, 0.0)  # the letter
    np.testing.assert_array_equal(settled, labels)
    assert loose.tolist() == [0]


def test_a_row_of_single_vertices_is_loose():
    _, faces = grid(9, 9)
    labels = np.zeros(81, dtype=int)
    labels[[4, 13, 22, 31, 40]] = 1  # one column: no triangles
    labels[63:] = 2
    settled, loose = settle_lonely(labels, faces, 0.2)
    assert loose.tolist() == [1]
    assert (settled[[4, 13, 22, 31, 40]] == 1).all()


def test_pieces_count_islands():
    _, faces = grid(5, 2)
    assert cluster_pieces(np.array([0, 0, 1, 0, 0] * 2), faces).tolist() == [2, 1]


def test_progress_tells_each_k(rng):
    positions, vertices, faces, _ = moving_blocks(rng, 6, 6, (2, 2), 40)
    seen = []
    segment_regions(
        affinity_of(positions, vertices, faces), vertices, faces, rng, max_regions=4, progress=lambda *a: seen.append(a)
    )
    assert seen[0] == ("clustering", 2, 4)


def test_refusals(rng):
    vertices, faces = grid(3, 3)
    A = np.ones((9, 9))
    for options, words in (
        ({"n_regions": 10}, "between 1 and the number of vertices, 9"),
        ({"n_regions": 0}, "n_regions"),
        ({"restarts": 0}, "restarts"),
        ({"max_regions": 1}, "max_regions"),
        ({"ragged_share": 1.0}, "ragged_share"),
    ):
        with pytest.raises(FacewrightError, match=words):
            segment_regions(A, vertices, faces, rng, **options)
    lonely = A.copy()
    lonely[4] = lonely[:, 4] = 0.0
    with pytest.raises(FacewrightError, match="1 of 9 that have none"):
        segment_regions(lonely, vertices, faces, rng)
    with pytest.raises(FacewrightError, match="symmetric"):
        segment_regions(np.triu(A), vertices, faces, rng)
    # a checkerboard: clusters whose vertices form no triangles
    colour = np.arange(9) % 2
    with pytest.raises(DegenerateError, match="two clusters are already not compact"):
        segment_regions((colour[:, None] == colour) + 1e-6, vertices, faces, rng)
