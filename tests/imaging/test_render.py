import numpy as np
import pytest

from facewright.errors import ShapeError
from facewright.imaging.colour import linear_from_srgb, srgb_from_linear
from facewright.imaging.contact_sheet import contact_sheet
from facewright.imaging.portrait import portrait_view, render_portrait
from facewright.imaging.rasterise import rasterise
from facewright.imaging.render import Lights, render_mesh, shade_fragments
from facewright.mesh.normals import vertex_normals


def sphere(radius=60.0, n=24):
    """Latitude-longitude sphere, counter-clockwise seen from outside."""
    theta, phi = np.meshgrid(np.linspace(0, np.pi, n), np.linspace(0, 2 * np.pi, 2 * n), indexing="ij")
    points = np.stack([np.sin(theta) * np.cos(phi), np.cos(theta), -np.sin(theta) * np.sin(phi)], -1).reshape(-1, 3)
    ids = np.arange(points.shape[0]).reshape(n, 2 * n)
    a, b, c, d = ids[:-1, :-1].ravel(), ids[1:, :-1].ravel(), ids[1:, 1:].ravel(), ids[:-1, 1:].ravel()
    return points * radius, np.concatenate([np.stack([a, b, c], 1), np.stack([a, c, d], 1)])


def test_colour_round_trip():
    values = np.linspace(0, 1, 256)
    np.testing.assert_allclose(srgb_from_linear(linear_from_srgb(values)), values, atol=1e-6)


def test_background_is_untouched_outside_the_mesh(rng):
    vertices, faces = sphere()
    background = rng.integers(0, 256, (96, 80, 3), dtype=np.uint8)
    drawn = render_portrait(vertices, faces, (96, 80), background=background, centre_mm=(0, 0, 0))
    outside = drawn.coverage == 0
    assert 0.2 < outside.mean() < 0.9
    np.testing.assert_array_equal(drawn.image[outside], background[outside])


def test_coverage_is_the_area_of_the_disc():
    vertices, faces = sphere(radius=60.0, n=48)
    drawn = render_portrait(vertices, faces, (200, 200), centre_mm=(0, 0, 0), distance_mm=5000.0, height_mm=200.0)
    assert drawn.coverage.sum() == pytest.approx(np.pi * 60**2, rel=0.01)


def test_brighter_towards_the_light():
    vertices, faces = sphere()
    lights = Lights(np.array([[-1.0, 0, -0.2]]), np.ones((1, 3)), sky=(0.05,) * 3, ground=(0.05,) * 3)
    image = render_portrait(vertices, faces, (100, 100), lights=lights, centre_mm=(0, 0, 0), shininess=0.0).image
    assert image[50, 38].mean() > image[50, 62].mean() + 60


def test_albedo_function_sees_the_fragments():
    vertices, faces = sphere()
    red = render_portrait(
        vertices, faces, (60, 60), centre_mm=(0, 0, 0), albedo=lambda f: np.ones((*f.depth.shape, 3)) * [1.0, 0, 0]
    ).image
    assert red[30, 30, 0] > 100 and red[30, 30, 1] < 60


def test_turning_left_moves_the_nose_to_the_right_of_the_picture():
    nose = np.array([[0.0, -10.0, 130.0]])
    _, right = portrait_view(nose, (100, 100), yaw_degrees=20)
    _, up = portrait_view(nose, (100, 100), pitch_degrees=20)
    assert right[0, 0] > 55 and up[0, 1] < 45


def test_supersampling_keeps_pixel_centres():
    """The same picture, drawn finer, does not shift: the centroid of coverage stays."""
    vertices, faces = sphere()
    yy, xx = np.mgrid[:90, :90]
    centroids = []
    for s in (1, 2, 3):
        c = render_portrait(vertices + [5, 3, 0], faces, (90, 90), supersample=s, centre_mm=(0, 0, 0)).coverage
        centroids.append([(c * xx).sum() / c.sum(), (c * yy).sum() / c.sum()])
    np.testing.assert_allclose(centroids[1:], np.repeat(centroids[2:], 2, 0), atol=0.06)
    np.testing.assert_allclose(centroids[0], centroids[2], atol=0.15)


def test_render_refuses_mismatched_arrays():
    vertices, faces = sphere()
    with pytest.raises(ShapeError, match="pixels must have shape"):
        render_mesh(vertices, np.zeros((3, 2)), faces, (10, 10))
    with pytest.raises(ShapeError, match="albedo must have shape"):
        render_portrait(vertices, faces, (40, 40), albedo=np.ones((2, 3)), centre_mm=(0, 0, 0))


def test_contact_sheet_places_pictures():
    images = [np.full((10, 8, 3), k * 50, np.uint8) for k in range(5)]
    sheet = contact_sheet(images, list("abcde"), columns=2, gap=4, caption_height=12)
    assert sheet.shape == (3 * 26 + 4, 2 * 12 + 4, 3)
    assert (sheet[4 + 26 : 14 + 26, 4:12] == 100).all()
    with pytest.raises(ShapeError):
        contact_sheet([images[0], np.zeros((3, 3, 3), np.uint8)])
    with pytest.raises(ShapeError):
        contact_sheet(images, ["one"])


def test_known_normals_give_the_same_shading_and_are_used():
    vertices, faces = sphere()
    seen = vertices * [1.0, -1.0, -1.0] + [0.0, 0.0, 500.0]
    fragments = rasterise(seen[:, :2] + 70.0, seen[:, 2], faces, (140, 140), perspective=False)
    lights = Lights(directions=np.array([[1.0, 0.0, 0.0]]), colours=np.ones((1, 3)))
    plain = shade_fragments(fragments, seen, faces, lights=lights)
    assert plain.shape == (int(fragments.covered.sum()), 3)
    normals = vertex_normals(seen, faces)
    np.testing.assert_allclose(
        shade_fragments(fragments, seen, faces, lights=lights, normals=normals), plain, atol=1e-6
    )
    away = np.broadcast_to([-1.0, 0.0, 0.0], normals.shape)
    assert shade_fragments(fragments, seen, faces, lights=lights, normals=away).max() < plain.max() - 0.1
