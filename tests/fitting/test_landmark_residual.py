import numpy as np
import pytest

from facewright.camera.pinhole import Intrinsics, RigidMotion
from facewright.camera.rotation import rotation_from_head_angles
from facewright.errors import DegenerateError, ShapeError, ValueRangeError
from facewright.fitting.landmark_residual import Anchors, CarriedResidual, LandmarkResidual, smooth_field

SIZE = (640, 640)
CAMERA = Intrinsics.for_image(SIZE, 1400.0)


def pose(yaw=0.0, pitch=0.0, roll=0.0):
    rotation = rotation_from_head_angles(yaw, pitch, roll)
    return RigidMotion(rotation, np.array([5.0, -8.0, 900.0]) - rotation @ [0, 0, 40.0])


@pytest.fixture(scope="module")
def anchors(builtin_face):
    ids = builtin_face.topology.landmarks["fw74"][15:]
    return Anchors.at_vertices(ids, np.full(len(ids), 0.3))


@pytest.fixture(scope="module")
def adjust(builtin_face, anchors):
    return LandmarkResidual(builtin_face, anchors)


def project(points, motion):
    return CAMERA.project(motion.apply(points))


def smooth_truth(points):
    """A displacement parallel to the image plane of a frontal camera, millimetres, that a field can hold."""
    x, y, _ = points.T / 60.0
    return np.stack([1.5 * np.sin(x + 0.4), 1.2 * np.cos(y - 0.3) - 0.5 * x, np.zeros_like(x)], axis=1)


def test_meets_the_points_and_recovers_a_smooth_displacement(builtin_face, adjust, anchors):
    rest = builtin_face.mean_shape.astype(np.float64)
    truth = smooth_truth(rest)
    motion = pose()
    found = adjust.displacement(rest, project(rest + truth, motion)[anchors.corners[:, 0]], CAMERA, motion)
    at = anchors.corners[:, 0]
    assert np.linalg.norm(found[at] - truth[at], axis=1).max() < 0.15
    between = np.concatenate([builtin_face.topology.masks[k] for k in ("lips", "nose", "brow_left", "brow_right")])
    error = np.linalg.norm(found[between] - truth[between], axis=1)
    assert error.max() < 1.0 and error.mean() < 0.25  # truth: up to 2 mm


def test_fades_beyond_the_face(builtin_face, adjust, anchors):
    rest = builtin_face.mean_shape.astype(np.float64)
    found = adjust.displacement(rest, project(rest + [2.0, 0, 0], pose())[anchors.corners[:, 0]], CAMERA, pose())
    low = np.argsort(rest[: builtin_face.n_skin, 1])[:60]  # the neck's base
    ears = builtin_face.topology.masks["ears"]
    assert np.abs(found[low]).max() < 0.05
    assert np.abs(found[ears]).max() < 0.8
    assert np.abs(found[anchors.corners[:, 0], 0]).min() > 1.8


def test_turns_and_scales_with_the_head(builtin_face, adjust, anchors):
    rest = builtin_face.mean_shape.astype(np.float64)
    motion = pose(12, -8, 5)
    shift = np.array([3.0, -2.0])
    at = anchors.corners[:, 0]
    found = adjust.displacement(rest, project(rest, motion)[at] + shift, CAMERA, motion)
    quarter = np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
    turned = RigidMotion(quarter @ motion.rotation, 0.5 * quarter @ motion.translation)  # a quarter turn, half as far
    moved = project(rest + found, turned)[at] - project(rest, turned)[at]
    straight = project(rest + found, motion)[at] - project(rest, motion)[at]
    near = np.stack([-straight[:, 1], straight[:, 0]], axis=1)
    depth = motion.apply(rest[at])[:, 2] / turned.apply(rest[at])[:, 2]
    np.testing.assert_allclose(moved, near * depth[:, None], atol=0.02)


def test_one_bad_point_does_not_matter(builtin_face, adjust, anchors, rng):
    rest = builtin_face.mean_shape.astype(np.float64)
    at = anchors.corners[:, 0]
    clean = project(rest + smooth_truth(rest), pose())[at] + rng.normal(0, 0.15, (len(at), 2))
    good = adjust.displacement(rest, clean, CAMERA, pose())
    for bad in (3, 20, 45):
        pixels = clean.copy()
        pixels[bad] += [18.0, -14.0]
        found = adjust.displacement(rest, pixels, CAMERA, pose())
        assert np.linalg.norm(found - good, axis=1).max() < 1.0  # the point itself is off by 15 mm


def test_missing_points_are_left_out(builtin_face, adjust, anchors):
    rest = builtin_face.mean_shape.astype(np.float64)
    pixels = project(rest, pose())[anchors.corners[:, 0]]
    present = np.ones(len(pixels), bool)
    present[::3] = False
    pixels[~present] = 1e9
    assert np.abs(adjust.displacement(rest, pixels, CAMERA, pose(), present)).max() < 1e-9
    present[7:] = False
    with pytest.raises(DegenerateError, match="at least 8 landmarks"):
        adjust.displacement(rest, pixels, CAMERA, pose(), present)


def test_refuses_bad_pixels(builtin_face, adjust, anchors):
    rest = builtin_face.mean_shape
    with pytest.raises(ShapeError):
        adjust.displacement(rest, np.zeros((3, 2)), CAMERA, pose())
    with pytest.raises(ValueRangeError):
        adjust.displacement(rest, np.full((len(anchors), 2), np.nan), CAMERA, pose())


def test_eyeballs_and_teeth_move_whole(builtin_face, adjust, anchors):
    rest = builtin_face.mean_shape.astype(np.float64)
    found = adjust.displacement(rest, project(rest + smooth_truth(rest), pose())[anchors.corners[:, 0]], CAMERA, pose())
    for part in ("eyeball_left", "eyeball_right", "teeth_upper", "teeth_lower"):
        moved = found[builtin_face.topology.part_slice(part)]
        assert np.ptp(moved, axis=0).max() < 1e-12 and np.linalg.norm(moved[0]) > 0.1
    lids = np.concatenate([builtin_face.topology.masks[f"eyelid_{k}_left"] for k in ("upper", "lower")])
    np.testing.assert_allclose(
        found[builtin_face.topology.part_slice("eyeball_left")][0], found[lids].mean(axis=0), atol=1e-9
    )


def test_carried_residual_is_itself_on_the_source_and_lets_lips_and_lids_meet(builtin_face, adjust, anchors):
    rest, names = builtin_face.mean_shape.astype(np.float64), builtin_face.blendshape_names
    jaw = 0.4 * builtin_face.blendshape_deltas[names.index("jawOpen")]
    source = rest + jaw
    at = anchors.corners[:, 0]
    pixels = project(source, pose())[at]
    lower = np.isin(np.arange(15, 74)[: len(at)], [60, 61, 62, 63, 64, 65, 71, 72, 73])
    pixels[lower, 1] += 2.5  # the photo's mouth is opened wider than the fit's
    found = adjust.displacement(source, pixels, CAMERA, pose())
    carried = CarriedResidual(builtin_face, found, source)
    assert np.array_equal(carried.at(source), found)
    masks = builtin_face.topology.masks

    def gap(vertices):
        moved = vertices + carried.at(vertices)
        return (moved[masks["lip_contact_upper"]] - moved[masks["lip_contact_lower"]])[:, 1]

    assert gap(source).max() > (source[masks["lip_contact_upper"]] - source[masks["lip_contact_lower"]])[:, 1].max() + 1
    rest_gap = (rest[masks["lip_contact_upper"]] - rest[masks["lip_contact_lower"]])[:, 1]
    assert np.abs(gap(rest) - rest_gap).max() < 0.1
    wider = rest + 0.8 * builtin_face.blendshape_deltas[names.index("jawOpen")]
    assert np.array_equal(carried.at(wider), found)  # opening further leaves it as it is


def test_works_on_a_face_with_loose_parts(ict_face):
    field = smooth_field(ict_face)
    rest = ict_face.mean_shape.astype(np.float64)
    ids = ict_face.topology.landmarks["fw74"][15:]
    anchors = Anchors.at_vertices(ids, np.full(len(ids), 0.3))
    found = LandmarkResidual(ict_face, anchors).displacement(
        rest, project(rest + [0, 1.0, 0], pose())[ids], CAMERA, pose()
    )
    lashes = found[ict_face.topology.part_slice("eyelashes_left")]
    np.testing.assert_allclose(lashes[:, 1], 1.0, atol=0.25)  # they stay at the lids
    tongue = found[ict_face.topology.part_slice("gums_and_tongue")]
    assert np.linalg.norm(tongue, axis=1).max() < 1.5
    assert field is smooth_field(ict_face)
