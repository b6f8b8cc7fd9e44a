import numpy as np
import pytest
from scipy.ndimage import gaussian_filter

from facewright.errors import DegenerateError, ShapeError, ValueRangeError
from facewright.imaging.inpaint import inpaint


@pytest.fixture()
def holes():
    y, x = np.mgrid[:100, :120]
    return (np.hypot(x - 40, y - 50) < 14) | (np.abs(x - 90) < 3) | (np.hypot(x - 120, y) < 9)


def surface(rng, grain=6.0):
    """Smooth light and grain, (100, 120, 3)."""
    y, x = np.mgrid[:100, :120]
    light = 120 + 40 * np.sin(x / 50) + 25 * np.cos(y / 40)
    return light[..., None] * [1.0, 0.85, 0.75] + grain * gaussian_filter(rng.normal(size=(100, 120, 1)), (0.6, 0.6, 0))


def test_outside_the_hole_nothing_changes(rng, holes):
    photo = rng.integers(0, 256, (100, 120, 3), dtype=np.uint8)
    got = inpaint(photo, holes)
    assert got.dtype == np.uint8
    np.testing.assert_array_equal(got[~holes], photo[~holes])


def test_what_the_hole_held_is_not_read(rng, holes):
    photo = surface(rng)
    torn = photo.copy()
    torn[holes] = np.nan
    np.testing.assert_array_equal(inpaint(torn, holes), inpaint(photo, holes))


def test_smooth_light_goes_on_through_the_hole(rng, holes):
    photo = surface(rng, grain=0)
    got = inpaint(photo, holes)
    assert np.abs(got - photo)[holes].mean() < 1.5
    assert np.abs(got - photo)[holes].max() < 8


def test_the_filling_has_the_grain_of_its_surroundings(rng, holes):
    """Fine texture inside is about as strong as outside; smooth on request."""
    photo = surface(rng).astype(np.uint8)

    def strength(picture, where):
        fine = picture[..., 1] - gaussian_filter(picture[..., 1].astype(float), 1.5)
        return fine[where].std()

    disc = np.zeros_like(holes)
    disc[40:60, 30:50] = True
    outside = np.zeros_like(holes)
    outside[5:95, 60:80] = True
    assert 0.6 < strength(inpaint(photo, holes), disc) / strength(photo, outside) < 1.3
    assert strength(inpaint(photo, holes, grain=0.0), disc) < 0.25 * strength(photo, outside)


def test_no_step_at_the_border(rng):
    """Steps across the hole's outline are no larger than steps elsewhere."""
    photo = surface(rng)
    y, x = np.mgrid[:100, :120]
    hole = np.hypot(x - 60, y - 50) < 20
    got = inpaint(photo, hole)
    step = np.abs(np.diff(got[..., 0], axis=1))
    across = hole[:, 1:] != hole[:, :-1]
    assert step[across].mean() < 1.5 * step[~across].mean()


def test_an_outline_beside_the_hole_is_not_mirrored_into_it():
    """A black line past the hole leaves no second line inside."""
    photo = np.full((80, 80, 3), 180, np.uint8)
    photo[:, 52:54] = 0
    hole = np.zeros((80, 80), bool)
    hole[30:50, 30:48] = True
    assert inpaint(photo, hole)[35:45, 32:46].min() > 140


def test_a_hole_at_the_pictures_corner(rng):
    photo = surface(rng)
    hole = np.zeros((100, 120), bool)
    hole[:30, :40] = True
    got = inpaint(photo, hole)
    assert np.isfinite(got).all()
    assert np.abs(got - photo)[hole].mean() < 20


def test_an_empty_hole_changes_nothing(rng):
    photo = rng.integers(0, 256, (9, 9, 3), dtype=np.uint8)
    np.testing.assert_array_equal(inpaint(photo, np.zeros((9, 9), bool)), photo)


@pytest.mark.parametrize(
    ("change", "error"),
    [
        ({"image": np.zeros((9, 9), np.uint8)}, ShapeError),
        ({"hole": np.zeros((9, 8), bool)}, ShapeError),
        ({"image": np.zeros((9, 9, 3), int)}, ValueRangeError),
        ({"image": np.full((9, 9, 3), np.nan)}, ValueRangeError),
        ({"grain": 1.5}, ValueRangeError),
        ({"hole": np.ones((9, 9), bool)}, DegenerateError),
    ],
)
def test_refuses(change, error):
    with pytest.raises(error):
        inpaint(**({"image": np.zeros((9, 9, 3), np.uint8), "hole": np.eye(9, dtype=bool)} | change))
