import numpy as np
import pytest

from facewright.errors import ShapeError, TopologyError, ValueRangeError
from facewright.mesh.connectivity import (
    boundary_edges,
    boundary_loops,
    unique_edges,
    vertex_adjacency,
    vertex_components,
)

TETRAHEDRON = np.array([[0, 1, 2], [0, 3, 1], [1, 3, 2], [2, 3, 0]])


def test_a_tetrahedron_has_six_edges_and_no_boundary():
    edges = unique_edges(TETRAHEDRON)
    np.testing.assert_array_equal(edges, [[0, 1], [0, 2], [0, 3], [1, 2], [1, 3], [2, 3]])
    assert len(boundary_edges(TETRAHEDRON)) == 0
    assert boundary_loops(TETRAHEDRON) == []


def test_edges_equal_the_obvious_set(rng):
    faces = rng.integers(0, 30, (50, 3))
    expected = {tuple(sorted((t[a], t[b]))) for t in faces.tolist() for a, b in ((0, 1), (1, 2), (2, 0))}
    assert [tuple(e) for e in unique_edges(faces).tolist()] == sorted(expected)


def test_euler_formula_and_boundary_of_a_grid(grid):
    vertices, faces = grid(4)
    assert len(vertices) - len(unique_edges(faces)) + len(faces) == 1
    loops = boundary_loops(faces)
    assert len(loops) == 1
    assert len(loops[0]) == 16
    # Boundaries run with the triangles: the interior is on the left, so the signed area is positive.
    x, y, _ = vertices[loops[0]].T
    assert np.sum(x * np.roll(y, -1) - y * np.roll(x, -1)) / 2 == pytest.approx(16)


def test_loops_are_sorted_longest_first(grid):
    _, faces = grid(5)
    inner = [f for f in range(len(faces)) if f % 25 == 12]
    loops = boundary_loops(np.delete(faces, inner, axis=0))
    assert [len(loop) for loop in loops] == [20, 4]


def test_components_and_adjacency():
    faces = np.array([[0, 1, 2], [3, 4, 5]])
    assert vertex_components(faces, 7).tolist() == [0, 0, 0, 1, 1, 1, 2]
    A = vertex_adjacency(faces, 7)
    assert (A != A.T).nnz == 0
    assert A.sum() == 12
    assert vertex_components(np.zeros((0, 3), int), 2).tolist() == [0, 1]


def test_touching_boundaries_are_refused():
    with pytest.raises(TopologyError):
        boundary_loops(np.array([[0, 1, 2], [0, 3, 4]]))


def test_refuses_wrong_faces():
    with pytest.raises(ShapeError):
        unique_edges(np.zeros((2, 4), int))
    with pytest.raises(ShapeError):
        boundary_edges(np.zeros((2, 4), int))
    with pytest.raises(ValueRangeError):
        vertex_components(np.array([[0, 1, 5]]), 5)
