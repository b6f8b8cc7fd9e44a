import numpy as np
import pytest

from facewright.camera.rotation import rotation_from_vector
from facewright.errors import ShapeError, ValueRangeError
from facewright.evaluation.mesh_distance import mesh_distance


@pytest.fixture
def skin(builtin_face):
    return builtin_face.skin()


def test_moved_mesh_has_no_distance(skin):
    truth = skin.mean_shape.astype(np.float64)
    moved = truth @ rotation_from_vector([0.1, 0.2, 0.3]).T + [5, 6, 7]
    assert max(mesh_distance(moved, truth, skin.topology.faces, np.arange(len(truth)))) < 1e-6


def test_size_counts_unless_taken_from_the_truth(skin):
    truth = skin.mean_shape.astype(np.float64)
    moved = 1.1 * truth @ rotation_from_vector([0.1, 0.2, 0.3]).T + [5, 6, 7]
    found = mesh_distance(moved, truth, skin.topology.faces, np.arange(len(truth)))
    assert found.similarity_surface_mm < 1e-6 and found.similarity_correspondence_mm < 1e-6
    assert found.surface_mm > 1
    radius = np.linalg.norm(truth - truth.mean(axis=0), axis=1).mean()
    assert found.correspondence_mm == pytest.approx(0.1 * radius, rel=1e-6)


def test_sliding_within_the_surface_costs_correspondence_only(rng):
    x, y = np.meshgrid(np.arange(20.0), np.arange(20.0))
    plane = np.stack([x.ravel(), y.ravel(), 0 * x.ravel()], axis=1)
    i = (np.arange(19)[:, None] * 20 + np.arange(19)).ravel()
    faces = np.concatenate([np.stack([i, i + 1, i + 20], 1), np.stack([i + 1, i + 21, i + 20], 1)])
    inner = np.flatnonzero((plane[:, :2] > 2).all(axis=1) & (plane[:, :2] < 17).all(axis=1))
    slid = plane.copy()
    slid[inner, :2] += rng.uniform(-0.4, 0.4, (len(inner), 2))
    found = mesh_distance(slid, plane, faces, np.arange(400))
    assert found.surface_mm < 1e-3 < 0.1 < found.correspondence_mm


def test_refuses_other_meshes(skin):
    V = skin.mean_shape
    with pytest.raises(ShapeError):
        mesh_distance(V[:-1], V, skin.topology.faces, np.arange(5))
    with pytest.raises(ValueRangeError):
        mesh_distance(V, V, skin.topology.faces, np.array([len(V)]))
