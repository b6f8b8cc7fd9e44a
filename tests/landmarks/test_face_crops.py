import numpy as np
import pytest

from facewright.errors import ShapeError
from facewright.landmarks.face_crops import FaceCrops, cut_face

GREY = np.array([0.3, 0.6, 0.1])


def naive(image, corner, step, side):
    """Return the square by its definition: means under a tent, one pixel after the other."""
    reach = max(step, 1.0)
    rows, columns = np.arange(image.shape[0]), np.arange(image.shape[1])
    grey = image @ GREY
    out = np.zeros((side, side))
    for j in range(side):
        tall = np.clip(1 - np.abs(rows - (corner[1] + j * step)) / reach, 0, None)
        for i in range(side):
            wide = np.clip(1 - np.abs(columns - (corner[0] + i * step)) / reach, 0, None)
            share = tall[:, None] * wide
            out[j, i] = (share * grey).sum() / share.sum() if share.sum() > 0 else 0.0
    return out


@pytest.mark.parametrize("width", [9.0, 40.0, 90.0])
def test_square_is_the_mean_under_a_tent(rng, width):
    image = rng.integers(0, 256, (70, 90, 3), dtype=np.uint8)
    points = np.array([[30.0, 20.0], [30.0 + width, 50.0], [44.4, 31.0]])
    crop = cut_face(image, points, 24)
    assert crop.pixels.shape == (24, 24) and crop.pixels.dtype == np.uint8
    assert np.abs(crop.pixels - naive(image, crop.corner, crop.step, 24)).max() <= 0.51
    middle = crop.corner + crop.step * 23 / 2
    np.testing.assert_allclose(middle, (points.min(axis=0) + points.max(axis=0)) / 2, atol=1e-4)
    assert crop.step * 23 >= max(width, 30.0)


def test_points_keep_their_place(rng):
    """A ramp's brightness at a point of the frame is found at the point's place in the square."""
    ramp = np.repeat(np.linspace(0, 239, 240)[None, :, None], 200, axis=0).repeat(3, axis=2).astype(np.uint8)
    crop = cut_face(ramp, np.array([[60.0, 30.0], [180.0, 170.0]]), 60)
    columns = crop.corner[0] + crop.step * np.arange(60)
    np.testing.assert_allclose(crop.pixels[30], columns, atol=0.7)


def test_what_is_outside_the_frame_is_black():
    crop = cut_face(np.full((40, 40, 3), 200, np.uint8), np.array([[-30.0, -30.0], [10.0, 10.0]]), 20)
    assert crop.pixels[0, 0] == 0 and crop.pixels[-1, -1] == 200


def test_frames_come_back_from_any_number_of_pieces(rng):
    image = rng.integers(0, 256, (50, 50, 3), dtype=np.uint8)
    found = [cut_face(image, rng.uniform(5, 45, (4, 2)), 8) if k != 3 else None for k in range(7)]
    whole = FaceCrops.of(found, 8)
    split = FaceCrops((whole.pieces[0][:2], whole.pieces[0][2:6], whole.pieces[0][6:]), whole.corners, whole.steps)
    for crops in (whole, split):
        assert crops.n_frames == 7 and crops.at(3) is None
        for k in (0, 1, 2, 4, 5, 6):
            np.testing.assert_array_equal(crops.at(k).pixels, found[k].pixels)
            np.testing.assert_array_equal(crops.at(k).corner, found[k].corner)
            assert crops.at(k).step == found[k].step


def test_refuses_other_pictures_and_uneven_numbers():
    with pytest.raises(ShapeError, match="uint8"):
        cut_face(np.zeros((5, 5, 3)), np.zeros((2, 2)))
    with pytest.raises(ShapeError, match="points"):
        cut_face(np.zeros((5, 5, 3), np.uint8), np.zeros((2, 3)))
    with pytest.raises(ShapeError, match="as many"):
        FaceCrops((np.zeros((2, 4, 4), np.uint8),), np.zeros((3, 2), np.float32), np.zeros(3, np.float32))
