import numpy as np
import pytest

from facewright.camera.pinhole import Intrinsics
from facewright.errors import ShapeError
from facewright.landmarks.lift import lift_landmarks
from facewright.landmarks.points import Landmarks
from facewright.landmarks.scheme import load_scheme

CAMERA = Intrinsics(500.0, 500.0, 99.5, 79.5)


def tilted_plane(height=160, width=200):
    """Depth of the plane z = 600 + 0.2 x - 0.1 y (camera's frame), exactly."""
    x = (np.arange(width) - CAMERA.centre_x) / CAMERA.focal_x
    y = (np.arange(height) - CAMERA.centre_y) / CAMERA.focal_y
    return 600.0 / (1.0 - 0.2 * x[None] + 0.1 * y[:, None])


def test_points_on_a_plane_come_back(rng):
    pixels = rng.uniform([20, 20], [180, 140], (74, 2))
    points, confidence = lift_landmarks(Landmarks("fw74", pixels), tilted_plane(), CAMERA)
    scheme = load_scheme("fw74")
    inner = points[scheme.fixed]
    np.testing.assert_allclose(inner[:, 2], 600 + 0.2 * inner[:, 0] - 0.1 * inner[:, 1], atol=0.01)
    np.testing.assert_allclose(CAMERA.project(inner), pixels[scheme.fixed], atol=1e-9)
    assert np.isnan(points[scheme.sliding]).all(), "contour points stay 2D"
    assert (confidence == 1).all()


def test_rims_holes_and_borders_stay_2d():
    depth = tilted_plane()
    depth[:, 100:] += 40.0  # a step
    depth[40:80, 20:60] = 0.0  # a hole
    pixels = np.tile([50.0, 120.0], (74, 1))
    pixels[20] = [100.2, 120.0]  # the surface behind the step
    pixels[21] = [99.0, 120.0]  # most of its surroundings lie on the front surface
    pixels[22] = [40.0, 60.0]
    pixels[23] = [500.0, 60.0]
    points, confidence = lift_landmarks(Landmarks("fw74", pixels), depth, CAMERA)
    assert np.isnan(points[[20, 22, 23]]).all()
    assert np.isfinite(points[24]).all()
    assert (confidence[[20, 22, 23]] > 0).all(), "they still count in the picture"
    assert np.isnan(points[21]).all() or abs(points[21, 2] - depth[120, 99]) < 1.0


def test_missing_landmarks_stay_missing():
    confidence = np.ones(74)
    confidence[30] = 0.0
    points, found = lift_landmarks(Landmarks("fw74", np.full((74, 2), 60.0), confidence), tilted_plane(), CAMERA)
    assert np.isnan(points[30]).all() and found[30] == 0


def test_refuses_a_depth_map_of_another_shape():
    with pytest.raises(ShapeError, match="depth"):
        lift_landmarks(Landmarks("fw74", np.zeros((74, 2))), np.zeros((4, 4, 3)), CAMERA)
