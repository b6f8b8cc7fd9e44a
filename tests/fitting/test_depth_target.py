import numpy as np
import pytest

from facewright.camera.pinhole import Intrinsics
from facewright.errors import NoFaceError
from facewright.fitting.depth_target import depth_target
from facewright.landmarks.points import Landmarks

CAMERA = Intrinsics(575.8, 575.8, 319.5, 239.5)


def ball(radius=90.0, distance=640.0):
    """Depth of a ball before the camera's axis, 0 beside it."""
    y, x = np.mgrid[:480, :640]
    ray = np.stack(
        [(x - CAMERA.centre_x) / CAMERA.focal_x, (y - CAMERA.centre_y) / CAMERA.focal_y, np.ones(x.shape)], 2
    )
    a, b = (ray**2).sum(axis=2), distance * ray[..., 2]
    square = b**2 - a * (distance**2 - radius**2)
    return np.where(square > 0, (b - np.sqrt(np.maximum(square, 0))) / a, 0.0)


def test_normals_and_triangles_face_the_camera(rng):
    pixels = rng.uniform([270, 190], [370, 290], (74, 2))
    target = depth_target(ball(), CAMERA, Landmarks("fw74", pixels))
    outward = target.points - [0, 0, 640.0]
    outward /= np.linalg.norm(outward, axis=1, keepdims=True)
    assert np.degrees(np.arccos(np.clip((outward * target.normals).sum(axis=1), -1, 1))).max() < 4.0
    a, b, c = (target.points[target.faces[:, k]] for k in range(3))
    assert (np.einsum("fc,fc->f", np.cross(b - a, c - a), outward[target.faces[:, 0]]) > 0).all()
    lifted = target.landmarks[20]
    assert abs(np.linalg.norm(lifted - [0, 0, 640.0]) - 90.0) < 0.3
    np.testing.assert_array_equal(target.contour_pixels, pixels)


def test_what_is_far_behind_is_left_out(rng):
    depth = ball()
    depth[depth == 0] = 1500.0
    target = depth_target(depth, CAMERA, Landmarks("fw74", rng.uniform([270, 190], [370, 290], (74, 2))))
    assert target.points[:, 2].max() < 700.0


@pytest.mark.parametrize("depth", [np.zeros((480, 640)), np.full((2, 2), 600.0)])
def test_refuses_depth_without_a_face(depth, rng):
    with pytest.raises(NoFaceError, match="depth map must show a face"):
        depth_target(depth, CAMERA, Landmarks("fw74", rng.uniform([270, 190], [370, 290], (74, 2))))


def test_refuses_too_few_landmarks():
    confidence = np.zeros(74)
    confidence[:3] = 1.0
    with pytest.raises(NoFaceError, match="at least 4"):
        depth_target(ball(), CAMERA, Landmarks("fw74", np.full((74, 2), 300.0), confidence))
