from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest

from facewright.apps.simulated_recording import (
    act,
    simulate_capture_subject,
    simulate_recording,
)
from facewright.apps.true_landmarks import true_landmarks
from facewright.camera.rotation import head_angles_from_rotation, rotation_angle
from facewright.capture.simulated_kinect import KinectNoise
from facewright.errors import ShapeError, ValueRangeError
from facewright.faces.blendshape_names import BLENDSHAPE_NAMES
from facewright.faces.expressions import EXPRESSION_WEIGHTS, expression_weights
from facewright.imaging.rasterise import rasterise
from facewright.landmarks.contour import face_region


@pytest.fixture(scope="module")
def subject(builtin_face):
    return simulate_capture_subject(builtin_face, np.random.default_rng(5), hair=True, glasses=True)


@pytest.fixture(scope="module")
def recording(subject):
    return simulate_recording(subject, expression_weights("smile"), np.random.default_rng(1))


def region_depth(recording, i):
    """Depth of the face region alone in frame i, rasterised here; infinity elsewhere."""
    skin = recording.subject.face.skin()
    region = np.zeros(skin.topology.n_vertices, bool)
    region[face_region(skin.topology, skin.mean_shape)] = True
    faces = skin.topology.faces[region[skin.topology.faces].all(axis=1)]
    seen = recording.camera_from_model[i].apply(recording.vertices[: skin.topology.n_vertices])
    return rasterise(recording.intrinsics.project(seen), seen[:, 2], faces, (480, 640)).depth


def test_head_turns_to_both_sides_and_comes_back(recording):
    angles = np.array([head_angles_from_rotation(m.rotation) for m in recording.camera_from_model])
    yaw = angles[:, 0] - angles[0, 0]
    assert recording.n_frames == 24
    assert 13.5 < yaw.max() < 16.0 and -16.0 < yaw.min() < -13.5
    assert abs(yaw[-1]) < 0.5
    assert 1.0 < np.ptp(angles[:, 1]) < 10.0  # a little nodding
    assert np.abs(angles[0]).max() < 12.0
    rotations = [motion.rotation for motion in recording.camera_from_model]
    steps = [rotation_angle(a, b) for a, b in pairwise(rotations)]
    assert np.rad2deg(max(steps)) < 5.0


@pytest.mark.parametrize("seed", range(4))
def test_face_is_within_reach_and_in_the_picture(subject, seed):
    recording = simulate_recording(subject, expression_weights("neutral"), np.random.default_rng(seed))
    bridge = recording.vertices[subject.face.topology.landmarks["fw74"][43]]
    assert 550.0 - 8.0 < recording.camera_from_model[0].apply(bridge)[2] < 700.0 + 8.0
    for i in (0, 6, 18):
        points = recording.true_landmarks(i).points
        assert (points > 20.0).all() and (points < [620.0, 460.0]).all()


def test_true_depth_is_that_of_the_true_mesh(recording):
    for i in (0, 7):
        depth, alone = recording.true_depth(i), region_depth(recording, i)
        seen = np.isfinite(alone)
        assert seen.sum() > 8000
        difference = (alone - depth)[seen]
        assert (difference > -1e-2).all()  # nothing shines through the face: hair and glasses are before it
        assert (np.abs(difference) < 1e-2).mean() > 0.9
        assert (depth > 400.0).all() and depth.max() > 1000.0  # there is a wall


def test_what_does_not_turn_with_the_head(recording, subject):
    a, b = recording.true_depth(0), recording.true_depth(7)
    assert (a[-60:] == b[-60:]).all() and (a[:, :60] == b[:, :60]).all()  # torso and wall stand still
    assert (a[-1] < 1000.0).sum() > 100  # and there is a torso
    head = np.isfinite(region_depth(recording, 0))
    assert (a[head] != b[head]).mean() > 0.9


def test_hair_stands_off_the_scalp_and_glasses_off_the_face(subject):
    from facewright.mesh.closest_point import ClosestPoints

    skin = subject.person.neutral[: subject.face.n_skin].astype(float)
    faces = subject.face.topology.faces
    search = ClosestPoints(skin, faces[(faces < subject.face.n_skin).all(axis=1)])
    normals = np.zeros_like(skin)
    normals[:, 1] = 1.0
    cap = subject.hair.over(skin, normals)
    assert subject.hair.thickness.max() > 4.0 and subject.hair.thickness.max() < 60.0
    assert cap.vertices[:, 1].min() > subject.person.neutral[subject.face.topology.landmarks["ibug68"][8], 1]
    frame = subject.glasses[0].vertices
    distance = search.query(frame).distances
    assert 3.0 < np.quantile(distance, 0.9) < 40.0


def test_noise_is_near_what_facewarehouse_measured(subject, recording):
    """FW 3.1: raw noise up to 4 mm, 1.5 mm on average."""
    depth, measured, alone = recording.true_depth(0), recording.frame(0).depth, region_depth(recording, 0)
    face = np.abs(alone - depth) < 0.01
    got = face & (measured > 0)
    error = np.abs(measured - depth)[got]
    assert 0.9 < error.mean() < 1.9
    assert np.quantile(error, 0.98) < 6.0
    assert got.sum() > 0.75 * face.sum()
    perfect = simulate_recording(subject, expression_weights("smile"), np.random.default_rng(1), noise=False)
    np.testing.assert_array_equal(perfect.frame(0).depth, depth)
    assert perfect.vertices.tobytes() == recording.vertices.tobytes()


def test_frames_are_the_same_at_every_call_and_stream(recording, subject):
    one, two = recording.frame(3), recording.frame(3)
    np.testing.assert_array_equal(one.color, two.color)
    np.testing.assert_array_equal(one.depth, two.depth)
    third = [frame for _, frame in zip(range(4), recording.frames())][3]
    np.testing.assert_array_equal(third.depth, one.depth)
    assert third.time == pytest.approx(0.1)
    again = simulate_recording(subject, expression_weights("smile"), np.random.default_rng(1)).frame(3)
    np.testing.assert_array_equal(again.color, one.color)
    other = recording.frame(4)
    assert (other.depth != one.depth).any()
    still = (recording.true_depth(3) == recording.true_depth(4)) & (one.depth > 0) & (other.depth > 0)
    assert (one.depth - other.depth)[still].std() > 1.0  # fresh noise


def test_picture_is_soft_and_noisy(recording):
    frame = recording.frame(0)
    assert frame.color.shape == (480, 640, 3) and frame.color.dtype == np.uint8
    wall = frame.color[5:60, 5:60].astype(float)
    assert 1.5 < (wall[1:] - wall[:-1]).std() / np.sqrt(2.0) < 4.0
    x, y = np.rint(recording.true_landmarks(0).points[45]).astype(int)
    assert np.abs(frame.color[y, x].astype(int) - frame.color[10, 10]).max() > 15


def test_acting_is_imperfect_but_possible(rng):
    guides = np.asarray(EXPRESSION_WEIGHTS)
    acted = np.array([[act(guide, rng) for _ in range(40)] for guide in guides])
    assert (acted[0] == 0).all()  # the neutral is neutral
    free = (guides > 0) & (guides < 1.0)
    share = (acted / np.maximum(guides, 1e-9)[:, None])[np.broadcast_to(free[:, None], acted.shape)]
    assert share.min() >= 0.7 and share.max() <= 1.1 and share.std() > 0.08
    blink = BLENDSHAPE_NAMES.index("eyeBlink_L")
    assert (acted[-1][:, blink] == 1.0).all()  # eyes that shall be closed are closed
    assert ((acted > 0) & (guides[:, None] == 0)).mean() > 0.02
    pressed = np.zeros(46)
    pressed[[BLENDSHAPE_NAMES.index("jawOpen"), BLENDSHAPE_NAMES.index("mouthClose")]] = 0.5
    done = act(pressed, rng)
    assert done[BLENDSHAPE_NAMES.index("mouthClose")] == done[BLENDSHAPE_NAMES.index("jawOpen")]


def test_exact_acting_on_request(subject, rng):
    weights = expression_weights("grin")
    recording = simulate_recording(subject, weights, rng, acted=False, n_frames=1)
    np.testing.assert_array_equal(recording.weights, weights)
    np.testing.assert_allclose(recording.vertices, subject.person.pose(weights), atol=1e-4)
    assert recording.n_frames == 1


def test_subjects_differ_and_describe_themselves(builtin_face):
    many = [simulate_capture_subject(builtin_face, np.random.default_rng(k)) for k in (0, 13, 2)]
    assert {s.attributes["glasses"] for s in many} == {True, False}
    assert {s.attributes["hair"] for s in many} >= {"full", "short"}
    for s in many:
        assert s.attributes["glasses"] == (s.glasses is not None)
        assert 18 <= s.attributes["age"] <= 75 and s.attributes["sex"] in ("female", "male")
    bare = simulate_capture_subject(builtin_face, np.random.default_rng(0), hair=False, glasses=False)
    assert bare.hair is None and bare.glasses is None


def test_landmarks_are_those_of_the_face_alone(recording):
    skin = recording.subject.face.skin()
    expected = true_landmarks(
        skin.topology,
        skin.mean_shape,
        recording.vertices[: skin.topology.n_vertices],
        recording.intrinsics,
        recording.camera_from_model[2],
    )
    np.testing.assert_array_equal(recording.true_landmarks(2).points, expected.points)


def test_head_out_of_view_leaves_the_room(recording):
    away = replace(recording.camera_from_model[0], translation=np.array([5000.0, 0.0, 700.0]))
    elsewhere = replace(recording, camera_from_model=(away,))
    frame = elsewhere.frame(0)
    assert (elsewhere.true_depth(0)[:200] > 900.0).all()
    assert frame.color.shape == (480, 640, 3)


def test_refuses_bad_input(subject, recording, rng):
    with pytest.raises(ShapeError, match="weights"):
        simulate_recording(subject, np.zeros(5), rng)
    with pytest.raises(ValueRangeError, match="finite"):
        simulate_recording(subject, np.full(46, np.nan), rng)
    with pytest.raises(ValueRangeError, match="n_frames"):
        simulate_recording(subject, np.zeros(46), rng, n_frames=0)
    with pytest.raises(ValueRangeError, match="turn_degrees"):
        simulate_recording(subject, np.zeros(46), rng, turn_degrees=90.0)
    with pytest.raises(ValueRangeError, match="frame"):
        recording.frame(24)
    with pytest.raises(ValueRangeError, match="frame"):
        recording.true_depth(-1)


def test_noise_can_be_chosen(subject):
    quiet = KinectNoise(axial_mm=0.0, axial_per_square_m=0.0, lateral_px=0.0)
    recording = simulate_recording(subject, np.zeros(46), np.random.default_rng(1), noise=quiet)
    measured, true = recording.frame(0).depth, recording.true_depth(0)
    near = (measured > 0) & (true < 800.0)
    assert np.quantile(np.abs(measured - true)[near], 0.5) < 0.6  # half a step of disparity is 0.5 to 0.9 mm


@pytest.mark.landmarks
@pytest.mark.parametrize("name", ["neutral", "mouth_stretch", "grin", "eyes_closed"])
def test_detector_finds_the_face_where_it_is(ict_face, name):
    pytest.importorskip("mediapipe")
    from facewright.landmarks.detector import open_detector

    seeds = {"neutral": 3, "mouth_stretch": 4, "grin": 5, "eyes_closed": 6}
    rng = np.random.default_rng(seeds[name])
    subject = simulate_capture_subject(ict_face, rng)
    recording = simulate_recording(subject, expression_weights(name), rng)
    with open_detector() as detector:
        for i in (0, 6):
            (found, *others) = detector.detect(recording.frame(i).color)
            assert not others
            points, truth = found.convert("fw74"), recording.true_landmarks(i)
            inner = truth.definition.fixed
            assert np.linalg.norm(points.points[inner] - truth.points[inner], axis=1).mean() < 5.0


@pytest.mark.slow
def test_fifteen_frames_a_second_on_one_core(ict_face):
    import time

    subject = simulate_capture_subject(ict_face, np.random.default_rng(0), hair=True, glasses=True)
    recording = simulate_recording(subject, expression_weights("smile"), np.random.default_rng(0))
    recording.frame(0)
    seconds = []
    for i in range(recording.n_frames):
        start = time.process_time()
        recording.frame(i)
        seconds.append(time.process_time() - start)
    assert np.min(seconds) < 1 / 10.0  # 1/15 on a core of its own
