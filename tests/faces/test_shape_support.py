import numpy as np
import pytest
from scipy.spatial import cKDTree

from facewright.faces.rigid_motion import rigid_vertices
from facewright.faces.shape_support import shape_support


@pytest.fixture(scope="module", params=["builtin_face", "ict_face"])
def face(request):
    return request.getfixturevalue(request.param)


def row(face, name):
    return shape_support(face)[face.blendshape_names.index(name)]


def test_is_full_where_the_generic_shape_moves(face):
    support = shape_support(face)
    assert support.shape == face.blendshape_deltas.shape[:2] and support.min() >= 0 and support.max() <= 1
    n = face.n_skin
    front = face.topology.masks["face_region"]
    length = np.linalg.norm(face.blendshape_deltas, axis=2)
    for k in range(len(support)):
        moves = np.flatnonzero(length[k, :n] > 0.011 * length[k, :n].max())
        upper = face.blendshape_names[k].startswith(("brow", "eye"))
        moves = np.intersect1d(moves, front) if upper else moves
        assert (support[k, moves] == 1).all(), face.blendshape_names[k]


def test_brows_and_lids_leave_ears_neck_and_the_back_of_the_head(face):
    mean, n = face.mean_shape, face.n_skin
    front = cKDTree(mean[face.topology.masks["face_region"]])
    for k, name in enumerate(face.blendshape_names):
        if name.startswith(("brow", "eye")):
            counts = mean[:n][shape_support(face)[k, :n] > 0]
            away = front.query(counts)[0]
            assert len(counts) > 50 and away.max() < 10.0, name


def test_falls_smoothly(face):
    edges = face.topology.faces[:, :2]
    edges = edges[(edges < face.n_skin).all(axis=1)]
    length = np.linalg.norm(np.diff(face.mean_shape[edges], axis=1)[:, 0], axis=1)
    for name in ("eyeBlink_L", "browInnerUp_R", "mouthSmile_L", "jawOpen"):
        steps = np.abs(np.diff(row(face, name)[edges], axis=1)[:, 0])
        assert (steps < 0.2 * length + 1e-6).all()  # per millimetre: 1.5 / 8, in both factors rarely at once


def test_sides_of_a_contact_count_alike(face):
    masks = face.topology.masks
    pairs = [("lip_contact_upper", "lip_contact_lower")]
    for name in ("jawOpen", "mouthSmile_L", "mouthPucker", "mouthUpperUp_R", "mouthLowerDown_L"):
        for upper, lower in pairs:
            apart = np.abs(row(face, name)[masks[upper]] - row(face, name)[masks[lower]])
            assert apart.max() < 0.05, name


def test_rigid_parts_count_as_a_whole(face):
    for part, kind in face.rigid_parts.items():
        ids = rigid_vertices(face, part)
        share = shape_support(face)[:, ids]
        assert (share.min(axis=1) == share.max(axis=1)).all()
        if kind == "jaw":
            assert row(face, "jawOpen")[ids[0]] == 1 and row(face, "eyeBlink_L")[ids[0]] == 0
        if kind == "skull":
            assert row(face, "jawOpen")[ids[0]] == 0
