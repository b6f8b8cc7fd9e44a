import numpy as np
import pytest

from facewright.errors import ShapeError, ValueRangeError
from facewright.landmarks.points import Landmarks, interocular_distance
from facewright.landmarks.scheme import load_scheme


@pytest.fixture
def points(rng):
    return rng.uniform(10, 200, (74, 2))


def test_missing_points_are_nan_with_confidence_zero(points):
    confidence = np.ones(74)
    confidence[3] = 0.0
    landmarks = Landmarks("fw74", points, confidence)
    assert np.isnan(landmarks.points[3]).all()
    assert landmarks.present.sum() == 73
    assert np.isfinite(points).all()  # the input is not changed


def test_refuses_nan_that_is_not_marked(points):
    points[7, 1] = np.nan
    with pytest.raises(ValueRangeError, match="point 7"):
        Landmarks("fw74", points)
    confidence = np.ones(74)
    confidence[7] = 0
    assert not Landmarks("fw74", points, confidence).present[7]


@pytest.mark.parametrize("bad", [-0.1, 1.1, np.nan])
def test_refuses_bad_confidence(points, bad):
    with pytest.raises(ValueRangeError, match="confidence"):
        Landmarks("fw74", points, np.full(74, bad))


def test_refuses_wrong_count_and_scheme(points):
    with pytest.raises(ShapeError, match="fw74"):
        Landmarks("fw74", points[:-1])
    with pytest.raises(ShapeError):
        Landmarks("ibug68", points)
    with pytest.raises(ValueRangeError):
        Landmarks("none", points)


def test_conversion_keeps_shared_points_and_marks_the_rest_missing(rng):
    dots = rng.uniform(0, 100, (68, 2))
    fw = Landmarks("ibug68", dots).convert("fw74")
    np.testing.assert_allclose(fw.points[54:74], dots[48:68])
    np.testing.assert_allclose(fw.points[44], dots[28:30].mean(axis=0))
    assert not fw.present[load_scheme("fw74").index("right_brow_lower_middle")]
    confidence = np.ones(68)
    confidence[28], confidence[50] = 0.0, 0.4
    fw = Landmarks("ibug68", dots, confidence).convert("fw74")
    assert not fw.present[44]
    assert fw.confidence[56] == 0.4


def test_points_of_a_file_win_point_by_point(points, rng):
    other = np.full((74, 2), np.nan)
    confidence = np.zeros(74)
    other[5], confidence[5] = [1.0, 2.0], 1.0
    merged = Landmarks("fw74", points, np.full(74, 0.3)).overridden_by(Landmarks("fw74", other, confidence))
    np.testing.assert_array_equal(merged.points[5], [1.0, 2.0])
    assert merged.confidence[5] == 1.0
    np.testing.assert_array_equal(np.delete(merged.points, 5, 0), np.delete(points, 5, 0))
    by_ibug = Landmarks("fw74", points).overridden_by(Landmarks("ibug68", rng.uniform(0, 9, (68, 2))))
    np.testing.assert_array_equal(by_ibug.points[19], points[19])
    assert (by_ibug.points[54:74] < 9).all()


def test_mirroring_twice_is_the_identity(points):
    landmarks = Landmarks("fw74", points)
    np.testing.assert_allclose(landmarks.mirrored(640).mirrored(640).points, points)
    assert landmarks.mirrored(640).points[54, 0] == 639 - points[60, 0]


def test_interocular_distance_and_box(points):
    landmarks = Landmarks("fw74", points)
    expected = np.linalg.norm(points[27:35].mean(axis=0) - points[35:43].mean(axis=0))
    assert landmarks.interocular_distance() == pytest.approx(expected)
    assert landmarks.box == (*points.min(axis=0), *points.max(axis=0))
    points[30] = np.nan
    with pytest.raises(ValueRangeError, match="right eye"):
        interocular_distance(points, "fw74")
    with pytest.raises(ValueRangeError):
        _ = Landmarks("fw74", points, np.zeros(74)).box
