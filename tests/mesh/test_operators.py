"""Areas, Laplacian, gradient, frames: twins with loops, identities between routes, invariance."""

import importlib.util
from pathlib import Path

import numpy as np
import pytest
from scipy import sparse

from facewright.errors import DegenerateError, ShapeError
from facewright.mesh.areas import face_areas, mean_edge_length, vertex_areas
from facewright.mesh.gradient import gradient_operator, hat_gradients
from facewright.mesh.laplacian import cotangent_laplacian, mass_matrix
from facewright.mesh.triangle_frames import (
    deformation_gradients,
    degenerate_triangles,
    inverse_frames,
    triangle_frames,
)
from facewright.numeric.rotation import matrix_from_quaternion

_spec = importlib.util.spec_from_file_location(
    "reference_operators", Path(__file__).with_name("reference_operators.py")
)
reference = importlib.util.module_from_spec(_spec)
_spec.loader.exec_module(reference)


def test_areas_of_a_flat_grid(grid):
    vertices, faces = grid(3)
    np.testing.assert_allclose(face_areas(vertices, faces), 0.5)
    areas = vertex_areas(vertices, faces)
    assert areas.sum() == pytest.approx(9)
    assert mass_matrix(vertices, faces).trace() == pytest.approx(9)
    assert areas[5] == pytest.approx(1)
    assert mean_edge_length(vertices, faces) == pytest.approx((24 + 9 * np.sqrt(2)) / 33)
    assert mean_edge_length(vertices, faces[:0]) == 0.0


def test_laplacian_equals_its_twin_and_the_gradient_route(grid, rng):
    vertices, faces = grid(4, 0.2, rng)
    L = cotangent_laplacian(vertices, faces, clamp=False)
    np.testing.assert_allclose(L.toarray(), reference.cotangent_laplacian(vertices, faces), atol=1e-12)
    areas = face_areas(vertices, faces)
    for tangential in (False, True):
        G = gradient_operator(vertices, faces, tangential=tangential)
        A = sparse.diags(np.repeat(areas, 2 if tangential else 3))
        np.testing.assert_allclose((G.T @ A @ G).toarray(), L.toarray(), atol=1e-10)


def test_clamped_laplacian_has_no_positive_neighbours_and_ignores_motion(grid, rng):
    vertices, faces = grid(4, 0.3, rng)
    L = cotangent_laplacian(vertices, faces)
    off = L - sparse.diags(L.diagonal())
    assert off.data.max() <= 0
    np.testing.assert_allclose(L @ np.ones(len(vertices)), 0, atol=1e-12)
    R = matrix_from_quaternion(rng.normal(size=4))
    moved = 3 * vertices @ R.T + [5, 6, 7]
    np.testing.assert_allclose(cotangent_laplacian(moved, faces).toarray(), L.toarray(), atol=1e-9)


def test_gradient_of_a_linear_function_is_its_tangential_part(grid, rng):
    vertices, faces = grid(3, 0.2, rng)
    slope = rng.normal(size=3)
    gradients = (gradient_operator(vertices, faces) @ (vertices @ slope)).reshape(-1, 3)
    normals = triangle_frames(vertices, faces)[..., 2]
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    expected = slope - (normals @ slope)[:, None] * normals
    np.testing.assert_allclose(gradients, expected, atol=1e-10)
    np.testing.assert_allclose(hat_gradients(vertices, faces).sum(axis=1), 0, atol=1e-12)


def test_frames_equal_their_twin_and_invert(grid, rng):
    vertices, faces = grid(3, 0.2, rng)
    frames = triangle_frames(vertices, faces)
    expected = [reference.frame(*vertices[t]) for t in faces]
    np.testing.assert_allclose(frames, expected, atol=1e-12)
    identity = np.broadcast_to(np.eye(3), frames.shape)
    np.testing.assert_allclose(inverse_frames(frames) @ frames, identity, atol=1e-10)


def test_deformation_gradients_of_a_similarity_are_its_matrix(grid, rng):
    vertices, faces = grid(3, 0.2, rng)
    M = 1.7 * matrix_from_quaternion(rng.normal(size=4))
    Q = deformation_gradients(vertices, np.stack([vertices, vertices @ M.T + 4]), faces)
    np.testing.assert_allclose(Q[0], np.broadcast_to(np.eye(3), Q[0].shape), atol=1e-10)
    np.testing.assert_allclose(Q[1], np.broadcast_to(M, Q[1].shape), atol=1e-9)


FLAT = np.array([[0.0, 0, 0], [1, 0, 0], [2, 0, 0], [0, 1, 0]])


def test_flat_triangles_are_seen_and_refused_where_they_matter():
    faces = np.array([[0, 1, 2], [0, 1, 3], [3, 3, 3]])
    frames = triangle_frames(FLAT, faces)
    assert degenerate_triangles(frames).tolist() == [True, False, True]
    assert np.isfinite(frames).all()
    for function in (cotangent_laplacian, hat_gradients, gradient_operator):
        with pytest.raises(DegenerateError, match="2 without"):
            function(FLAT, faces)
    with pytest.raises(DegenerateError):
        deformation_gradients(FLAT, FLAT, faces)


def test_refuses_wrong_shapes():
    with pytest.raises(ShapeError):
        triangle_frames(np.zeros((4, 2)), np.zeros((1, 3), int))
    with pytest.raises(ShapeError):
        triangle_frames(np.zeros((4, 3)), np.zeros((1, 4), int))
    with pytest.raises(ShapeError):
        deformation_gradients(FLAT, FLAT[:3], np.array([[0, 1, 3]]))
