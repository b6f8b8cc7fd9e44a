"""The demo's acting: a performance that starts and ends at rest, turns both ways and shows every expression."""

import numpy as np
import pytest

from facewright.camera.rotation import head_angles_from_rotation

pytest.importorskip("av")


def test_acting_starts_at_rest_and_turns_both_ways():
    from facewright.apps.demo_photo import acting

    performance = acting()
    assert np.allclose(np.diff(performance.times), 0.04)
    assert performance.weights[0].sum() == 0
    assert performance.weights.max(axis=0).max() > 0.9
    assert np.abs(np.diff(performance.weights, axis=0)).max() < 0.25  # no jump
    yaw = np.array([head_angles_from_rotation(r)[0] for r in performance.rotations])
    assert yaw.max() > 10
    assert yaw.min() < -10
    assert np.abs(yaw[[0, -1]]).max() < 0.5


def test_the_acted_expressions_move_lids_lips_and_brows():
    from facewright.apps.demo_photo import acting

    performance = acting()
    peak = dict(zip(performance.names, performance.weights.max(axis=0)))
    assert min(peak[name] for name in ("eyeBlink_L", "eyeBlink_R", "jawOpen", "mouthSmile_L", "browInnerUp_L")) > 0.5
