import numpy as np
import pytest

from facewright.apps.scan_pictures import error_colours, fit_pictures, fit_sheet, zoomed_camera
from facewright.camera.pinhole import Intrinsics, RigidMotion
from facewright.camera.rotation import FRONTAL
from facewright.errors import ShapeError
from facewright.fitting.scan import ScanFit

CAMERA = Intrinsics(575.8, 575.8, 319.5, 239.5)


def test_colours_run_from_blue_to_red_and_grey_means_unknown():
    colours = error_colours(np.array([0.0, 3.0, 30.0, np.nan]), 3.0)
    assert colours[0, 2] > colours[0, 0] and colours[1, 0] > colours[1, 2]
    np.testing.assert_array_equal(colours[1], colours[2])
    assert np.ptp(colours[3]) == 0
    with pytest.raises(ShapeError):
        error_colours(np.zeros((2, 2)))


def test_the_zoomed_camera_shows_all_points(rng):
    points = np.column_stack([rng.uniform(-80, 80, (50, 2)), rng.uniform(550, 650, 50)])
    pixels = zoomed_camera(points, CAMERA, (300, 200)).project(points)
    assert (pixels > 0).all() and (pixels < [200, 300]).all()
    assert np.ptp(pixels, axis=0).max() > 140


def test_a_fit_gives_one_row_of_pictures(builtin_face):
    skin = builtin_face.skin()
    mean = skin.mean_shape.astype(float)
    motion = RigidMotion(FRONTAL, np.array([0.0, 0.0, 650.0]))
    shifted = mean + [0, 0, 5.0]
    fit = ScanFit(mean, shifted, np.zeros(1), motion, {})
    color, depth = np.full((480, 640, 3), 90, np.uint8), np.full((480, 640), 560.0)
    row = fit_pictures(fit, skin.topology, color, depth, CAMERA, size=(120, 100), truth=motion.apply(mean))
    assert len(row) == 8 and {picture.shape for picture in row} == {(120, 100, 3)}
    middle = np.s_[50:80, 40:60]
    stage1, stage2 = row[4][middle].astype(int), row[5][middle].astype(int)
    assert stage1[..., 0].mean() > stage2[..., 0].mean() + 40, "5 mm off is redder than exact"
    assert stage2[..., 2].mean() > stage2[..., 0].mean(), "an exact fit is blue"
    assert fit_sheet([row, row]).shape[0] > 240
