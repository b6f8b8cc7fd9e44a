import zlib

import numpy as np
import pytest

from facewright.errors import FileFormatError, ValueRangeError
from facewright.models.core_compression import compress_core, decompress_core


def make_core(rng, I=6, E=4, V=200):
    scale = np.outer(0.5 ** np.arange(I), 0.6 ** np.arange(E)) * 20
    core = scale[:, :, None, None] * rng.normal(size=(I, E, V, 3)).cumsum(axis=2) / 5
    core[0, 0] *= 20
    return core.astype(np.float32)


LIMITS = np.array([1.1, 3, 3, 3, 4, 3]), np.array([1.0, 3, 5, 3])


@pytest.mark.parametrize("max_error_mm", [0.5, 0.05, 0.005])
def test_stated_bound_holds_for_the_worst_weights(rng, max_error_mm):
    core = make_core(rng)
    compressed = compress_core(core, *LIMITS, max_error_mm)
    assert 0.5 * max_error_mm < compressed.max_error_mm <= max_error_mm
    decoded = decompress_core(compressed.steps, compressed.rows, 200, "x")
    assert decoded.dtype == np.float32
    assert decoded.flags.c_contiguous
    error = decoded.astype(float) - core
    # Adversary: for each of some coordinates, the corner of the box that adds all errors up in one row of weights.
    worst = 0.0
    for _ in range(500):
        w_id = LIMITS[0] * rng.choice([-1, 1], size=6)
        w_exp = LIMITS[1] * rng.choice([-1, 1], size=4)
        for _ in range(5):
            v, c = np.unravel_index(np.abs(np.einsum("i,e,ievc->vc", w_id, w_exp, error)).argmax(), (200, 3))
            w_id = LIMITS[0] * np.sign(error[:, :, v, c] @ w_exp)
            w_exp = LIMITS[1] * np.sign(w_id @ error[:, :, v, c])
        distance = np.linalg.norm(np.einsum("i,e,ievc->vc", w_id, w_exp, error), axis=1)
        worst = max(worst, distance.max())
    assert 0 < worst <= compressed.max_error_mm


def test_large_values_take_four_planes_and_small_two(rng):
    compressed = compress_core(make_core(rng), *LIMITS, 0.02)
    widths = [len(planes) for planes in compressed.rows]
    assert widths[0] == 4
    assert widths[-1] == 2


def test_extremes_of_a_plane_survive():
    """Differences that wrap around 16 bits must come back."""
    core = np.zeros((1, 1, 6, 3), dtype=np.float32)
    core[0, 0, :, 0] = [-32767, 32767, -32767, 0, 32767, -1]
    compressed = compress_core(core, np.ones(1), np.ones(1), 4.0)
    steps = np.ones((1, 1), dtype=np.float32)
    from facewright.models.core_compression import _compress_row

    rows = [_compress_row(core[0], steps[0])]
    assert len(rows[0]) == 2
    np.testing.assert_array_equal(decompress_core(steps, rows, 6, "x"), core)
    assert compressed.max_error_mm <= 4.0


def test_smooth_cores_shrink(rng):
    core = make_core(rng, V=2000)
    compressed = compress_core(core, *LIMITS, 0.05)
    assert sum(len(plane) for planes in compressed.rows for plane in planes) < 0.5 * core.nbytes


def test_unreachable_bounds_are_refused(rng):
    core = make_core(rng)
    for bad in (0.0, -1.0, float("nan")):
        with pytest.raises(ValueRangeError, match="max_error_mm must be positive"):
            compress_core(core, *LIMITS, bad)
    with pytest.raises(ValueRangeError, match="max_error_mm"):
        compress_core(core, *LIMITS, 1e-9)
    core[0, 0, 0, 0] = np.nan
    with pytest.raises(ValueRangeError, match="finite"):
        compress_core(core, *LIMITS, 0.05)


def test_planes_that_do_not_fit_are_refused(rng):
    core = make_core(rng)
    compressed = compress_core(core, *LIMITS, 0.05)
    rows = [list(planes) for planes in compressed.rows]
    with pytest.raises(FileFormatError, match="cannot hold"):
        decompress_core(compressed.steps, rows, 10**12, "x")
    with pytest.raises(FileFormatError, match="cannot hold"):
        decompress_core(compressed.steps, [planes[:1] for planes in rows], 200, "x")
    with pytest.raises(FileFormatError, match="expected 2412 values"):
        decompress_core(compressed.steps, rows, 201, "x")
    rows[2][0] = b"not deflate" * 100
    with pytest.raises(FileFormatError, match="component 2, is corrupt"):
        decompress_core(compressed.steps, rows, 200, "x")
    rows[2][0] = zlib.compress(bytes(10**7))  # a bomb: more than promised is not inflated
    with pytest.raises(FileFormatError, match="component 2"):
        decompress_core(compressed.steps, rows, 200, "x")
