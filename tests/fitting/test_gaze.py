import numpy as np
import pytest

from facewright.camera.pinhole import Intrinsics, RigidMotion
from facewright.camera.rotation import rotation_from_head_angles
from facewright.errors import ShapeError
from facewright.fitting.gaze import SIDES, Eyeballs, eyeball_of, find_gaze, gaze_of_axis, turn_of_gaze

CAMERA = Intrinsics.for_image((640, 640), 1400.0)


def pose(*angles):
    rotation = rotation_from_head_angles(*angles)
    return RigidMotion(rotation, np.array([5.0, -8.0, 700.0]) - rotation @ [0, 0, 40.0])


def turned(face, gaze):
    vertices = face.mean_shape.astype(np.float64)
    Eyeballs(face, vertices.copy()).turn(vertices, np.asarray(gaze))
    return vertices


def irises(face, vertices, motion):
    return np.stack(
        [CAMERA.project(motion.apply(vertices[face.topology.masks[f"iris_{s}"]].mean(axis=0))) for s in SIDES]
    )


def test_gaze_convention():
    ahead = np.array([0.0, 0.0, 1.0])
    assert (turn_of_gaze(0.3, 0.0) @ ahead)[0] > 0.29  # yaw towards the subject's left, +x
    assert (turn_of_gaze(0.0, 0.3) @ ahead)[1] > 0.29  # pitch upwards
    np.testing.assert_allclose(gaze_of_axis(turn_of_gaze(0.31, -0.22) @ ahead), (0.31, -0.22), atol=1e-12)


@pytest.mark.parametrize("name", ["builtin_face", "ict_face"])
@pytest.mark.parametrize("angles", [(0, 0, 0), (25, -10, 8)])
def test_recovers_a_known_gaze(name, angles, request):
    face = request.getfixturevalue(name)
    truth = np.array([[0.20, -0.15], [0.12, 0.10]])
    motion = pose(*angles)
    vertices = turned(face, truth)
    found = find_gaze(face, face.mean_shape, irises(face, vertices, motion), CAMERA, motion)
    assert np.abs(np.rad2deg(found - truth)).max() < 0.5


def test_eyeballs_keep_shape_place_and_zero_is_straight(builtin_face):
    straight, aside = turned(builtin_face, np.zeros((2, 2))), turned(builtin_face, [[0.4, 0.1], [0.4, 0.1]])
    for k, side in enumerate(SIDES):
        ids = eyeball_of(builtin_face, side)
        a, b = straight[ids], aside[ids]
        np.testing.assert_allclose(
            np.linalg.norm(a[:, None] - a[None, :20], axis=2), np.linalg.norm(b[:, None] - b[None, :20], axis=2)
        )
        iris = straight[builtin_face.topology.masks[f"iris_{side}"]].mean(axis=0)
        assert np.allclose(a.mean(axis=0)[1], b.mean(axis=0)[1], atol=1.5) and k in (0, 1)
        assert iris[2] > a[:, 2].mean()


def test_unknown_irises_take_the_other_eye_or_look_ahead(builtin_face):
    motion = pose(0, 0, 0)
    seen = irises(builtin_face, turned(builtin_face, [[0.2, 0.1], [0.2, 0.1]]), motion)
    seen[0] = np.nan
    found = find_gaze(builtin_face, builtin_face.mean_shape, seen, CAMERA, motion)
    np.testing.assert_array_equal(found[0], found[1])
    none = find_gaze(builtin_face, builtin_face.mean_shape, np.full((2, 2), np.nan), CAMERA, motion)
    np.testing.assert_array_equal(none, np.zeros((2, 2)))


def test_an_iris_beside_the_eye_stays_in_reach(builtin_face):
    motion = pose(0, 0, 0)
    far = irises(builtin_face, builtin_face.mean_shape.astype(float), motion) + [400.0, 0.0]
    found = find_gaze(builtin_face, builtin_face.mean_shape, far, CAMERA, motion)
    assert np.isfinite(found).all() and np.abs(found).max() <= np.pi / 4 + 1e-9


def test_refuses_other_shapes(builtin_face):
    with pytest.raises(ShapeError):
        find_gaze(builtin_face, builtin_face.mean_shape, np.zeros((3, 2)), CAMERA, pose(0, 0, 0))
    with pytest.raises(ShapeError):
        turned(builtin_face, np.zeros(2))
