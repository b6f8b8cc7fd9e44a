import numpy as np
import pytest
from scipy.spatial import cKDTree

from facewright.fitting.face_surface import SurfacePoints, _covered, _thinned
from facewright.mesh.normals import vertex_normals


@pytest.fixture(scope="module")
def skin(small_model):
    return SurfacePoints(small_model)


def test_points_are_of_the_face_in_front_and_apart(small_model, skin):
    mean = small_model.mean_face[skin.vertices]
    normals = vertex_normals(small_model.mean_face.astype(float), small_model.topology.faces)[skin.vertices]
    assert 500 < len(skin.vertices) < 4000
    assert normals[:, 2].min() > 0.1
    assert cKDTree(mean).query(mean, k=2)[0][:, 1].min() >= 1.5 - 1e-4
    for name in ("lip_contact_upper", "lid_contact_upper_left"):
        assert not np.isin(small_model.topology.masks[name], skin.vertices).any()


def test_points_and_normals_follow_the_mesh(small_model, skin, rng):
    rig = small_model.blendshapes(small_model.sample_identity(rng))
    surface = skin.of(rig)
    faces = small_model.topology.faces
    for i in range(0, 46, 9):
        beta = np.zeros(46)
        beta[i] = 0.4
        mesh = rig.neutral.astype(float) + 0.4 * rig.deltas[i]
        points, normals = surface.at(beta)
        np.testing.assert_allclose(points, mesh[skin.vertices], atol=1e-3)
        turned = np.rad2deg(
            np.arccos(np.clip((normals * vertex_normals(mesh, faces)[skin.vertices]).sum(axis=1), -1, 1))
        )
        assert np.quantile(turned, 0.95) < 2.5
        np.testing.assert_allclose(
            surface.displaced(beta), np.linalg.norm(mesh - rig.neutral, axis=1)[skin.vertices], atol=1e-3
        )


def test_what_lies_behind_is_covered():
    triangle = np.array([[[0.0, 0.0, 10.0], [4.0, 0.0, 10.0], [0.0, 4.0, 10.0]], [[0.0, 0, 0], [0, 0, 5], [0, 0, 9]]])
    points = np.array([[1.0, 1.0, 5.0], [1.0, 1.0, 8.0], [3.0, 3.0, 5.0], [1.0, 1.0, 12.0]])
    np.testing.assert_array_equal(_covered(points, triangle, 3.0), [True, False, False, False])


def test_thinning_keeps_the_first_of_near_points():
    points = np.array([[0.0, 0, 0], [1, 0, 0], [2.5, 0, 0], [9, 0, 0], [9, 0.6, 0]])
    np.testing.assert_array_equal(_thinned(points, np.array([2.0, 2.0, 2.0, 2.0, 0.5])), [0, 2, 3, 4])
