"""The layers that mouth and eyes are drawn from, and the loops over triangles beside their plain twins."""

import numpy as np
import pytest

from facewright.imaging.eye_layer import eye_layer, find_iris
from facewright.imaging.inner_parts import EYE, LOWER_TOOTH, SKIN, UPPER_TOOTH, openings
from facewright.imaging.lid_skin import front_areas, spread_over, unit_normals
from facewright.imaging.mouth_layer import OPAQUE, mouth_layers, teeth_in_slit, trim_lips
from facewright.imaging.skin_layer import skin_layer
from facewright.mesh.normals import face_area_vectors, vertex_normals

LIP, TOOTH, DARK = np.array([170, 80, 75]), np.array([230, 222, 205]), np.array([30, 12, 10])


def mouth(rows=40, columns=60):
    """A picture of lips, and between rows 10 and 30 upper teeth down to row 20, then the dark."""
    picture = np.broadcast_to(LIP, (rows, columns, 3)).astype(np.uint8).copy()
    inside = np.zeros((rows, columns), bool)
    inside[10:30, 8:52] = True
    picture[10:20, 8:52], picture[20:30, 8:52] = TOOTH, DARK
    return picture, inside


def layers_of(picture, inside):
    return mouth_layers(picture, (0, 0), inside, LIP.astype(float), np.full(60, 22.0), 1.5, np.array([150.0, 80, 80]))


def test_teeth_and_the_dark_below_them_are_parted():
    layers = layers_of(*mouth())
    assert layers.skull[12:19, 15:45, OPAQUE].min() > 0.95
    assert layers.skull[24:, :, OPAQUE].max() == 0
    assert layers.jaw[23:29, 15:45, OPAQUE].min() > 0.95
    np.testing.assert_allclose(layers.tooth, TOOTH, atol=2)
    np.testing.assert_allclose(layers.skull[15, 30, :3], TOOTH, atol=2)
    np.testing.assert_allclose(layers.jaw[26, 30, :3], DARK, atol=2)


def test_teeth_go_on_behind_the_lips():
    layers = layers_of(*mouth())
    assert layers.skull[6:10, 15:45, OPAQUE].min() > 0.9
    assert (layers.skull[6:10, 15:45, 0] > 1.1 * LIP[0]).mean() > 0.5


def test_teeth_that_reach_the_lower_lip_end_at_their_edge():
    picture, inside = mouth()
    picture[10:30, 8:52] = TOOTH
    layers = mouth_layers(picture, (0, 0), inside, LIP.astype(float), np.full(60, 33.0), 1.5, LIP)
    assert layers.skull[30:33, 15:45, OPAQUE].min() > 0.5
    assert layers.jaw[..., OPAQUE].max() == 0


@pytest.mark.parametrize("filled", [DARK, LIP, np.array([150, 70, 70])])
def test_without_teeth_nothing_is_carried_over(filled):
    picture, inside = mouth()
    picture[inside] = filled
    layers = layers_of(picture, inside)
    assert layers.tooth is None
    assert layers.skull[..., OPAQUE].max() == 0


def test_lips_are_taken_out_of_a_mouth_that_is_fitted_too_wide():
    picture, inside = mouth()
    wide = inside.copy()
    wide[30:33, 8:52] = True
    trimmed = trim_lips(picture, wide, LIP.astype(float), 5)
    assert not trimmed[31:, 12:48].any()
    assert trimmed[12:29, 12:48].all()


def test_a_tongue_is_not_taken_for_lips():
    picture, inside = mouth()
    picture[inside] = LIP
    np.testing.assert_array_equal(trim_lips(picture, inside, LIP.astype(float), 5)[12:28, 10:50], True)


def test_skin_shows_no_teeth_that_a_wrong_fit_left_outside():
    picture, inside = mouth()
    inside[27:30] = False  # of the fit; the photo's mouth is larger
    inside[10:12] = False
    skin = skin_layer(picture, inside, inset_px=1.0, doubt_px=5.0)
    assert np.abs(skin - LIP).max() < 25


def test_skin_away_from_an_opening_keeps_its_bits(rng):
    picture = rng.integers(0, 255, (40, 60, 3)).astype(np.uint8)
    inside = np.zeros((40, 60), bool)
    inside[18:22, 25:35] = True
    skin = skin_layer(picture, inside, inset_px=1.0, doubt_px=3.0)
    np.testing.assert_array_equal(skin[:10], picture[:10])


def eye(centre=(30.3, 19.6), radius=8.4, lid=15, size=(40, 60)):
    """A round iris under a lid whose edge is row `lid`."""
    y, x = np.mgrid[: size[0], : size[1]]
    away = np.hypot(x - centre[0], y - centre[1])
    share = np.clip(radius - away + 0.5, 0, 1)[..., None]
    picture = 205 + (np.array([70.0, 90, 60]) - 205) * share
    picture = np.where((away < 0.35 * radius)[..., None], 15, picture)
    seen = (y >= lid) & (y < 32) & (np.abs(x - 30) < 25)
    return np.where(seen[..., None], picture, [190, 140, 120]).astype(np.uint8), seen


def test_the_iris_is_found_to_a_fraction_of_a_pixel():
    picture, seen = eye()
    found = find_iris(picture.mean(axis=2), seen, np.array([28.0, 21.0, 7.5]))
    np.testing.assert_allclose(found, [30.3, 19.6, 8.4], atol=0.6)


def test_the_hidden_part_of_the_iris_is_round_and_of_its_colour():
    picture, seen = eye(lid=19)
    layer = eye_layer(picture, (5, 7), seen, np.ones(seen.shape), np.array([29.5, 20.5, 8.0]), 1.4, np.ones(3))
    whole, _ = eye(lid=0)
    np.testing.assert_allclose(layer.iris, [35.3, 26.6, 8.4], atol=0.8)
    assert layer.seen
    for at in ((13, 30), (14, 27), (14, 34)):
        np.testing.assert_allclose(layer.picture[at], whole[at], atol=25)
    np.testing.assert_allclose(layer.picture[4, 30], [205, 205, 205], atol=12)


def test_a_shut_eye_gets_an_iris():
    picture = np.full((40, 60, 3), 150, np.uint8)
    iris, shut = np.array([30.0, 20, 8.0]), np.zeros((40, 60), bool)
    layer = eye_layer(picture, (0, 0), shut, np.ones((40, 60)), iris, 1.4, np.full(3, 0.9))
    assert not layer.seen
    pupil, iris_colour, white = (layer.picture[20, x].mean() for x in (30, 36, 44))
    assert pupil < 0.7 * iris_colour < 80 < 160 < white


def test_openings_hold_what_they_should(builtin_face):
    mouth_, right, left = openings(builtin_face)
    assert {UPPER_TOOTH, LOWER_TOOTH, SKIN} <= set(mouth_.kinds)
    assert set(right.kinds) == {SKIN, EYE} == set(left.kinds)
    mean = builtin_face.mean_shape
    assert mean[left.vertices[left.rim], 0].min() > 0 > mean[right.vertices[right.rim], 0].max()
    assert len(mouth_.upper) == len(mouth_.lower) > 10
    gap = np.linalg.norm(mean[mouth_.vertices[mouth_.upper]] - mean[mouth_.vertices[mouth_.lower]], axis=1)
    assert gap.max() < 3.0


def mesh(rng, n=60, m=90):
    faces = np.array([rng.choice(n, 3, replace=False) for _ in range(m)], dtype=np.int32)
    return rng.normal(size=(n, 3)), faces


def test_normals_are_those_of_the_mesh_layer(rng):
    vertices, faces = mesh(rng)
    np.testing.assert_allclose(unit_normals(vertices, faces), vertex_normals(vertices, faces), atol=1e-9)


def test_front_areas_count_what_faces_the_camera(rng):
    vertices, faces = mesh(rng)
    flat = vertices * [1.0, 1.0, 0.0]
    towards = -face_area_vectors(flat, faces)[:, 2] / 2  # clockwise on a screen whose y points down
    expected = np.bincount(faces.ravel(), np.repeat(np.maximum(towards, 0) / 3, 3), minlength=len(vertices))
    np.testing.assert_allclose(front_areas(vertices[:, :2].copy(), faces), expected, atol=1e-9)


def test_values_spread_edge_by_edge():
    faces = np.array([[0, 1, 2], [2, 3, 4], [4, 5, 6]], dtype=np.int32)
    values = np.array([1.0, 0, 0, 0, 0, 0, 0])
    np.testing.assert_array_equal(spread_over(values, faces, 1), [1, 1, 1, 0, 0, 0, 0])
    np.testing.assert_array_equal(spread_over(values, faces, 2), [1, 1, 1, 1, 1, 0, 0])


def test_teeth_between_lips_all_but_shut_are_found():
    picture = np.broadcast_to(LIP, (40, 60, 3)).astype(np.uint8).copy()
    line, lips = np.zeros((40, 60), bool), np.zeros((40, 60), bool)
    line[20, 8:52], lips[10:31, 8:52] = True, True
    assert not teeth_in_slit(picture, line, lips, 2.0).any()
    picture[21:24, 25:32] = TOOTH
    found = teeth_in_slit(picture, line, lips, 2.0)
    assert found[21:24, 25:32].all()
    assert found.sum() < 80
    picture[27:30, 25:32] = TOOTH  # too far from the line: light on the lip
    assert not teeth_in_slit(picture, line, lips, 2.0)[27:].any()
