import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from facewright.errors import DegenerateError, ShapeError
from facewright.imaging.poisson import solve_poisson


def solve_naively(values, unknown, source, free):
    """The equations one by one, and a dense solver."""
    height, width, channels = values.shape
    places = list(zip(*np.nonzero(unknown)))
    row = {place: i for i, place in enumerate(places)}
    matrix, right = np.zeros((len(places), len(places))), np.zeros((len(places), channels))
    for (y, x), i in row.items():
        right[i] = source[y, x]
        for place in ((y - 1, x), (y + 1, x), (y, x - 1), (y, x + 1)):
            if not (0 <= place[0] < height and 0 <= place[1] < width) or (free[place] and not unknown[place]):
                continue
            matrix[i, i] += 1
            if place in row:
                matrix[i, row[place]] -= 1
            else:
                right[i] += values[place]
    out = values.astype(float)
    out[unknown] = np.linalg.lstsq(matrix, right, rcond=None)[0]
    return out


def blobs(rng, shape, share):
    """Irregular mask: noise smoothed and cut."""
    noise = rng.normal(size=shape)
    for axis in (0, 1):
        for _ in range(3):
            noise = noise + np.roll(noise, 1, axis) + np.roll(noise, -1, axis)
    return noise > np.quantile(noise, 1 - share)


@settings(max_examples=25, deadline=None)
@given(
    seed=st.integers(0, 10_000),
    height=st.integers(2, 24),
    width=st.integers(2, 24),
    share=st.floats(0.05, 0.95),
    with_free=st.booleans(),
)
def test_equals_the_equations_solved_one_by_one(seed, height, width, share, with_free):
    rng = np.random.default_rng(seed)
    unknown = blobs(rng, (height, width), share)
    unknown[rng.integers(height), rng.integers(width)] = False
    if not unknown.any():
        return
    values = rng.normal(size=(height, width, 2))
    source = 0.1 * rng.normal(size=values.shape)
    free = np.zeros_like(unknown)
    if with_free:  # a few known pixels that let go; none of them alone holds a part of the mask
        source[:] = 0
        free[:, : width // 2] = rng.random((height, width // 2)) < 0.1
    try:
        got = solve_poisson(values, unknown, source=source, free=free, tolerance=1e-6)
    except DegenerateError:
        assert with_free
        return
    expected = solve_naively(values, unknown, source, free)
    held = np.isclose(solve_naively(values + 1, unknown, source, free) - expected, 1).all(axis=2)  # parts with a level
    np.testing.assert_allclose(got[held], expected[held], atol=2e-4)
    np.testing.assert_array_equal(got[~unknown], values.astype(np.float32)[~unknown])


def test_harmonic_polynomials_come_back(rng):
    y, x = np.mgrid[:120, :150] / 100.0
    harmonic = np.stack([x * x - y * y, x * y, 3 * x - y + 1], axis=2)
    hole = blobs(rng, (120, 150), 0.5)
    hole[[0, -1]] = hole[:, [0, -1]] = False
    torn = np.where(hole[..., None], np.nan, harmonic)
    got = solve_poisson(torn, hole, tolerance=1e-6)
    np.testing.assert_allclose(got, harmonic, atol=1e-4)


def test_large_masks_take_threads_and_stay_right():
    """A disc of half a million pixels whose harmonic filling is known: the plane through its rim."""
    y, x = np.mgrid[:810, :830].astype(np.float32)
    plane = np.stack([x / 830, y / 810, (x - y) / 800], axis=2)
    disc = np.hypot(x - 415, y - 405) < 395
    got = solve_poisson(np.where(disc[..., None], 0, plane), disc, tolerance=1e-5)
    assert np.abs(got - plane).max() < 1e-3


def test_the_pictures_border_lets_values_float():
    """A strip that reaches the border: between a known left side and nothing, the left side goes on."""
    values = np.zeros((6, 40, 1))
    values[:, :4] = 7.0
    unknown = np.zeros((6, 40), bool)
    unknown[:, 4:] = True
    np.testing.assert_allclose(solve_poisson(values, unknown)[unknown], 7.0, atol=1e-5)


def test_free_pixels_do_not_pull():
    values = np.zeros((9, 30, 1))
    values[:, :5], values[:, 25:] = 3.0, 200.0
    unknown = np.zeros((9, 30), bool)
    unknown[:, 5:25] = True
    free = np.zeros_like(unknown)
    free[:, 25:] = True
    got = solve_poisson(values, unknown, free=free)
    np.testing.assert_allclose(got[unknown], 3.0, atol=1e-4)
    np.testing.assert_array_equal(got[:, 25:], 200.0)


def test_an_empty_mask_changes_nothing(rng):
    values = rng.normal(size=(5, 6, 3)).astype(np.float32)
    np.testing.assert_array_equal(solve_poisson(values, np.zeros((5, 6), bool)), values)


@pytest.mark.parametrize(
    ("change", "error"),
    [
        ({"values": np.zeros((5, 6))}, ShapeError),
        ({"unknown": np.zeros((5, 7), bool)}, ShapeError),
        ({"source": np.zeros((5, 6, 2))}, ShapeError),
        ({"free": np.zeros((4, 6), bool)}, ShapeError),
        ({"unknown": np.ones((5, 6), bool)}, DegenerateError),
        ({"unknown": np.eye(5, 6, dtype=bool), "free": np.ones((5, 6), bool)}, DegenerateError),
    ],
)
def test_refuses(change, error):
    with pytest.raises(error):
        solve_poisson(**({"values": np.zeros((5, 6, 3)), "unknown": np.zeros((5, 6), bool)} | change))
