import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from facewright.camera.rotation import rotation_from_vector
from facewright.errors import NoFaceError, ValueRangeError
from facewright.fitting.scan_placement import (
    UNITS,
    decide_unit,
    drop_loose_pieces,
    drop_spikes,
    face_outwards,
    place_face,
    scan_target,
    weld,
)
from facewright.landmarks.scheme import load_scheme
from facewright.mesh.normals import face_area_vectors


def marks_of(face, vertices):
    landmarks = vertices[face.topology.landmarks["fw74"]].astype(np.float64)
    landmarks[load_scheme("fw74").sliding] = np.nan
    return landmarks, np.isfinite(landmarks[:, 0]).astype(np.float64)


@settings(max_examples=30, deadline=None)
@given(size=st.floats(0.75, 1.35), unit=st.sampled_from(list(UNITS)))
def test_the_unit_is_the_one_of_human_size(size, unit):
    name, found = decide_unit(size / UNITS[unit])
    assert name == unit
    assert found == pytest.approx(size)


@pytest.mark.parametrize("factor", [0.02, 0.2, 3.9, 5e4, 1e-7])
def test_sizes_that_are_no_face_are_refused(factor):
    with pytest.raises(ValueRangeError, match="size of a mean face"):
        decide_unit(factor)


def test_a_given_unit_must_fit(builtin_face):
    assert decide_unit(0.1, "cm") == ("cm", pytest.approx(1.0))
    with pytest.raises(ValueRangeError, match=r"0\.0394 times in in|2\.54 times in in"):
        decide_unit(0.1, "in")
    with pytest.raises(ValueRangeError, match="unit"):
        decide_unit(0.1, "ell")


@pytest.mark.parametrize("unit", list(UNITS))
def test_pose_and_unit_are_recovered(builtin_face, rng, unit):
    R, t = rotation_from_vector(rng.normal(size=3)), rng.normal(size=3)
    scale = 1.0 / UNITS[unit]
    moved = scale * (1.1 * builtin_face.mean_shape @ R.T + 300 * t)
    landmarks, confidence = marks_of(builtin_face, moved)
    placement = place_face(builtin_face, landmarks, confidence)
    assert placement.unit == unit
    assert placement.size == pytest.approx(1.1, abs=1e-4)
    assert placement.landmark_rms_mm < 1e-3
    found = placement.scan_from_model.apply(1.1 * builtin_face.mean_shape)
    np.testing.assert_allclose(found * UNITS[unit], moved * UNITS[unit], atol=1e-2)
    assert placement.scan_from_model.scale == scale


def test_what_is_no_face_is_refused(builtin_face, rng):
    landmarks, confidence = marks_of(builtin_face, builtin_face.mean_shape)
    with pytest.raises(NoFaceError, match="as those of a face"):
        place_face(builtin_face, rng.permuted(landmarks, axis=0), confidence)
    with pytest.raises(NoFaceError, match=r"as those of a face|0\.\d\d times"):
        place_face(builtin_face, landmarks * [1, 1, 0.0], confidence)  # a photograph
    with pytest.raises(NoFaceError, match=r"0\.4\d times: a flat picture or a squeezed scan"):
        place_face(builtin_face, landmarks * [1, 1, 0.4], confidence)
    with pytest.raises(NoFaceError, match=r"as those of a face|-\d"):
        place_face(builtin_face, landmarks * [1, 1, -1], confidence)  # a hollow
    with pytest.raises(NoFaceError, match="at least 4"):
        place_face(builtin_face, landmarks, np.where(np.arange(74) < 18, confidence, 0))
    with pytest.raises(NoFaceError, match="one line"):
        place_face(builtin_face, np.outer(np.arange(74.0), [1, 2, 3]), confidence)
    with pytest.raises(NoFaceError, match=r"one line|extent"):
        place_face(builtin_face, np.ones((74, 3)), confidence)


def test_exchanged_sides_are_named(builtin_face):
    mirror = load_scheme("fw74").mirror
    landmarks, confidence = marks_of(builtin_face, builtin_face.mean_shape)
    with pytest.raises(NoFaceError, match="left and right are exchanged"):
        place_face(builtin_face, landmarks[mirror], confidence)


def test_the_target_is_the_head_in_model_space(builtin_face, rng):
    face = builtin_face.skin()
    R = rotation_from_vector(rng.normal(size=3))
    scan = 0.001 * (face.mean_shape @ R.T) + [1.0, 2.0, 3.0]
    far = np.concatenate([scan, scan[:50] + 2.0])  # loose pieces elsewhere
    faces = np.concatenate([face.topology.faces, [[len(scan), len(scan) + 1, len(scan) + 2]], [[0, 1, len(scan)]]])
    landmarks, confidence = marks_of(face, scan)
    placement = place_face(face, landmarks, confidence)
    for triangles in (faces, faces[:, ::-1]):
        target = scan_target(far, triangles, placement, landmarks, confidence)
        near = np.linalg.norm(face.mean_shape - target.landmarks[16:].mean(axis=0), axis=1).min()
        assert near < 60.0
        assert np.abs(target.points).max() < 350.0
        nose = target.landmarks[45]
        nearest = np.linalg.norm(target.points - nose, axis=1).argmin()
        assert target.normals[nearest, 2] > 0.5  # outwards, whatever the file's triangles say
        np.testing.assert_allclose(
            target.landmarks[16:27], face.mean_shape[face.topology.landmarks["fw74"][16:27]], atol=0.05
        )


def test_a_scan_without_surface_at_the_landmarks_is_refused(builtin_face):
    face = builtin_face.skin()
    landmarks, confidence = marks_of(face, face.mean_shape)
    placement = place_face(face, landmarks, confidence)
    with pytest.raises(NoFaceError, match="surface around the landmarks"):
        scan_target(face.mean_shape + [0, 0, 900.0], face.topology.faces, placement, landmarks, confidence)


def test_a_soup_of_triangles_is_welded():
    points = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0.0]])
    joined, faces = weld(points, np.array([[0, 1, 2], [3, 4, 5], [0, 1, 1]]))
    assert len(joined) == 4
    assert len(faces) == 2
    np.testing.assert_allclose(joined[faces], points[[[0, 1, 2], [3, 4, 5]]])


def test_spikes_and_crumbs_go(builtin_face):
    points, faces = builtin_face.mean_shape.astype(np.float64), builtin_face.skin().topology.faces
    usual = drop_spikes(points, faces)
    assert len(usual) > 0.99 * len(faces)  # long triangles close the built-in face's neck
    spiky = points.copy()
    spiky[usual[100, 0]] += [0, 0, 80.0]
    touched = (usual == usual[100, 0]).any(axis=1)
    assert 3 <= touched.sum() <= 8
    np.testing.assert_array_equal(drop_spikes(spiky, usual), usual[~touched])
    crumb = np.concatenate([faces, [[len(points), len(points) + 1, len(points) + 2]]])
    with_crumb = np.concatenate([points, [[0, 0, 200.0], [3, 0, 200], [0, 3, 200]]])
    assert len(drop_loose_pieces(with_crumb, crumb)) == len(faces)
    soup = np.arange(3 * len(faces)).reshape(-1, 3)
    assert len(drop_loose_pieces(points[faces].reshape(-1, 3), soup)) == len(faces)


def test_triangles_are_turned_outwards(builtin_face, rng):
    points, faces = builtin_face.mean_shape.astype(np.float64), builtin_face.skin().topology.faces
    middle = np.array([0.0, 0.0, 20.0])
    np.testing.assert_array_equal(face_outwards(points, faces, middle), faces)
    np.testing.assert_array_equal(face_outwards(points, faces[:, ::-1], middle)[:, ::-1], faces[:, ::-1])
    mixed = np.where((rng.random(len(faces)) < 0.5)[:, None], faces, faces[:, ::-1])
    turned = face_outwards(points, mixed, middle)
    outwards = (face_area_vectors(points, turned) * (points[turned].mean(axis=1) - middle)).sum(axis=1)
    assert (outwards >= 0).all()
