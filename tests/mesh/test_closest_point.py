import importlib.util
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from facewright.errors import DegenerateError, ShapeError, ValueRangeError
from facewright.mesh.closest_point import ClosestPoints, closest_points

_spec = importlib.util.spec_from_file_location(
    "reference_operators", Path(__file__).with_name("reference_operators.py")
)
reference = importlib.util.module_from_spec(_spec)
_spec.loader.exec_module(reference)


@settings(max_examples=25, deadline=None)
@given(n_faces=st.integers(1, 40), flat=st.booleans(), seed=st.integers(0, 2**32 - 1))
def test_equals_search_through_all_triangles(n_faces, flat, seed):
    rng = np.random.default_rng(seed)
    vertices = rng.normal(size=(12, 3))
    faces = rng.integers(0, 12, (n_faces, 3))  # flat triangles among them
    if flat:
        vertices[:, 2] = 0
    points = rng.normal(size=(15, 3)) * 2
    found = closest_points(vertices, faces, points)
    for n, p in enumerate(points):
        feet = [reference.closest_on_triangle(p, *vertices[t]) for t in faces]
        least = min(np.linalg.norm(foot - p) for foot in feet)
        assert found.distances[n] == pytest.approx(least, abs=1e-9)
        assert np.linalg.norm(found.points[n] - p) == pytest.approx(least, abs=1e-9)
        np.testing.assert_allclose(found.barycentric[n] @ vertices[faces[found.faces[n]]], found.points[n])
    assert (found.barycentric >= 0).all()
    np.testing.assert_allclose(found.barycentric.sum(axis=1), 1)


def test_points_on_the_surface_are_their_own_closest_points(grid, rng):
    vertices, faces = grid(30, 0.1, rng)
    weights = rng.dirichlet(np.ones(3), 3000)
    chosen = rng.integers(0, len(faces), 3000)
    points = np.einsum("nk,nkx->nx", weights, vertices[faces[chosen]])
    found = ClosestPoints(vertices, faces).query(points)
    assert found.distances.max() < 1e-12
    np.testing.assert_allclose(found.points, points, atol=1e-12)


def test_nothing_within_the_limit(grid):
    search = ClosestPoints(*grid(2))
    found = search.query(np.array([[0.5, 0.5, 3.0], [0.5, 0.5, 1.0]]), limit_mm=2.0)
    assert found.faces[0] == -1
    assert np.isinf(found.distances[0])
    assert np.isnan(found.points[0]).all()
    assert found.distances[1] == pytest.approx(1.0)
    assert search.query(np.zeros((0, 3))).faces.shape == (0,)


def test_refuses(grid):
    vertices, faces = grid(2)
    with pytest.raises(DegenerateError):
        ClosestPoints(vertices, faces[:0])
    with pytest.raises(ValueRangeError):
        ClosestPoints(vertices * np.nan, faces)
    with pytest.raises(ShapeError):
        closest_points(vertices, faces, np.zeros(3))
    with pytest.raises(ValueRangeError):
        closest_points(vertices, faces, np.full((1, 3), np.nan))
    with pytest.raises(ValueRangeError):
        ClosestPoints(vertices, faces).query(np.zeros((1, 3)), limit_mm=0)
