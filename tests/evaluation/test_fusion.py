"""Suite `fusion`: keys, noise below the raw frames', pixels that are judged."""

from importlib.util import find_spec

import numpy as np
import pytest

from facewright.errors import ValueRangeError
from facewright.evaluation import fusion


@pytest.mark.slow
def test_keys_and_gain(builtin_face, monkeypatch):
    monkeypatch.setattr(fusion, "N_FRAMES", 8)
    monkeypatch.setattr(fusion, "EXPRESSIONS", (0,))
    metrics = fusion.run(builtin_face, 3, subjects=1)
    assert {"fps", "drift_mm", "drift_deg", "raw_noise_mm", "fused_noise_mm"} <= set(metrics)
    assert metrics["fused_noise_mm"] < 0.7 * metrics["raw_noise_mm"]
    assert metrics["fused_noise_mm"] < metrics["single_frame_noise_mm"]
    assert 0 < metrics["drift_mm"] < 2.0 and 0 < metrics["drift_deg"] < 2.0
    assert metrics["coverage"] > 0.9 and metrics["fps"] > 0
    # what the gate leaves out is worse than the rest
    assert metrics["fused_noise_mm"] <= metrics["ungated_fused_noise_mm"] < 5.0
    if find_spec("open3d") is None:
        assert "open3d_fused_noise_mm" not in metrics
    else:
        assert metrics["open3d_fused_noise_mm"] < 0.7 * metrics["raw_noise_mm"]
        assert abs(metrics["open3d_drift_mm"] - metrics["drift_mm"]) < 0.5
        assert metrics["beside_open3d_fused_noise_mm"] > 0 and metrics["open3d_fps"] > 0


def test_judged_pixels_leave_edges_and_walls_out():
    truth = np.full((40, 40), 1500.0)
    truth[10:30, 10:30] = 600.0
    judged = fusion.judged_pixels(truth, (5, 5, 35, 35))
    assert judged[12:28, 12:28].all() and judged.sum() == 16 * 16


def test_subjects_must_be_positive(builtin_face):
    with pytest.raises(ValueRangeError, match="subjects must be positive"):
        fusion.run(builtin_face, 0, subjects=0)
