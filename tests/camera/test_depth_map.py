"""Depth maps as points and normals."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from facewright.camera.depth_map import back_project, depth_normals
from facewright.camera.pinhole import Intrinsics
from facewright.errors import ShapeError

CAMERA = Intrinsics(575.8, 570.0, 30.5, 22.0)


@given(st.integers(0, 2**32 - 1))
def test_points_project_back_onto_their_pixels(seed):
    depth = np.random.default_rng(seed).uniform(400, 900, (45, 62))
    points = back_project(depth, CAMERA)
    pixels = CAMERA.project(points)
    y, x = np.mgrid[:45, :62]
    np.testing.assert_allclose(pixels, np.stack([x, y], axis=2), atol=1e-9)
    np.testing.assert_array_equal(points[..., 2], depth)


def test_normals_of_a_slanted_plane():
    normal = np.array([0.3, -0.2, -0.9])
    normal /= np.linalg.norm(normal)
    rays = back_project(np.ones((45, 62)), CAMERA)
    depth = 600.0 * normal[2] / (rays @ normal)
    found = depth_normals(back_project(depth, CAMERA))
    inside = found[1:-1, 1:-1]
    np.testing.assert_allclose(inside, np.broadcast_to(normal, inside.shape), atol=1e-9)
    assert np.isnan(found[0]).all()
    assert np.isnan(found[:, -1]).all()


def test_holes_and_steps_have_no_normal():
    depth = np.full((45, 62), 600.0)
    depth[10, 10] = 0.0
    depth[:, 40:] = 700.0
    points = back_project(depth, CAMERA)
    assert np.isnan(points[10, 10]).all()
    normals = depth_normals(points)
    assert np.isnan(normals[10, [9, 10, 11]]).all()
    assert np.isnan(normals[5, 39:41]).all()
    assert np.isfinite(normals[20, 20]).all()


def test_shapes_are_checked():
    with pytest.raises(ShapeError, match="depth must have shape"):
        back_project(np.zeros(5), CAMERA)
    with pytest.raises(ShapeError, match="points must have shape"):
        depth_normals(np.zeros((5, 5)))
