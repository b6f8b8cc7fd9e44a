import importlib.util
from pathlib import Path

import numpy as np
import pytest

from facewright.deform.deformation_transfer import (
    DeformationTransfer,
    temporal_roughness,
    transfer_deformation,
)
from facewright.errors import ShapeError, ValueRangeError
from facewright.mesh.areas import face_areas
from facewright.mesh.random_field import smooth_random_field
from facewright.numeric.rotation import matrix_from_quaternion, matrix_from_rotation_vector

_spec = importlib.util.spec_from_file_location("reference_deform", Path(__file__).with_name("reference_deform.py"))
reference = importlib.util.module_from_spec(_spec)
_spec.loader.exec_module(reference)


def centred(x):
    return x - x.mean(axis=-2, keepdims=True)


@pytest.mark.parametrize("weighting", ["uniform", "area"])
def test_equals_the_printed_system_with_fourth_vertices(patch, rng, weighting):
    source, faces = patch(rng, 4)
    target = patch(rng, 4)[0] * [1.2, 0.9, 1.0]
    deformed = source + smooth_random_field(source, 20, 5, rng)
    weights = np.ones(len(faces)) if weighting == "uniform" else face_areas(target, faces)
    found = DeformationTransfer(source, target, faces, weighting=weighting).transfer(deformed)
    expected = reference.transfer_with_fourth_vertices(source, deformed, target, faces, weights)
    np.testing.assert_allclose(centred(found), centred(expected), atol=1e-8)


def test_same_mesh_reproduces_and_rest_stays_at_rest(patch, rng):
    source, faces = patch(rng)
    target = patch(rng)[0]
    poses = source + smooth_random_field(source, 20, 5, rng, n_fields=3)
    np.testing.assert_allclose(transfer_deformation(source, poses, source, faces), poses, atol=1e-9)
    np.testing.assert_allclose(transfer_deformation(source, source, target, faces), target, atol=1e-12)


def test_a_rigid_motion_of_the_source_moves_the_target_rigidly(patch, rng):
    source, faces = patch(rng)
    target = patch(rng)[0] + [0, 50, 0]
    R = matrix_from_rotation_vector(rng.normal(size=3))
    transfer = DeformationTransfer(source, target, faces)
    moved = transfer.transfer(source @ R.T + [5, 6, 7])
    np.testing.assert_allclose(centred(moved), centred(target) @ R.T, atol=1e-8)
    shifted = transfer.transfer(source + [5, 6, 7])
    np.testing.assert_allclose(shifted, target + [5, 6, 7], atol=1e-8)


def test_turning_source_and_target_turns_the_result(patch, rng):
    source, faces = patch(rng)
    target = patch(rng)[0]
    deformed = source + smooth_random_field(source, 20, 5, rng)
    R = matrix_from_quaternion(rng.normal(size=4))
    plain = transfer_deformation(source, deformed, target, faces)
    turned = transfer_deformation(source @ R.T + 3, deformed @ R.T + 3, target @ R.T - 8, faces)
    np.testing.assert_allclose(turned, plain @ R.T - 8, atol=1e-8)


def test_a_larger_target_moves_more(patch, rng):
    source, faces = patch(rng)
    deformed = source + smooth_random_field(source, 20, 5, rng)
    found = transfer_deformation(source, deformed, 2 * source, faces)
    np.testing.assert_allclose(centred(found), centred(2 * deformed), atol=1e-8)


def test_still_vertices_of_the_source_hold_the_target_in_place(patch, rng):
    source, faces = patch(rng, 8)
    target = source * [1.1, 0.9, 1.0]
    deformed = source.copy()
    corner = np.linalg.norm(source - source[0], axis=1) < 20
    deformed[corner] += [0, 0, 6]
    found = transfer_deformation(source, deformed, target, faces)
    far = np.linalg.norm(source - source[0], axis=1) > 60
    assert np.abs(found - target)[far].max() < 0.3


def test_components_are_placed_one_by_one(patch, rng):
    source, faces = patch(rng, 3)
    V = len(source)
    both = np.concatenate([source, source + 500, [[0.0, 0, 900]]])
    triangles = np.concatenate([faces, faces + V])
    deformed = both.copy()
    deformed[V : 2 * V] += [1, 2, 3]
    deformed[-1] += [0, 0, 4]
    found = transfer_deformation(both, deformed, both * 1.5, triangles)
    np.testing.assert_allclose(found - 1.5 * both, deformed - both, atol=1e-8)


def test_anchors_choose_who_holds_still(patch, rng):
    source, faces = patch(rng)
    target = patch(rng)[0]
    deformed = source + smooth_random_field(source, 20, 5, rng)
    anchors = np.array([3, 4])
    found = DeformationTransfer(source, target, faces, anchors=anchors).transfer(deformed)
    expected = (deformed - source)[anchors].mean(axis=0)
    np.testing.assert_allclose((found - target)[anchors].mean(axis=0), expected, atol=1e-9)


def test_triangles_without_area_are_left_out(patch, rng):
    source, faces = patch(rng, 3)
    target = patch(rng, 3)[0]
    spoilt = np.concatenate([faces, [[0, 0, 1], [2, 2, 2]]])
    deformed = source + smooth_random_field(source, 20, 5, rng)
    np.testing.assert_allclose(
        transfer_deformation(source, deformed, target, spoilt),
        transfer_deformation(source, deformed, target, faces),
        atol=1e-12,
    )
    collapsed = transfer_deformation(source, source * 0, target, faces)
    assert np.isfinite(collapsed).all()


def test_batches_shapes_and_dtypes(patch, rng):
    source, faces = patch(rng, 4)
    transfer = DeformationTransfer(source, patch(rng, 4)[0], faces)
    poses = source + smooth_random_field(source, 20, 5, rng, n_fields=5)
    together = transfer.transfer(poses)
    np.testing.assert_allclose(together[3], transfer.transfer(poses[3]), atol=1e-10)
    assert transfer.transfer(poses.astype(np.float32)).dtype == np.float32
    assert transfer.transfer(poses[:0]).shape == (0, len(source), 3)


def jittering_sequence(source, rng, T=12):
    path = np.sin(np.linspace(0, 2, T))[:, None, None]
    motion = smooth_random_field(source, 20, 5, rng)
    return source + path * motion + smooth_random_field(source, 20, 0.5, rng, n_fields=T)


def test_the_temporal_term_solves_its_equation_and_smooths(patch, rng):
    source, faces = patch(rng, 5)
    target = patch(rng, 5)[0]
    frames = jittering_sequence(source, rng)
    transfer = DeformationTransfer(source, target, faces)
    plain, smooth = transfer.transfer(frames), transfer.sequence(frames, 0.05)
    assert temporal_roughness(smooth) < 0.5 * temporal_roughness(plain)
    np.testing.assert_allclose(smooth[0], plain[0], atol=1e-10)
    np.testing.assert_allclose(transfer.sequence(frames, 0.0), plain)
    np.testing.assert_allclose(transfer.sequence(frames, 1e-12), plain, atol=1e-6)
    # EE eq. (4) for the second frame, up to the translation that is set afterwards.
    A = transfer._matrix.toarray()
    lam = 0.05 * A.diagonal().mean()
    x = [centred(frame - target) for frame in (smooth[0], smooth[1], plain[1])]
    residual = (A + lam * np.eye(len(A))) @ x[1] - A @ x[2] - lam * x[0]
    np.testing.assert_allclose(residual, 0, atol=1e-8)


def test_a_held_pose_stays_held(patch, rng):
    source, faces = patch(rng, 4)
    transfer = DeformationTransfer(source, patch(rng, 4)[0], faces)
    pose = source + smooth_random_field(source, 20, 5, rng)
    held = transfer.sequence(np.repeat(pose[None], 4, axis=0), 0.5)
    np.testing.assert_allclose(held, np.repeat(transfer.transfer(pose)[None], 4, axis=0), atol=1e-9)


def test_roughness_of_steady_motion_is_zero():
    steady = np.arange(5.0)[:, None, None] * np.ones((1, 4, 3))
    assert temporal_roughness(steady) == pytest.approx(0)
    assert temporal_roughness(steady[:2]) == 0.0
    assert temporal_roughness(steady**2) == pytest.approx(3 * 4)


def test_refuses(patch, rng):
    source, faces = patch(rng, 3)
    with pytest.raises(ShapeError):
        DeformationTransfer(source, source[:-1], faces)
    with pytest.raises(ValueRangeError):
        DeformationTransfer(source, source * np.nan, faces)
    with pytest.raises(ValueRangeError):
        DeformationTransfer(source, source, faces + 1000)
    with pytest.raises(ValueRangeError, match="weighting"):
        DeformationTransfer(source, source, faces, weighting="cotangent")
    with pytest.raises(ValueRangeError, match="anchors"):
        DeformationTransfer(source, source, faces, anchors=np.array([999]))
    transfer = DeformationTransfer(source, source, faces)
    with pytest.raises(ShapeError):
        transfer.transfer(source[:-1])
    with pytest.raises(ValueRangeError):
        transfer.transfer(source * np.inf)
    with pytest.raises(ShapeError):
        transfer.sequence(source, 0.1)
    with pytest.raises(ValueRangeError):
        transfer.sequence(source[None], -1.0)
    with pytest.raises(ShapeError):
        temporal_roughness(source)


def test_ict_skin_reproduces_itself(ict_face):
    skin = ict_face.skin()
    neutral = skin.mean_shape.astype(np.float64)
    poses = neutral + skin.blendshape_deltas[:3]
    found = transfer_deformation(neutral, poses, neutral, skin.topology.faces)
    np.testing.assert_allclose(found, poses, atol=1e-6)
