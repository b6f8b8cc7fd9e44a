"""One picture of a depth camera."""

import numpy as np
import pytest

from facewright.camera.pinhole import Intrinsics
from facewright.capture.frame import RGBDFrame
from facewright.errors import ShapeError, ValueRangeError

CAMERA = Intrinsics(500.0, 500.0, 3.5, 2.5)


def test_a_frame_knows_its_size():
    frame = RGBDFrame(np.zeros((6, 8, 3), np.uint8), np.zeros((6, 8), np.float32), CAMERA)
    assert frame.size == (6, 8)


def test_frames_refuse_two_grids_and_impossible_depths():
    color, depth = np.zeros((6, 8, 3), np.uint8), np.zeros((6, 8), np.float32)
    with pytest.raises(ShapeError, match="color must have shape"):
        RGBDFrame(color[:5], depth, CAMERA)
    with pytest.raises(ValueRangeError, match="uint8"):
        RGBDFrame(color.astype(np.float32), depth, CAMERA)
    for bad in (np.nan, np.inf, -1.0):
        depth = np.full((6, 8), 500.0, np.float32)
        depth[2, 3] = bad
        with pytest.raises(ValueRangeError, match="depth must be finite"):
            RGBDFrame(color, depth, CAMERA)
