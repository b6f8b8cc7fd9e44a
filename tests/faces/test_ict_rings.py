import importlib.util
from pathlib import Path

import numpy as np

from facewright.faces.ict_rings import (
    contact_pairs,
    enclosed,
    opening_rings,
    polygon_adjacency,
    polygon_edges,
    shortest_path,
)

spec = importlib.util.spec_from_file_location("reference_faces", Path(__file__).parent / "reference_faces.py")
reference = importlib.util.module_from_spec(spec)
spec.loader.exec_module(reference)


def annulus(rings=4, n=12):
    """A flat ring of quads round a hole, corners at x = -1 and 1 of the hole."""
    angle = 2 * np.pi * np.arange(n) / n
    points = np.concatenate(
        [np.stack([(1 + r) * np.cos(angle), (1 + r) * np.sin(angle), 0 * angle], axis=1) for r in range(rings)]
    )
    quads = [
        [r * n + k, r * n + (k + 1) % n, (r + 1) * n + (k + 1) % n, (r + 1) * n + k]
        for r in range(rings - 1)
        for k in range(n)
    ]
    return points, np.array(quads, np.int32)


def test_polygon_edges_of_a_quad_and_a_triangle_have_no_diagonal():
    edges = polygon_edges(np.array([[0, 1, 2, 3], [3, 2, 4, -1]], np.int32))
    assert {tuple(edge) for edge in edges} == {(0, 1), (1, 2), (2, 3), (3, 0), (3, 2), (2, 4), (4, 3)}


def test_rings_equal_growing_sets_and_sides_split_at_the_corners():
    points, quads = annulus()
    loop = np.arange(12)
    rings = opening_rings(points, polygon_adjacency(quads, len(points)), loop)
    assert np.array_equal(rings.ring, reference.nearest_rings(quads, loop, len(points)))
    assert set(rings.corners) == {0, 6}
    assert (points[rings.upper, 1] > 0).all()
    assert (points[rings.lower, 1] < 0).all()
    assert not (rings.upper & rings.lower).any()


def test_contact_pairs_are_mutual_nearest(rng):
    points = rng.normal(size=(40, 3))
    upper, lower = np.arange(20), np.arange(20, 40)
    a, b = contact_pairs(points, upper, lower, 0.8)
    assert set(zip(a.tolist(), b.tolist())) == reference.mutual_pairs(points, upper, lower, 0.8)
    assert (np.diff(points[b, 0]) >= 0).all()


def test_shortest_path_goes_round_and_encloses_the_inside():
    points, quads = annulus()
    lengths = polygon_adjacency(quads, len(points), points)
    path = shortest_path(lengths, np.array([24, 27, 30, 33, 24]))
    assert path[0] == path[-1] == 24
    assert set(path) == set(range(24, 36))  # the third ring
    inside = enclosed(polygon_adjacency(quads, len(points)), path, 0)
    assert np.array_equal(inside, np.arange(36))
