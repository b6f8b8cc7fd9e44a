"""Gaps are filled and labels given back; naive twins, limits, refusals."""

import numpy as np
import pytest

from facewright.errors import ShapeError, ValueRangeError
from facewright.models.marker_gaps import fill_gaps, predict_missing
from facewright.models.marker_swaps import mend_labels

M, T, NOISE = 40, 90, 0.2


@pytest.fixture
def scene(rng):
    """Markers 10 mm apart on a sheet that bends in five smooth ways; their covariance and a clip of 90 frames."""
    i, k = np.divmod(np.arange(M), 8)
    rest = np.stack([10.0 * k, 10.0 * i, 0.02 * (10.0 * k) ** 2], axis=1) + rng.normal(0, 0.8, (M, 3))
    waves = np.array([np.sin(rest @ rng.normal(0, 0.04, 3) + phase) for phase in range(5)])
    modes = 4.0 * (waves[:, :, None] * rng.normal(size=(5, 1, 3))).reshape(5, -1)
    times = np.arange(T) / 60.0
    weights = np.stack([np.sin(2 * np.pi * times * f + f) for f in (0.4, 0.7, 1.1, 1.3, 0.9)], axis=1)
    truth = (weights @ modes).reshape(T, M, 3)
    covariance = modes.T @ modes + 0.3**2 * np.eye(3 * M)
    own = 1.5 * np.sin(2 * np.pi * times)[:, None] * (np.arange(M) == 9)  # what one marker does alone
    truth[..., 2] += own
    return rest, times, truth, truth + rng.normal(0, NOISE, truth.shape), np.linalg.inv(covariance)


def test_prediction_is_the_conditional_mean(scene, rng):
    _, _, _, offsets, precision = scene
    missing = rng.random((T, M)) < 0.1
    predicted = predict_missing(np.where(missing[..., None], 0.0, offsets), missing, precision)
    assert np.array_equal(predicted[~missing], offsets[~missing])
    covariance = np.linalg.inv(precision)
    for t in (0, 17, 50):  # the textbook formula, frame by frame
        gone = np.repeat(missing[t], 3)
        expected = covariance[np.ix_(gone, ~gone)] @ np.linalg.solve(
            covariance[np.ix_(~gone, ~gone)], offsets[t].ravel()[~gone]
        )
        assert np.allclose(predicted[t].ravel()[gone], expected, atol=1e-6)


def test_gaps_are_filled_up_to_the_limit(scene):
    _, times, truth, offsets, precision = scene
    holes = offsets.copy()
    holes[20:30, 9] = np.nan  # 0.18 s
    holes[0:6, 3] = np.nan  # at the start
    holes[40:85, 9] = np.nan  # 0.77 s
    before = holes.copy()
    filled = fill_gaps(holes, times, precision, 0.25)
    assert np.array_equal(holes, before, equal_nan=True)
    assert filled.n_filled == 16 and filled.n_beyond == 45 and filled.longest_s == pytest.approx(46 / 60)
    seen = ~np.isnan(holes)
    assert np.array_equal(filled.offsets[seen], holes[seen])
    assert np.linalg.norm(filled.offsets - truth, axis=2)[20:30, 9].max() < 1.0
    # the marker's own way is kept through a short gap, which the others alone do not know
    alone = predict_missing(np.where(seen, holes, 0.0), ~seen.all(axis=2), precision)
    error = np.linalg.norm(filled.offsets - truth, axis=2)[20:30, 9].mean()
    assert error < 0.8 * np.linalg.norm(alone - truth, axis=2)[20:30, 9].mean()
    # in the middle of the long one the others alone speak
    assert np.allclose(filled.offsets[62, 9], alone[62, 9])


def test_nothing_missing_is_nothing_done(scene):
    _, times, _, offsets, precision = scene
    filled = fill_gaps(offsets, times, precision)
    assert np.array_equal(filled.offsets, offsets) and filled[1:] == (0, 0, 0.0)
    one = fill_gaps(offsets[:1], times[:1], precision)  # a single frame
    assert one.offsets.shape == (1, M, 3)


def test_gap_refusals(scene):
    _, times, _, offsets, precision = scene
    holes = offsets.copy()
    holes[5, : M // 2 + 1] = np.nan
    with pytest.raises(ValueRangeError, match=r"at least half of the 40 markers .* got 19 at 0\.083 s"):
        fill_gaps(holes, times, precision)
    with pytest.raises(ValueRangeError, match="limit_s"):
        fill_gaps(offsets, times, precision, -1.0)
    with pytest.raises(ShapeError):
        fill_gaps(offsets, times[:-1], precision)
    with pytest.raises(ShapeError):
        fill_gaps(offsets, times, precision[:-3, :-3])


def test_swaps_are_undone(scene):
    rest, _, _, offsets, precision = scene
    points = offsets + rest
    swapped = points.copy()
    swapped[10:30, [4, 5]] = points[10:30, [5, 4]]
    swapped[25:40, [20, 28]] = points[25:40, [28, 20]]
    cycle = points[60:70, [11, 12, 13]]
    swapped[60:70, [12, 13, 11]] = cycle  # three labels in a ring
    mended = mend_labels(swapped - rest, rest, precision)
    assert np.allclose(mended.offsets, offsets, atol=1e-9)
    assert mended.n_swapped == 2 * 20 + 2 * 15 + 3 * 10 and mended.n_left_out == 0
    assert mended.partner[12, 4] == 5 and mended.partner[50].tolist() == list(range(M))


def test_a_marker_out_of_place_is_left_out(scene):
    rest, _, _, offsets, precision = scene
    broken = offsets.copy()
    broken[7:12, 30] += [25.0, 0.0, 30.0]
    broken[8, 31] = np.nan
    mended = mend_labels(broken, rest, precision)
    gone = np.isnan(mended.offsets).any(axis=2)
    assert gone[7:12, 30].all() and mended.n_left_out == 5 and gone.sum() == 6
    assert np.allclose(mended.offsets[~gone], broken[~gone])


def test_good_markers_are_left_alone(scene):
    rest, _, _, offsets, precision = scene
    mended = mend_labels(offsets, rest, precision)
    assert np.allclose(mended.offsets, offsets, atol=1e-9) and mended.n_swapped == mended.n_left_out == 0
    empty = offsets.copy()
    empty[3] = np.nan
    with pytest.raises(ValueRangeError, match="marker"):
        mend_labels(empty, rest, precision)
    with pytest.raises(ShapeError):
        mend_labels(offsets, rest[:-1], precision)


def _ring(points, frames, labels):
    """Labels (a ring, each the next one's place) of those frames."""
    points[frames.start : frames.stop, labels] = points[frames.start : frames.stop, np.roll(labels, 1)]


def test_frames_with_too_many_strange_markers_are_told(scene, rng):
    rest, _, _, offsets, precision = scene
    points = offsets + rest
    _ring(points, range(20, 30), rng.permutation(M)[:5])
    _ring(points, range(50, 70), rng.permutation(M)[:30])
    mended = mend_labels(points - rest, rest, precision)
    assert (mended.n_stray > 0).nonzero()[0].tolist() == list(range(50, 70)) and mended.stray_mm > 5.0
    gone = np.isnan(mended.offsets).any(axis=2).sum(axis=1)
    assert (gone[20:30] <= 5).all() and (gone[50:70] == 6).all() and not gone[:20].any()
    clean = mend_labels(offsets, rest, precision)
    assert not clean.n_stray.any() and clean.stray_mm == 0.0


def test_a_sixteenth_of_many_markers_may_be_left_out(rng):
    many = 160  # on a sheet that hardly bends
    i, k = np.divmod(np.arange(many), 16)
    rest = np.stack([10.0 * k, 10.0 * i, np.zeros(many)], axis=1)
    offsets = rng.normal(0, NOISE, (3, many, 3))
    precision = np.eye(3 * many) / 0.3**2
    loose = rng.permutation(many)[:11]
    offsets[1, loose[:10]] += 40.0
    offsets[2, loose] += 40.0
    mended = mend_labels(offsets, rest, precision)
    assert mended.n_left_out == 20 and mended.n_stray.tolist() == [0, 0, 1]
    assert mended.stray_mm == pytest.approx(40.0 * 3**0.5, abs=1.5)
