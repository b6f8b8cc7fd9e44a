"""What a template is fitted to."""

import numpy as np
import pytest

from facewright.errors import ShapeError, ValueRangeError
from facewright.fitting.scan_target import ScanTarget


def parts():
    return {
        "points": np.zeros((4, 3)),
        "normals": np.ones((4, 3)),
        "faces": np.array([[0, 1, 2]], np.int32),
        "landmarks": np.full((74, 3), np.nan),
        "confidence": np.zeros(74),
    }


@pytest.mark.parametrize(
    ("name", "value"),
    [
        ("points", np.zeros((4, 2))),
        ("normals", np.zeros((3, 3))),
        ("landmarks", np.zeros((68, 3))),
        ("confidence", np.zeros(68)),
        ("contour_pixels", np.zeros((15, 2))),
    ],
)
def test_targets_refuse_wrong_shapes(name, value):
    ScanTarget(**parts())
    with pytest.raises(ShapeError, match=f"{name} must have shape"):
        ScanTarget(**{**parts(), name: value})


def test_targets_refuse_points_that_are_not_finite():
    with pytest.raises(ValueRangeError, match="points must be finite"):
        ScanTarget(**{**parts(), "points": np.full((4, 3), np.nan)})
