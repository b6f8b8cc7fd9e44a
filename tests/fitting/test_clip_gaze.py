import numpy as np
import pytest

from facewright.camera.pinhole import Intrinsics, RigidMotion
from facewright.camera.rotation import rotation_from_head_angles
from facewright.fitting.clip_gaze import (
    _CENTRE_BEHIND,
    _CORNERS,
    _IRIS_BEFORE,
    _IRISES,
    frame_gaze,
    keep_through_blinks,
)
from facewright.fitting.clip_person import FrameState
from facewright.fitting.dense_model import DenseModel, FramePose


@pytest.mark.parametrize(("yaw", "pitch"), [(0.0, 0.0), (0.3, -0.1), (-0.2, 0.25)])
def test_irises_on_turned_eyeballs_give_the_turn(small_model, rng, yaw, pitch):
    dense = DenseModel(small_model)
    person = dense.person(np.zeros(dense.n_identity), np.zeros(dense.n_modes))
    R = rotation_from_head_angles(*rng.uniform(-10, 10, 3))
    pose = FramePose(RigidMotion(R, np.array([5.0, 2.0, 600.0])), Intrinsics.for_image((480, 640), 900.0))
    axis = np.array([np.sin(yaw) * np.cos(pitch), np.sin(pitch), np.cos(yaw) * np.cos(pitch)])
    points = np.zeros((478, 2))
    for corners, iris in zip(_CORNERS, _IRISES, strict=True):
        ids = list(corners)
        points[ids] = pose.intrinsics.project(pose.motion.apply(person.neutral[ids]))
        centre = person.neutral[ids].mean(axis=0) - [0, 0, _CENTRE_BEHIND]
        points[iris] = pose.intrinsics.project(pose.motion.apply(centre + _IRIS_BEFORE * axis))
    found = frame_gaze(dense, points, person, FrameState(pose, np.zeros(46)))
    np.testing.assert_allclose(found, [yaw, pitch], atol=0.01)


def test_blinks_do_not_move_the_gaze():
    gaze = np.zeros((20, 2))
    gaze[10:] = 0.3
    closure = np.zeros(20)
    gaze[4:6], closure[4:6] = -0.6, 1.0
    held = keep_through_blinks(gaze, closure)
    assert np.abs(held[:9]).max() == 0.0
    np.testing.assert_allclose(held[11:], 0.3)
    assert not keep_through_blinks(gaze, np.ones(20)).any()
