"""Fusion of recordings: simulated heads with known depth and motion, every fault, and the real mannequin."""

from functools import cache

import numpy as np
import pytest

from facewright.camera.pinhole import Intrinsics, RigidMotion
from facewright.camera.rotation import FRONTAL, rotation_angle, rotation_from_vector
from facewright.capture.face_rectangle import head_region, rectangle_from_depth
from facewright.capture.frame import RGBDFrame
from facewright.capture.fusion import FusionOptions, fuse
from facewright.capture.reference_frame import middle_of_turn, most_frontal
from facewright.errors import DegenerateError, NoFaceError, ShapeError, ValueRangeError
from facewright.faces import load_face
from facewright.imaging.rasterise import rasterise
from facewright.landmarks.points import Landmarks

CAMERA = Intrinsics(290.0, 290.0, 119.5, 99.5)
SIZE = (200, 240)
WALL_MM, CHEST_MM = 1200.0, 700.0
PIVOT = np.array([0.0, -60.0, -40.0])
BOX = (78, 46, 164, 160)


@cache
def face():
    return load_face("builtin")


def pose(degrees):
    """camera_from_model of a head turned by yaw about a joint in the neck, 600 mm away."""
    turn = FRONTAL @ rotation_from_vector([0.02, np.deg2rad(degrees), 0.0])
    return RigidMotion(turn, np.array([0.0, 40.0, 640.0]) - turn @ PIVOT)


def true_depth(degrees, vertices=None):
    vertices = face().mean_shape if vertices is None else vertices
    seen = pose(degrees).apply(vertices.astype(np.float64))
    depth = rasterise(CAMERA.project(seen), seen[:, 2], face().topology.faces, SIZE).depth
    scene = np.full(SIZE, WALL_MM)
    scene[165:] = CHEST_MM  # does not turn with the head
    return np.minimum(depth, scene).astype(np.float32)


def record(turns, rng, noise=1.2, vertices=None):
    frames = []
    for k, degrees in enumerate(turns):
        depth = true_depth(degrees, None if vertices is None else vertices[k])
        noisy = np.where(depth > 0, depth + rng.normal(0.0, noise, SIZE), 0.0) if noise else depth
        frames.append(RGBDFrame(np.full((*SIZE, 3), k, np.uint8), noisy.astype(np.float32), CAMERA, k / 30))
    return frames


TURNS = [0, 3, 6, 9, 12, 8, 4, 0, -4, -8, -12, -8, -4, 0]


def face_pixels(depth):
    inside = np.zeros(SIZE, bool)
    inside[BOX[1] + 8 : BOX[3] - 22, BOX[0] + 8 : BOX[2] - 8] = True
    step = np.zeros(SIZE, bool)
    step[1:-1, 1:-1] = (np.abs(depth[1:-1, 2:] - depth[1:-1, :-2]) > 8) | (
        np.abs(depth[2:, 1:-1] - depth[:-2, 1:-1]) > 8
    )
    return inside & ~step & (depth < 720)


@pytest.fixture(scope="module")
def recording():
    return record(TURNS, np.random.default_rng(4))


@pytest.fixture(scope="module")
def fused(recording):
    return fuse(recording, rectangle=BOX, reference=0)


def test_noise_falls_well_below_a_single_frame(recording, fused):
    truth = true_depth(0)
    judged = face_pixels(truth)
    assert (fused.depth[judged] > 0).mean() > 0.97
    judged &= fused.depth > 0
    raw = (recording[0].depth - truth)[judged]
    off = (fused.depth - truth)[judged]
    assert np.sqrt((off**2).mean()) < 0.6 * np.sqrt((raw**2).mean())
    assert np.median(np.abs(off)) < 0.4 * np.median(np.abs(raw))
    assert abs(np.median(off)) < 0.15


def test_motion_is_recovered_though_the_chest_stands_still(fused):
    middle = face().mean_shape[face().topology.landmarks["fw74"]].mean(axis=0)
    for degrees, motion in zip(TURNS, fused.reference_from_frame):
        true = pose(0).after(pose(degrees).inverse())
        seen = pose(degrees).apply(middle)
        assert np.rad2deg(rotation_angle(motion.rotation, true.rotation)) < 0.6
        assert np.linalg.norm(motion.apply(seen) - true.apply(seen)) < 0.6  # mm


def test_report(recording, fused):
    report = fused.report
    assert report.n_frames == report.n_fused == len(TURNS) and report.lost == ()
    assert abs(report.turn_degrees - 12.0) < 0.6
    assert 0.8 < report.raw_noise_mm < 2.5
    assert 0.5 < report.consistency_mm < 1.2  # 0.67 sigma
    assert report.drift_mm < 1.0 and report.drift_degrees < 1.0
    assert report.coverage > 0.95
    assert report.warnings == ()
    assert fused.reference == 0 and fused.rectangle == BOX
    assert np.array_equal(fused.color, recording[0].color)
    outside = np.ones(SIZE, bool)
    outside[BOX[1] : BOX[3], BOX[0] : BOX[2]] = False
    assert not fused.depth[outside].any()


def test_equal_recordings_give_equal_bits(monkeypatch, recording, fused):
    for threads in ("1", "3"):
        monkeypatch.setenv("NUMBA_NUM_THREADS", threads)
        again = fuse(iter(recording), rectangle=BOX, reference=0)
        assert np.array_equal(again.depth, fused.depth)
        for a, b in zip(again.reference_from_frame, fused.reference_from_frame):
            assert np.array_equal(a.rotation, b.rotation) and np.array_equal(a.translation, b.translation)


def test_rectangle_and_reference_from_depth_alone(rng):
    turns = [-12, -9, -6, -3, 0, 3, 6, 9, 12]
    fused = fuse(record(turns, rng))
    assert abs(turns[fused.reference]) <= 3
    left, top, right, bottom = fused.rectangle
    assert left < 95 and right > 145 and top < 70 and bottom > 140
    judged = face_pixels(true_depth(turns[fused.reference])) & (fused.depth > 0)
    assert np.median(np.abs(fused.depth - true_depth(turns[fused.reference]))[judged]) < 0.6


class Detector:
    """Finds the builtin face where frames of the recording show it, told by their grey value."""

    def __init__(self, turns, found=True):
        self.turns, self.found, self.looks = turns, found, 0

    def detect(self, image):
        self.looks += 1
        if not self.found:
            return []
        points = face().mean_shape[face().topology.landmarks["fw74"]].astype(np.float64)
        return [Landmarks("fw74", CAMERA.project(pose(self.turns[int(image[0, 0, 0])]).apply(points)))]

    def __enter__(self):
        return self

    def __exit__(self, *error):
        pass


def test_the_detector_tells_reference_and_rectangle(rng):
    turns = [10, 7, 4, 1, -2, -5, -8]
    detector = Detector(turns)
    fused = fuse(record(turns, rng), detector=detector)
    assert turns[fused.reference] in (1, -2)
    x, y = CAMERA.project(pose(0).apply(face().mean_shape[face().topology.landmarks["fw74"]].mean(axis=0)))
    left, top, right, bottom = fused.rectangle
    assert left < x < right and top < y < bottom
    assert detector.looks <= 8


def test_what_stood_still_in_the_rectangle_is_dropped(rng):
    tall = (BOX[0], BOX[1], BOX[2], 195)  # down to the chest
    fused = fuse(record(TURNS, rng, noise=0.5), rectangle=tall, reference=0)
    chest = fused.depth[172:190, BOX[0] + 10 : BOX[2] - 10]
    assert (np.abs(chest[chest > 0] - CHEST_MM) < 5.0).all()
    judged = face_pixels(true_depth(0)) & (fused.depth > 0)
    assert np.median(np.abs(fused.depth - true_depth(0))[judged]) < 0.4


def test_one_frame_is_smoothed_with_a_warning(rng):
    frames = record([0], rng)
    fused = fuse(frames, rectangle=BOX)
    assert fused.report.n_frames == 1 and "one frame only" in fused.report.warnings[0]
    truth = true_depth(0)
    judged = face_pixels(truth) & (fused.depth > 0)
    off, raw = (fused.depth - truth)[judged], (frames[0].depth - truth)[judged]
    assert np.sqrt((off**2).mean()) < 0.7 * np.sqrt((raw**2).mean())


def test_a_moving_expression_is_told(rng):
    weights = np.linspace(0.0, 1.0, 9)
    shape = face().blendshape_deltas[face().blendshape_names.index("jawOpen")]
    vertices = [face().mean_shape + w * shape for w in weights]
    frames = record([0, 2, 4, 6, 8, 6, 4, 2, 0], rng, vertices=vertices)
    lenient = FusionOptions(most_unsteady_mm=np.inf)
    fused = fuse(frames, rectangle=BOX, reference=4, options=lenient)
    assert any("expression was not held" in warning for warning in fused.report.warnings)
    assert fused.report.unsteady_mm > FusionOptions().most_unsteady_mm
    with pytest.raises(DegenerateError, match=r"must show a held expression, got frames that differ by .* in places"):
        fuse(frames, rectangle=BOX, reference=4)


def test_frames_without_depth_are_lost_and_nothing_else(rng, recording):
    frames = list(recording)
    empty = np.zeros(SIZE, np.float32)
    frames[5] = RGBDFrame(frames[5].color, empty, CAMERA, frames[5].time)
    fused = fuse(frames, rectangle=BOX, reference=0)
    assert fused.report.lost == (5,) and fused.reference_from_frame[5] is None
    assert fused.report.n_fused == len(frames) - 1


def test_a_head_that_jumps_is_refused(rng):
    frames = record([0], rng)
    other = np.roll(frames[0].depth, 70, axis=1)
    frames += [RGBDFrame(frames[0].color, other, CAMERA) for _ in range(5)]
    with pytest.raises(DegenerateError, match="of 6 frames that lie on one surface"):
        fuse(frames, rectangle=BOX, reference=0)


def test_no_face(rng):
    empty = [RGBDFrame(np.zeros((*SIZE, 3), np.uint8), np.zeros(SIZE, np.float32), CAMERA)] * 3
    with pytest.raises(NoFaceError, match="must have depth of a head"):
        fuse(empty)
    with pytest.raises(NoFaceError, match="must have depth in the face rectangle"):
        fuse(empty, rectangle=BOX)
    with pytest.raises(NoFaceError, match="the detector found none in 3 of its 3 frames"):
        fuse(record([0, 1, 2], rng), detector=Detector([0, 1, 2], found=False))


def test_arguments_out_of_range(rng):
    frames = record([0, 1], rng)
    with pytest.raises(ValueRangeError, match="at least one frame"):
        fuse([])
    for reference in (-1, 2):
        with pytest.raises(ValueRangeError, match=r"reference must be a frame in \[0, 2\)"):
            fuse(frames, reference=reference)
    for bad in ((0, 0, 5, 5), (500, 500, 600, 600), (0, 0, 100), (0.0, np.nan, 100, 100)):
        with pytest.raises(ValueRangeError, match="rectangle must"):
            fuse(frames, rectangle=bad, reference=0)
    small = RGBDFrame(np.zeros((50, 60, 3), np.uint8), np.full((50, 60), 600, np.float32), CAMERA)
    with pytest.raises(ShapeError, match="frames must be of one size"):
        fuse([*frames, small], rectangle=BOX, reference=0)


def test_too_inconsistent_frames_are_refused(rng):
    with pytest.raises(DegenerateError, match="must show a held expression"):
        fuse(
            record([0, 1, 2, 3, 4, 5], rng), rectangle=BOX, reference=0, options=FusionOptions(most_consistency_mm=0.1)
        )


def test_progress(recording):
    seen = []
    fuse(recording[:4], rectangle=BOX, reference=0, progress=lambda *a: seen.append(a))
    assert (
        ("reading frames", 4, 4) in seen and ("tracking frames", 4, 4) in seen and seen[-1] == ("refining poses", 4, 4)
    )


def test_rectangle_from_depth_needs_a_head():
    depth = np.zeros(SIZE, np.float32)
    depth[10:14, 10:14] = 500.0
    with pytest.raises(NoFaceError, match="depth of a head"):
        rectangle_from_depth(depth, CAMERA, 3)


def test_the_region_ends_behind_the_head():
    region = head_region(true_depth(0), CAMERA, BOX, 0)
    kept = region.keep(true_depth(0), CAMERA, RigidMotion(np.eye(3), np.zeros(3)))
    assert kept.any() and kept.max() < WALL_MM - 100


def test_middle_of_turn_ignores_lost_frames():
    motions = [
        None if k == 2 else RigidMotion(rotation_from_vector([0.0, 0.1 * k, 0.0]), np.zeros(3)) for k in range(7)
    ]
    assert middle_of_turn(motions) == 3


def test_most_frontal_takes_the_frame_that_looks_ahead(rng):
    turns = [-9, 9, 5, 0, 4]
    assert most_frontal(FrameList(record(turns, rng, noise=0)), Detector(turns)).number == 3


class FrameList:
    def __init__(self, frames):
        self.all, self.n_frames = frames, len(frames)

    def frame(self, i):
        return self.all[i]


@pytest.mark.slow
def test_the_real_mannequin_agrees_with_another_program(test_data):
    """All frames, turned ear to ear; distances from `Expected.ply`, a cloud fused by another program."""
    from scipy.spatial import cKDTree

    from facewright.camera.depth_map import back_project
    from facewright.capture.recording import open_recording
    from facewright.io.ply import read_ply_elements

    folder = test_data / "truedepth_mannequin"
    fused = fuse(open_recording(folder, quarter_turns=3))
    assert fused.report.lost == () and fused.report.coverage > 0.95
    assert fused.report.turn_degrees > 40
    points = back_project(fused.depth, fused.intrinsics).reshape(-1, 3)
    points = points[np.isfinite(points).all(axis=1)]
    vertex = read_ply_elements(folder / "Expected.ply")["vertex"]
    expected = np.stack([vertex[c] for c in "xyz"], axis=1).astype(float) * 1000.0
    normals = np.stack([vertex[c] for c in ("nx", "ny", "nz")], axis=1).astype(float)
    tree = cKDTree(expected)
    motion = _align(points, expected, tree)
    moved = motion.apply(points)
    distance, nearest = tree.query(moved)
    assert (distance < 2.0).mean() > 0.95  # mm; to points about 1 mm apart
    along = np.abs(((moved - expected[nearest]) * normals[nearest]).sum(axis=1))
    assert np.median(along) < 0.5


def _align(points, expected, tree):
    """Rigid motion by ICP from the 24 turns of the axes onto themselves (the cloud has a frame of its own)."""
    from itertools import permutations, product

    best = (np.inf, None)
    for axes, signs in product(permutations(range(3)), product((1.0, -1.0), repeat=3)):
        R = np.zeros((3, 3))
        R[range(3), axes] = signs
        if np.linalg.det(R) < 0:
            continue
        found = _icp(points[::40], expected, tree, RigidMotion(R, expected.mean(axis=0) - R @ points.mean(axis=0)), 40)
        middle = np.median(tree.query(found.apply(points[::40]))[0])
        if middle < best[0]:
            best = (middle, found)
    return _icp(points[::4], expected, tree, best[1], 30)


def _icp(points, expected, tree, motion, rounds):
    for k in range(rounds):
        distance, nearest = tree.query(motion.apply(points))
        good = distance < max(40.0 * 0.85**k, 4.0) if rounds == 40 else distance < 4.0
        if good.sum() < 10:
            return motion
        a, b = points[good], expected[nearest[good]]
        U, _, Vt = np.linalg.svd((a - a.mean(axis=0)).T @ (b - b.mean(axis=0)))
        R = Vt.T @ np.diag([1, 1, np.sign(np.linalg.det(Vt.T @ U.T))]) @ U.T
        motion = RigidMotion(R, b.mean(axis=0) - R @ a.mean(axis=0))
    return motion
