import numpy as np
import pytest

from facewright.capture.simulated_kinect import KINECT_INTRINSICS, KINECT_SIZE, KinectNoise
from facewright.errors import ShapeError, ValueRangeError

QUIET = KinectNoise(axial_mm=0.0, axial_per_square_m=0.0, lateral_px=0.0)


def plane(z, tilt_degrees=0.0):
    """True depth of a plane through (0, 0, z) that turns away to the right."""
    u = (np.arange(KINECT_SIZE[1]) - KINECT_INTRINSICS.centre_x) / KINECT_INTRINSICS.focal_x
    row = z / (1.0 - np.tan(np.deg2rad(tilt_degrees)) * u)
    return np.broadcast_to(np.where((row > 0) & (row < 1e4), row, 0.0), KINECT_SIZE).astype(np.float32)


@pytest.mark.parametrize("z", [550.0, 700.0, 1500.0])
def test_axial_noise_is_that_of_the_published_study(z, rng):
    measured = KinectNoise().observe(plane(z), KINECT_INTRINSICS, rng)
    error = (measured - z)[measured > 0]
    step = 0.125 * z**2 / (580.0 * 75.0)
    expected = np.hypot(1.2 + 1.9 * (0.001 * z - 0.4) ** 2, step / np.sqrt(12.0))
    assert error.std() == pytest.approx(expected, rel=0.05)
    assert abs(error.mean()) < 0.15 * step + 0.02


def test_depth_comes_in_eighths_of_a_pixel_of_disparity(rng):
    measured = KinectNoise().observe(plane(650.0, 20.0), KINECT_INTRINSICS, rng)
    eighths = 8.0 * 580.0 * 75.0 / measured[measured > 0].astype(np.float64)
    np.testing.assert_allclose(eighths, np.rint(eighths), atol=1e-3)
    np.testing.assert_allclose(QUIET.observe(plane(650.0), KINECT_INTRINSICS, rng), 650.0, atol=0.62)


def test_noise_of_neighbours_is_alike_only_where_it_shall_be(rng):
    def likeness(noise):
        error = noise.observe(plane(650.0), KINECT_INTRINSICS, rng) - 650.0
        return np.corrcoef(error[:, 1:].ravel(), error[:, :-1].ravel())[0, 1]

    assert 0.5 < likeness(KinectNoise()) < 0.75
    assert abs(likeness(KinectNoise(correlation_px=0.0))) < 0.02


def test_lateral_noise_roughens_slopes_and_edges(rng):
    still = KinectNoise(axial_mm=0.0, axial_per_square_m=0.0)
    slope = plane(650.0, 45.0)
    error = (still.observe(slope, KINECT_INTRINSICS, rng) - slope)[:, 250:390]
    # 0.75 to 0.8 px of 650 / 575.8 mm, at 45 degrees, and steps of disparity of 1.2 mm
    assert error.std() == pytest.approx(np.hypot(0.78 * 650.0 / 575.8, 1.21 / np.sqrt(12.0)), rel=0.15)
    step = plane(600.0).copy()
    step[:, 320:] = 640.0
    measured = still.observe(step, KINECT_INTRINSICS, rng)
    wrong = (np.abs(measured - step) > 20.0) & (measured > 0)
    assert wrong[:, 310:330].any() and not wrong[:, :310].any() and not wrong[:, 330:].any()
    between = np.abs(measured[measured > 0] - 620.0)
    assert between.min() > 15.0  # nothing is measured between two surfaces


def test_projector_casts_a_shadow_to_the_left_of_what_is_near(rng):
    scene = plane(1200.0).copy()
    scene[100:200, 300:400] = 600.0
    measured = QUIET.observe(scene, KINECT_INTRINSICS, rng)
    width = KINECT_INTRINSICS.focal_x * 75.0 * (1 / 600.0 - 1 / 1200.0)  # 36 px
    hidden = measured == 0
    assert np.abs(hidden[110:190, :300].sum(axis=1) - width).max() <= 1.0
    assert hidden[110:190, 300 - int(width) + 1 : 300].all()
    assert not hidden[:, 400:].any() and not hidden[:100].any()


def test_grazing_surfaces_return_nothing(rng):
    # The angle is against the pixel's ray: at the middle of the picture it is the tilt.
    for tilt, seen in ((0.0, True), (65.0, True), (74.0, False)):
        measured = KinectNoise().observe(plane(650.0, tilt), KINECT_INTRINSICS, rng)
        assert (measured[:, 318:322] > 0).all() == seen
        assert (measured[:, 318:322] > 0).any() == seen
    rough, smooth = (
        (KinectNoise(lateral_px=0.0).observe(plane(650.0, t), KINECT_INTRINSICS, rng) - plane(650.0, t))[:, 315:325]
        for t in (66.0, 30.0)
    )
    assert rough.std() > 1.2 * smooth.std()


def test_absorbing_surfaces_fail_in_patches_and_at_their_rate(rng):
    absorbed = np.zeros(KINECT_SIZE, np.float32)
    absorbed[100:300, 100:300] = 0.4
    absorbed[300:, :] = 1.0
    failed = KinectNoise().observe(plane(650.0), KINECT_INTRINSICS, rng, absorbed=absorbed) == 0
    assert not failed[:100].any() and failed[300:].all()
    inside = failed[100:300, 100:300]
    assert 0.3 < inside.mean() < 0.45
    assert (inside[:, 1:] == inside[:, :-1]).mean() > 0.75  # 0.52 if each pixel failed for itself


def test_holes_and_range_and_repeatability():
    scene = plane(650.0).copy()
    scene[:10] = 0.0
    scene[10:20] = 300.0
    scene[20:30] = 9000.0
    measured = [KinectNoise().observe(scene, KINECT_INTRINSICS, np.random.default_rng(4)) for _ in range(2)]
    np.testing.assert_array_equal(*measured)
    assert measured[0].dtype == np.float32
    assert (measured[0][:30] == 0).all() and (measured[0][32:] > 0).all()


def test_refuses_bad_input(rng):
    with pytest.raises(ShapeError, match="depth"):
        KinectNoise().observe(np.zeros(5), KINECT_INTRINSICS, rng)
    with pytest.raises(ValueRangeError, match="negative"):
        KinectNoise().observe(plane(650.0) - 700.0, KINECT_INTRINSICS, rng)
    with pytest.raises(ValueRangeError, match="finite"):
        KinectNoise().observe(plane(650.0) * np.nan, KINECT_INTRINSICS, rng)
    with pytest.raises(ShapeError, match="absorbed"):
        KinectNoise().observe(plane(650.0), KINECT_INTRINSICS, rng, absorbed=np.zeros((2, 2)))
    with pytest.raises(ValueRangeError, match="not negative"):
        KinectNoise(axial_mm=-1.0)
    with pytest.raises(ValueRangeError, match="grazing_degrees"):
        KinectNoise(grazing_degrees=100.0)
