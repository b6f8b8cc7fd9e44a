from dataclasses import replace

import numpy as np
import pytest

from facewright.camera.rotation import rotation_from_head_angles
from facewright.errors import ShapeError, TopologyError
from facewright.landmarks.dense import dense_points, head_plane, pose_terms
from facewright.landmarks.scheme import load_scheme


def check_measured(face):
    for mesh in (face, face.skin()):
        points = dense_points(mesh.topology)
        assert points.n_points == 478 and points.blendshape_names == face.blendshape_names
        assert points.vertices.max() < face.n_skin
    at = face.mean_shape[points.vertices]
    scheme = load_scheme("mediapipe478")
    # the points lie where their names say: mirror images, and near the marked landmarks
    distance = np.linalg.norm(at[scheme.mirror] * [-1, 1, 1] - at, axis=1)
    assert np.median(distance[:468]) < 4.0
    right, left = at[scheme.groups["right_eye"]].mean(axis=0), at[scheme.groups["left_eye"]].mean(axis=0)
    assert right[0] < -20 and left[0] > 20 and abs(right[1] - left[1]) < 5
    lip = at[scheme.groups["inner_mouth"]].mean(axis=0)
    assert abs(lip[0]) < 3 and lip[1] < right[1] - 40
    # directions are in units of their noise and independent of the order of magnitude of a millimetre
    assert np.isfinite(points.whitening).all() and points.whitening.shape == (160, 956)
    # the detector sees less of a blink than there is
    blink = face.blendshape_names.index("eyeBlink_R")
    upper = [160, 159, 158]
    assert points.expression_response[blink, upper, 1].mean() < -1.0


def test_measured_builtin_face(builtin_face):
    check_measured(builtin_face)


def test_measured_ict_face(ict_face):
    check_measured(ict_face)


def test_other_meshes_use_their_marked_landmarks(builtin_face):
    topology = builtin_face.topology
    other = replace(topology, faces=topology.faces[::-1].copy(), name="mine")
    points = dense_points(other)
    scheme = load_scheme("fw74")
    np.testing.assert_array_equal(points.vertices, topology.landmarks["fw74"][scheme.fixed])
    np.testing.assert_allclose(points.sources.sum(axis=1), 1.0)
    with pytest.raises(TopologyError, match="fw74"):
        dense_points(replace(other, landmarks={}))


def test_the_plane_turns_with_the_head():
    upright = head_plane(rotation_from_head_angles(0, 0, 0), 2.0)
    np.testing.assert_allclose(upright, np.eye(2) / 2.0, atol=1e-12)
    leaned = rotation_from_head_angles(0, 0, 30)
    down = -leaned[:2, 1]
    np.testing.assert_allclose(head_plane(leaned, 1.0) @ down, [0, 1], atol=1e-12)
    assert np.linalg.det(head_plane(leaned, 1.0)) == pytest.approx(1.0)


def test_pose_terms_of_a_frontal_head_are_constant():
    np.testing.assert_allclose(pose_terms(rotation_from_head_angles(0, 0, 0)), [0, 0, -0.1, -0.03, 0, 0], atol=1e-12)
    assert pose_terms(np.tile(np.eye(3), (4, 1, 1))).shape == (4, 6)


def test_refuses_arrays_that_do_not_match(builtin_face):
    points = dense_points(builtin_face.topology)
    with pytest.raises(ShapeError):
        replace(points, offset=np.zeros((3, 2)))
