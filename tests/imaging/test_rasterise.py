import importlib.util
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from facewright.errors import ShapeError, ValueRangeError
from facewright.imaging.rasterise import rasterise

_spec = importlib.util.spec_from_file_location(
    "reference_rasterise", Path(__file__).with_name("reference_rasterise.py")
)
reference = importlib.util.module_from_spec(_spec)
_spec.loader.exec_module(reference)


@settings(max_examples=25, deadline=None)
@given(seed=st.integers(0, 10_000), perspective=st.booleans())
def test_equals_the_obvious_loops(seed, perspective):
    rng = np.random.default_rng(seed)
    pixels = rng.uniform(-4, 20, (18, 2))
    depth = rng.uniform(50, 90, 18)
    faces = rng.permutation(18).reshape(6, 3)
    got = rasterise(pixels, depth, faces, (14, 17), perspective=perspective)
    face_index, barycentric, nearest = reference.rasterise_naively(pixels, depth, faces, (14, 17), perspective)
    np.testing.assert_array_equal(got.face_index >= 0, face_index >= 0)
    np.testing.assert_allclose(got.depth, nearest, rtol=1e-5)
    # where two triangles cross, rounding may choose either: such pixels are few
    same = got.face_index == face_index
    assert same.mean() > 0.99
    np.testing.assert_allclose(got.barycentric[same], barycentric[same], atol=1e-5)


@settings(max_examples=25, deadline=None)
@given(seed=st.integers(0, 10_000), perspective=st.booleans())
def test_slivers_equal_the_obvious_loops(seed, perspective):
    """Edges along pixel rows and columns, corners on pixel centres, slivers, and corners far outside."""
    rng = np.random.default_rng(seed)
    pixels = rng.integers(-2, 16, (24, 2)).astype(float)
    pixels[::4] += rng.choice([0.0, 1e-7, 1e-5, 0.3], (6, 2))  # thinner ones defeat the twin
    pixels[1::12] += rng.choice([0.0, 1e4, -1e6], (2, 2))
    depth = rng.uniform(50, 90, 24)
    faces = np.arange(24).reshape(8, 3)
    got = rasterise(pixels, depth, faces, (12, 14), perspective=perspective)
    face_index, _, nearest = reference.rasterise_naively(pixels, depth, faces, (12, 14), perspective)
    # a pixel centre on an edge may fall to either side of rounding: such pixels are few
    same = got.face_index == face_index
    assert same.mean() > 0.95
    np.testing.assert_allclose(got.depth[same], nearest[same], rtol=1e-4)


def test_corners_beyond_all_numbers_of_pixels_do_no_harm():
    pixels = np.array([[2.0, 2], [2, 9], [9, 2], [1e150, 5], [-1e150, 5], [5, 1e150], [3e18, 3e18]])
    faces = np.array([[0, 1, 2], [0, 1, 3], [3, 4, 5], [0, 4, 6], [5, 5, 6]])
    covered = rasterise(pixels, np.full(7, 5.0), faces, (12, 12)).covered
    assert covered[3, 3] and not covered[11, 11]


def test_interpolation_is_perspective_correct():
    """A slanted plane seen through a pinhole: interpolated positions project back onto their own pixels."""
    camera = np.array([[-40.0, -40, 100], [60, -40, 300], [60, 40, 300], [-40, 40, 100]])
    focal, centre = 60.0, np.array([31.5, 23.5])
    pixels = camera[:, :2] / camera[:, 2:] * focal + centre
    faces = np.array([[0, 2, 1], [0, 3, 2]])
    fragments = rasterise(pixels, camera[:, 2], faces, (48, 64))
    seen = fragments.interpolate(faces, camera)[fragments.covered]
    y, x = np.nonzero(fragments.covered)
    assert len(x) > 500
    np.testing.assert_allclose(seen[:, :2] / seen[:, 2:] * focal + centre, np.stack([x, y], 1), atol=2e-3)
    np.testing.assert_allclose(seen[:, 2], fragments.depth[fragments.covered], rtol=1e-5)


def test_weights_sum_to_one_and_empty_pixels_are_zero():
    fragments = rasterise(np.array([[2.0, 2], [2, 9], [9, 2]]), np.full(3, 5.0), np.array([[0, 1, 2]]), (12, 12))
    np.testing.assert_allclose(fragments.barycentric[fragments.covered].sum(1), 1, atol=1e-6)
    assert not fragments.barycentric[~fragments.covered].any()
    assert np.isinf(fragments.depth[~fragments.covered]).all()


def test_shared_edges_leave_no_hole():
    """A fan of triangles round a point covers every pixel within its hexagon."""
    angle = np.arange(6) * np.pi / 3
    pixels = np.vstack([[20.0, 20.0], 20 + 15 * np.stack([np.cos(angle), np.sin(angle)], 1)])
    faces = np.array([[0, 1 + k, 1 + (k + 1) % 6] for k in range(6)])
    covered = rasterise(pixels, np.ones(7), faces, (41, 41)).covered
    yy, xx = np.mgrid[:41, :41]
    assert covered[np.hypot(xx - 20, yy - 20) < 12.9].all()


def test_back_faces_are_culled_on_request():
    pixels, depth = np.array([[1.0, 1], [1, 8], [8, 1]]), np.ones(3)
    outside, inside = np.array([[0, 1, 2]]), np.array([[0, 2, 1]])
    assert rasterise(pixels, depth, outside, (9, 9), cull_back_faces=True).covered.any()
    assert not rasterise(pixels, depth, inside, (9, 9), cull_back_faces=True).covered.any()


def test_triangles_behind_the_camera_are_skipped():
    pixels = np.array([[1.0, 1], [1, 8], [8, 1]])
    assert not rasterise(pixels, np.array([5.0, -1, 5]), np.array([[0, 1, 2]]), (9, 9)).covered.any()


@pytest.mark.parametrize(
    ("change", "error"),
    [
        ({"pixels": np.zeros((3, 3))}, ShapeError),
        ({"depth": np.ones(4)}, ShapeError),
        ({"faces": np.array([[0, 1, 3]])}, ValueRangeError),
        ({"pixels": np.array([[0, 0], [np.nan, 1], [2, 2.0]])}, ValueRangeError),
        ({"depth": np.array([1, np.inf, 1])}, ValueRangeError),
    ],
)
def test_refuses(change, error):
    good = {"pixels": np.array([[0.0, 0], [5, 0], [0, 5]]), "depth": np.ones(3), "faces": np.array([[0, 1, 2]])}
    with pytest.raises(error):
        rasterise(**(good | change), size=(8, 8))
