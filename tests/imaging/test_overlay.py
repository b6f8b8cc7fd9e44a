import numpy as np
import pytest

from facewright.errors import ShapeError, ValueRangeError
from facewright.imaging.overlay import crop_around, draw_mesh_lines, draw_points, draw_shaded


def test_crop_maps_points_where_it_says():
    image = np.zeros((60, 80, 3), np.uint8)
    image[30, 50] = 255
    crop, origin, zoom = crop_around(image, np.array([[40.0, 20], [60, 40], [np.nan, 1]]), margin=0.25, height=120)
    assert crop.shape == (120, 120, 3)
    expected = (np.array([50.0, 30]) + 0.5 - origin) * zoom - 0.5
    yy, xx = np.mgrid[:120, :120]
    bright = crop[..., 0].astype(float)
    centroid = [(bright * xx).sum() / bright.sum(), (bright * yy).sum() / bright.sum()]
    np.testing.assert_allclose(centroid, expected, atol=0.1)


def test_crop_beyond_the_edge_repeats_it():
    image = np.full((20, 20, 3), 90, np.uint8)
    crop, _, _ = crop_around(image, np.array([[-5.0, -5], [25, 25]]), height=64)
    assert (crop == 90).all()


def test_crop_far_outside_is_refused():
    for far in (1e6, np.nan):
        with pytest.raises(ValueRangeError, match="within 80 pixels"):
            crop_around(np.zeros((20, 20, 3), np.uint8), np.array([[far, far]]))


def test_points_are_centred_and_nan_is_left_out():
    drawn = draw_points(np.zeros((40, 40, 3), np.uint8), np.array([[12.0, 25.0], [np.nan, 3]]), (200, 0, 0), 3)
    yy, xx = np.mgrid[:40, :40]
    weight = drawn[..., 0] / 200
    assert weight.sum() == pytest.approx(np.pi * 9, rel=0.15)
    np.testing.assert_allclose(
        [(weight * xx).sum() / weight.sum(), (weight * yy).sum() / weight.sum()], [12, 25], atol=0.2
    )
    with pytest.raises(ShapeError):
        draw_points(np.zeros((4, 4, 3), np.uint8), np.zeros(2))


def test_lines_of_hidden_triangles_are_not_drawn():
    near, far = np.array([[5.0, 5], [5, 35], [35, 5]]), np.array([[8.0, 8], [8, 20], [20, 8]])
    pixels, depth = np.concatenate([near, far]), np.array([10.0] * 3 + [50.0] * 3)
    faces = np.array([[0, 1, 2], [3, 4, 5]])
    drawn = draw_mesh_lines(np.zeros((40, 40, 3), np.uint8), pixels, depth, faces, perspective=False)
    assert drawn[5, 15].any() and not drawn[8, 14].any()
    alone = draw_mesh_lines(np.zeros((40, 40, 3), np.uint8), far, depth[3:], faces[:1], perspective=False)
    assert alone[8, 14].any()


def test_shading_fades_where_the_surface_is_see_through():
    pixels = np.array([[-20.0, -20], [-20, 100], [100, -20]])
    camera = np.column_stack([pixels - 20, np.full(3, 300.0)])
    faces, photo = np.array([[0, 1, 2]]), np.full((40, 40, 3), (200, 30, 30), np.uint8)
    solid = draw_shaded(photo, camera, pixels, faces, np.ones(3), perspective=False)
    half = draw_shaded(photo, camera, pixels, faces, np.full(3, 0.5), perspective=False)
    none = draw_shaded(photo, camera, pixels, faces, np.zeros(3), perspective=False)
    np.testing.assert_array_equal(none, photo)
    assert np.abs(solid.astype(float) - photo)[:30, :30].mean() > 20
    np.testing.assert_allclose(half, (solid.astype(float) + photo) / 2, atol=1)
    with pytest.raises(ShapeError, match="opacity must have shape"):
        draw_shaded(photo, camera, pixels, faces, np.ones(2))


def test_wider_lines_cover_more():
    pixels = np.array([[5.0, 5], [5, 35], [35, 5]])
    black, faces = np.zeros((40, 40, 3), np.uint8), np.array([[0, 1, 2]])
    thin, wide = (
        draw_mesh_lines(black, pixels, np.full(3, 9.0), faces, width=w, perspective=False).sum(dtype=float)
        for w in (0.5, 1.5)
    )
    assert 2.5 < wide / thin < 4
