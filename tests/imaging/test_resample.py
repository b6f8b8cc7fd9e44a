import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from facewright.errors import ShapeError, ValueRangeError
from facewright.imaging.resample import resample, resample_displaced


def keys(s):
    s = abs(s)
    if s < 1:
        return 1.5 * s**3 - 2.5 * s**2 + 1
    return -0.5 * s**3 + 2.5 * s**2 - 4 * s + 2 if s < 2 else 0.0


def resample_naively(image, x, y):
    """Cubic convolution as its paper defines it: every pixel times the kernel at its distance."""
    height, width = image.shape[:2]
    out = np.zeros((len(x), *image.shape[2:]))
    for i, (px, py) in enumerate(zip(np.clip(x, 0, width - 1), np.clip(y, 0, height - 1))):
        for row in range(int(np.floor(py)) - 1, int(np.floor(py)) + 3):
            for column in range(int(np.floor(px)) - 1, int(np.floor(px)) + 3):
                value = image[np.clip(row, 0, height - 1), np.clip(column, 0, width - 1)].astype(float)
                out[i] += keys(px - column) * keys(py - row) * value
    return out


@settings(max_examples=30, deadline=None)
@given(seed=st.integers(0, 10_000), height=st.integers(1, 9), width=st.integers(1, 9), channels=st.integers(1, 4))
def test_equals_the_paper(seed, height, width, channels):
    rng = np.random.default_rng(seed)
    x = rng.uniform(-3, width + 3, 40).astype(np.float32)
    y = rng.uniform(-3, height + 3, 40).astype(np.float32)
    floats = rng.uniform(-1, 2, (height, width, channels)).astype(np.float32)
    np.testing.assert_allclose(resample(floats, x, y), resample_naively(floats, x, y), atol=1e-5)
    bits = rng.integers(0, 256, (height, width, channels), dtype=np.uint8)
    expected = np.clip(resample_naively(bits, x, y), 0, 255)
    got = resample(bits, x, y)
    assert got.dtype == np.uint8
    assert np.abs(got - expected).max() < 0.501


def test_whole_pixels_come_back_to_the_last_bit(rng):
    photo = rng.integers(0, 256, (31, 43, 3), dtype=np.uint8)
    y, x = np.mgrid[:31, :43]
    np.testing.assert_array_equal(resample(photo, x, y), photo)
    floats = rng.normal(size=(31, 43)).astype(np.float32)
    np.testing.assert_array_equal(resample(floats, x, y), floats)


def test_parabolas_are_exact(rng):
    y, x = np.mgrid[:20, :30].astype(np.float32)

    def parabola(x, y):
        return 0.01 * x * x - 0.02 * x * y + 0.015 * y * y + 0.3 * x - y

    u, v = rng.uniform(2, 27, 200), rng.uniform(2, 17, 200)
    np.testing.assert_allclose(resample(parabola(x, y), u, v), parabola(u, v), atol=1e-4)


def test_only_where_asked(rng):
    photo = rng.integers(0, 256, (8, 9, 3), dtype=np.uint8)
    y, x = np.mgrid[:8, :9].astype(np.float32)
    x[2, 3] = np.nan  # not asked for
    where = rng.random((8, 9)) < 0.5
    where[2, 3] = False
    out = np.full((8, 9, 3), 77, np.uint8)
    assert resample(photo, x, y, where=where, out=out) is out
    np.testing.assert_array_equal(out, np.where(where[..., None], photo, 77))


def test_beyond_the_border_the_border_goes_on():
    ramp = np.arange(5, dtype=np.float32)[None].repeat(3, axis=0)
    np.testing.assert_array_equal(
        resample(ramp, np.array([-np.inf, -9.0, 4.2, 1e30]), np.array([0.0, -1e30, 9, 1])), [0, 0, 4, 4]
    )


@pytest.mark.parametrize(
    ("change", "error"),
    [
        ({"image": np.zeros((0, 4), np.uint8)}, ShapeError),
        ({"image": np.zeros(4, np.uint8)}, ShapeError),
        ({"y": np.zeros(3)}, ShapeError),
        ({"x": np.array([0.0, np.nan])}, ValueRangeError),
        ({"where": np.ones(3, bool)}, ShapeError),
        ({"out": np.zeros((3, 3), np.uint8)}, ShapeError),
        ({"out": np.zeros((2, 3), np.float32)}, ValueRangeError),
        ({"out": np.zeros((2, 6), np.uint8)[:, ::2]}, ValueRangeError),
    ],
)
def test_refuses(change, error):
    good = {"image": np.zeros((4, 4, 3), np.uint8), "x": np.zeros(2), "y": np.zeros(2)}
    with pytest.raises(error):
        resample(**(good | change))


@pytest.mark.parametrize("kind", [np.uint8, np.float32])
def test_displaced_is_resample_at_the_displaced_places(rng, kind):
    photo = rng.integers(0, 256, (40, 50, 3), dtype=np.uint8)
    displacement = rng.normal(scale=6, size=(20, 30, 2)).astype(np.float32)
    displacement[rng.random((20, 30)) < 0.3] = 0
    part, moved = resample_displaced(photo.astype(kind), displacement, (15, 12))
    y, x = np.mgrid[12:32, 15:45].astype(np.float32)
    np.testing.assert_array_equal(part, resample(photo, x + displacement[..., 0], y + displacement[..., 1]))
    np.testing.assert_array_equal(moved, (displacement != 0).any(axis=2))
    np.testing.assert_array_equal(part[~moved], photo[12:32, 15:45][~moved])


@pytest.mark.parametrize(
    ("change", "error"),
    [
        ({"image": np.zeros((8, 8), np.uint8)}, ShapeError),
        ({"displacement": np.zeros((4, 4))}, ShapeError),
        ({"displacement": np.full((4, 4, 2), np.nan)}, ValueRangeError),
        ({"origin": (5, 0)}, ValueRangeError),
        ({"origin": (0, -1)}, ValueRangeError),
    ],
)
def test_displaced_refuses(change, error):
    good = {"image": np.zeros((8, 8, 3), np.uint8), "displacement": np.zeros((4, 4, 2)), "origin": (4, 4)}
    with pytest.raises(error):
        resample_displaced(**(good | change))
