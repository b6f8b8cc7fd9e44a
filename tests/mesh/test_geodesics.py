import importlib.util
from pathlib import Path

import numpy as np
import pytest

from facewright.errors import DegenerateError, ShapeError, ValueRangeError
from facewright.mesh.geodesics import HeatGeodesics, heat_distances, path_distances, path_graph

_spec = importlib.util.spec_from_file_location(
    "reference_operators", Path(__file__).with_name("reference_operators.py")
)
reference = importlib.util.module_from_spec(_spec)
_spec.loader.exec_module(reference)


def test_paths_equal_bellman_ford(grid, rng):
    vertices, faces = grid(3, 0.1, rng)
    graph = path_graph(vertices, faces).toarray()
    np.testing.assert_array_equal(graph, graph.T)
    found = path_distances(vertices, faces, np.array([0, 7]))
    for row, source in zip(found, (0, 7)):
        np.testing.assert_allclose(row, reference.shortest_paths(graph, source))


def test_both_diagonals_of_a_square_are_joined(grid):
    vertices, faces = grid(1)
    with_diagonals, edges_only = (
        path_distances(vertices, faces, np.array([1]), diagonals=d)[0, 2] for d in (True, False)
    )
    assert with_diagonals == pytest.approx(np.sqrt(2))
    assert edges_only == pytest.approx(2)


def test_a_flattened_line_outside_the_pair_goes_around_the_corner():
    vertices = np.array([[0.0, 0, 0], [1, 0, 0], [-1, 1, 0], [-1, -1, 0]])
    faces = np.array([[0, 1, 2], [1, 0, 3]])
    assert path_graph(vertices, faces)[2, 3] == pytest.approx(2 * np.sqrt(2))


def test_diagonals_halve_the_error_on_a_plane(grid):
    vertices, faces = grid(20)
    true = np.linalg.norm(vertices - vertices[0], axis=1)
    error = [np.abs(path_distances(vertices, faces, np.array([0]), diagonals=d)[0] - true).max() for d in (True, False)]
    assert error[0] <= 0.09 * true.max()
    assert error[0] <= error[1] + 1e-12
    assert (path_distances(vertices, faces, np.array([0]))[0] >= true - 1e-9).all()


def test_heat_distance_on_a_plane(grid):
    vertices, faces = grid(40)
    middle = 20 * 41 + 20
    true = np.linalg.norm(vertices - vertices[middle], axis=1)
    found = HeatGeodesics(vertices, faces).distances(np.array([middle]))
    assert found[middle] == 0
    assert np.sqrt(np.mean((found - true) ** 2)) < 0.03 * true.max()
    np.testing.assert_array_equal(heat_distances(vertices, faces, np.array([middle])), found)


def test_distance_to_the_nearest_of_several_sources(grid):
    vertices, faces = grid(20)
    ends = np.array([0, 20])
    found = heat_distances(vertices, faces, ends)
    true = np.linalg.norm(vertices[:, None] - vertices[ends], axis=2).min(axis=1)
    assert np.sqrt(np.mean((found - true) ** 2)) < 0.05 * true.max()


def test_other_components_and_far_vertices_are_infinite(grid):
    vertices, faces = grid(3)
    both = np.concatenate([vertices, vertices + [0, 0, 9], [[0, 0, 50.0]]])
    triangles = np.concatenate([faces, faces + len(vertices)])
    for found in (path_distances(both, triangles, np.array([0]))[0], heat_distances(both, triangles, np.array([0]))):
        assert np.isfinite(found[: len(vertices)]).all()
        assert np.isinf(found[len(vertices) :]).all()
    near = path_distances(both, triangles, np.array([0]), limit_mm=1.2)[0]
    assert np.isfinite(near).sum() == 3


def test_refuses(grid):
    vertices, faces = grid(2)
    with pytest.raises(ValueRangeError):
        path_distances(vertices, faces, np.array([99]))
    with pytest.raises(ShapeError):
        path_graph(vertices[:, :2], faces)
    with pytest.raises(ValueRangeError):
        HeatGeodesics(vertices, faces, time_factor=0)
    with pytest.raises(ValueRangeError):
        HeatGeodesics(vertices, faces).distances(np.array([], dtype=int))
    with pytest.raises(DegenerateError):
        HeatGeodesics(vertices * 0, faces)
