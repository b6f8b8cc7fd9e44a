"""A performance carried to a photo: absolute expressions, turns relative to the rest, soft limits, gaze in space."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from facewright.apps.photo_motion import MotionOptions, carry_to_photo, soft_limit
from facewright.camera.pinhole import RigidMotion
from facewright.camera.rotation import FRONTAL, head_angles_from_rotation, rotation_angle, rotation_from_head_angles
from facewright.errors import ValueRangeError
from facewright.fitting.gaze import turn_of_gaze
from facewright.models.performance import Performance

NAMES = ("jawOpen", "eyeBlink_L", "eyeBlink_R")
POSE = RigidMotion(rotation_from_head_angles(5, 2, 1), np.array([10.0, -5.0, 700.0]))
GAZE = np.array([[0.02, 0.01], [0.03, 0.01]])


def acted(yaws: np.ndarray, gaze: np.ndarray | None = None) -> Performance:
    n = len(yaws)
    rotations = np.array([rotation_from_head_angles(yaw, 3, -2) for yaw in yaws])
    gaze = np.zeros((n, 2, 2)) if gaze is None else gaze
    weights = np.zeros((n, 3))
    weights[:, 0] = np.linspace(0, 1, n)
    return Performance(np.arange(n) / 25, NAMES, weights, rotations, np.zeros((n, 3)), gaze, np.ones(n, bool))


def test_expressions_are_absolute_and_named() -> None:
    motion = carry_to_photo(acted(np.zeros(5)), POSE, GAZE, ("eyeBlink_R", "mouthClose", "jawOpen"))
    np.testing.assert_allclose(motion.weights[:, 2], np.linspace(0, 1, 5))
    assert (motion.weights[:, :2] == 0).all()


def test_keep_keeps_the_pose_to_the_last_bit() -> None:
    motion = carry_to_photo(acted(np.linspace(-10, 10, 5)), POSE, GAZE, NAMES, MotionOptions("keep"))
    assert all(pose is POSE for pose in motion.poses)


def test_follow_turns_from_the_rest_not_from_the_first_frame() -> None:
    yaws = np.array([-9.0, 30, 30, 30, 30, 30, 36])  # begins turned away; usually at 30 degrees
    motion = carry_to_photo(acted(yaws), POSE, GAZE, NAMES)
    assert rotation_angle(motion.poses[1].rotation, POSE.rotation) < 1e-9
    np.testing.assert_allclose(motion.poses[1].translation, POSE.translation, atol=1e-9)
    assert np.rad2deg(rotation_angle(motion.poses[-1].rotation, POSE.rotation)) == pytest.approx(6, abs=0.2)
    assert head_angles_from_rotation(motion.poses[-1].rotation)[0] > head_angles_from_rotation(POSE.rotation)[0] + 5
    first = np.rad2deg(rotation_angle(motion.poses[0].rotation, POSE.rotation))
    assert 15 < first < 22.5  # 39 degrees, limited
    assert "1 of 7 frames" in motion.notes[0]


def test_rest_of_the_camera_and_scale() -> None:
    performance = Performance(
        **{
            **acted(np.full(4, 10.0)).__dict__,
            "rotations": np.repeat(rotation_from_head_angles(10, 0, 0)[None], 4, axis=0),
        }
    )
    motion = carry_to_photo(performance, POSE, GAZE, NAMES, MotionOptions("scale", 0.5, rest="camera"))
    assert np.rad2deg(rotation_angle(motion.poses[0].rotation, POSE.rotation)) == pytest.approx(5, abs=1e-6)
    still = carry_to_photo(performance, POSE, GAZE, NAMES, MotionOptions(rest="clip"))
    assert rotation_angle(still.poses[0].rotation, POSE.rotation) < 1e-9


def test_each_shot_has_its_own_rest() -> None:
    yaws = np.concatenate([np.full(20, -15.0), np.full(20, 15.0)])
    cuts = np.zeros(40, bool)
    cuts[20] = True
    motion = carry_to_photo(acted(yaws), POSE, GAZE, NAMES, cuts=cuts)
    assert max(rotation_angle(pose.rotation, POSE.rotation) for pose in motion.poses) < 1e-9
    whole = carry_to_photo(acted(yaws), POSE, GAZE, NAMES)
    assert max(rotation_angle(pose.rotation, POSE.rotation) for pose in whole.poses) > 0.1


def direction(rotation: np.ndarray, gaze: np.ndarray) -> np.ndarray:
    return rotation @ turn_of_gaze(*gaze)[:, 2]


def test_eyes_keep_their_direction_where_the_head_does_not_follow() -> None:
    # The actor turns by 12 degrees and keeps looking into the camera; the photo's head stays: so do its eyes.
    yaws = np.concatenate([np.zeros(9), [12.0]])
    gaze = np.zeros((10, 2, 2))
    there = rotation_from_head_angles(0, 3, -2).T @ rotation_from_head_angles(12, 3, -2)
    looks = there.T @ turn_of_gaze(*GAZE[0])[:, 2]
    gaze[-1] = [np.arctan2(looks[0], looks[2]), np.arcsin(looks[1])] - GAZE[0]
    motion = carry_to_photo(acted(yaws, gaze), POSE, GAZE, NAMES, MotionOptions("keep"))
    np.testing.assert_allclose(motion.gaze[:, 0], np.repeat(GAZE[:1], 10, axis=0), atol=1e-6)
    follows = carry_to_photo(acted(yaws, gaze), POSE, GAZE, NAMES)
    a = direction(follows.poses[-1].rotation, follows.gaze[-1, 0])
    b = direction(POSE.rotation, GAZE[0])
    assert np.rad2deg(np.arccos(a @ b)) < 0.5


def test_head_turns_about_the_top_of_the_neck() -> None:
    from facewright.apps.photo_motion import PIVOT

    motion = carry_to_photo(acted(np.array([0.0, 0, 0, 12])), POSE, GAZE, NAMES)
    np.testing.assert_allclose(motion.poses[-1].apply(PIVOT), POSE.apply(PIVOT), atol=1e-9)


def test_a_turned_head_turns_less() -> None:
    far = RigidMotion(rotation_from_head_angles(35, 0, 0), POSE.translation)
    yaws = np.array([0.0, 0, 0, 0, 25])
    turn = [
        rotation_angle(carry_to_photo(acted(yaws), pose, GAZE, NAMES).poses[-1].rotation, pose.rotation)
        for pose in (POSE, far)
    ]
    assert np.rad2deg(turn[1]) < 7 < 15 < np.rad2deg(turn[0])


@given(st.floats(-3, 3), st.floats(0.05, 1))
def test_soft_limit_is_odd_monotone_and_below_its_limit(turn: float, limit: float) -> None:
    limits = np.array([limit])
    value = float(soft_limit(np.array([[turn]]), limits)[0, 0])
    assert abs(value) <= min(abs(turn), limit) + 1e-12
    assert value == -float(soft_limit(np.array([[-turn]]), limits)[0, 0])
    assert float(soft_limit(np.array([[turn + 0.01]]), limits)[0, 0]) >= value
    if abs(turn) <= 0.6 * limit:
        assert value == turn


def test_options_out_of_range_are_refused() -> None:
    for wrong in ({"head": "nod"}, {"head_scale": -0.1}, {"rest": "first"}):
        with pytest.raises(ValueRangeError):
            MotionOptions(**wrong)
    assert np.linalg.det(FRONTAL) == pytest.approx(1)
