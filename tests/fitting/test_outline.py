"""The outline of a face, found in made-up pictures of it."""

import numpy as np
import pytest

from facewright.errors import ShapeError
from facewright.fitting.outline import find_outline
from facewright.landmarks.contour import build_contour_strips
from facewright.numeric.check import check_shape

SIZE, IOD = 400, 90.0
TURN = np.deg2rad(25.0)
ROTATION = np.diag([1.0, -1.0, -1.0]) @ np.array(
    [[np.cos(TURN), 0, np.sin(TURN)], [0, 1, 0], [-np.sin(TURN), 0, np.cos(TURN)]]
)


def seen(face):
    """Return the generic face, turned by 25 degrees, in the picture."""
    check_shape("mean", face.mean_shape, "V", 3)
    return (face.mean_shape @ ROTATION.T)[:, :2] * 1.45 + SIZE / 2


def picture(pixels, faces, skin, wall, wider=0.0):
    """Return a flat picture of the mesh, its far side `wider` pixels farther out."""
    from facewright.imaging.rasterise import rasterise

    middle = pixels.mean(axis=0)
    moved = pixels + wider * np.sign(pixels - middle) * (1.0, 0.0)
    shown = rasterise(moved, np.ones(len(pixels)), faces, (SIZE, SIZE)).covered
    return np.where(shown[..., None], np.array(skin, np.uint8), np.array(wall, np.uint8))


def find(face, image, pixels):
    return find_outline(image, face.topology, face.mean_shape, pixels, ROTATION, IOD)


@pytest.fixture
def skin_face(builtin_face):
    return builtin_face.skin()


@pytest.mark.parametrize("wider", [0.0, 6.0])
def test_the_far_cheek_is_found_to_a_pixel(skin_face, wider):
    pixels = seen(skin_face)
    found = find(skin_face, picture(pixels, skin_face.topology.faces, (190, 140, 110), (60, 90, 160), wider), pixels)
    sure = found.confidence > 0.5
    assert sure.sum() >= 6
    before = (1 - found.fraction[:, None]) * pixels[found.first] + found.fraction[:, None] * pixels[found.second]
    moved = np.abs((found.pixels - before)[sure, 0])
    assert np.median(np.abs(moved - wider)) < 1.5
    side = np.sign(np.median(before[sure, 0]) - pixels[:, 0].mean())
    assert (np.sign(before[sure, 0] - pixels[:, 0].mean()) == side).all(), "only the far side bends out of sight"


def test_nothing_is_found_where_both_sides_look_alike(skin_face):
    pixels = seen(skin_face)
    same = picture(pixels, skin_face.topology.faces, (190, 140, 110), (188, 139, 109))
    assert find(skin_face, same, pixels).confidence.max() < 0.05


def test_shade_on_the_skin_is_no_outline(skin_face):
    pixels = seen(skin_face)
    image = picture(pixels, skin_face.topology.faces, (190, 140, 110), (190, 140, 110)).astype(float)
    image *= np.linspace(0.6, 1.0, SIZE)[None, :, None]
    assert find(skin_face, image.astype(np.uint8), pixels).confidence.max() < 0.05


def test_noise_and_pictures_that_cut_the_face_are_safe(skin_face, rng):
    pixels = seen(skin_face)
    noise = rng.integers(0, 256, (SIZE, SIZE, 3), dtype=np.uint8)
    assert (find(skin_face, noise, pixels).confidence > 0.5).mean() < 0.1
    cut = find(skin_face, noise[:40, :40], pixels)
    assert cut.confidence.max() == 0
    assert np.isfinite(cut.pixels).all()


def test_an_ear_behind_the_cheek_is_left_alone(skin_face):
    pixels = seen(skin_face)
    strips = build_contour_strips(skin_face.topology, skin_face.mean_shape)
    found = find(skin_face, picture(pixels, skin_face.topology.faces, (190, 140, 110), (60, 90, 160)), pixels)
    near_side = np.isin(found.first, strips.vertices[:, -1])
    assert near_side.any()
    assert found.confidence[near_side].max() == 0


def test_pictures_must_have_three_channels(skin_face):
    with pytest.raises(ShapeError):
        find(skin_face, np.zeros((SIZE, SIZE), np.uint8), seen(skin_face))
