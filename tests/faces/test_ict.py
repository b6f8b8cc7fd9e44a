import numpy as np
import pytest

from facewright.errors import FileFormatError, StoreError
from facewright.faces.blendshape_names import BLENDSHAPE_NAMES, mirror_order
from facewright.faces.ict import read_compact_arrays, shorter_diagonals, triangulate
from facewright.landmarks.scheme import load_scheme
from facewright.mesh.connectivity import boundary_loops

FLIP = np.array([-1.0, 1.0, 1.0])


def test_quads_are_split_along_their_shorter_diagonal():
    points = np.array([[0, 0, 0], [3, 0, 0], [4, 1, 0], [0, 1, 0], [0, 2, 0]], float)
    polygons = np.array([[0, 1, 2, 3], [3, 2, 4, -1]], np.int32)
    split = shorter_diagonals(points, polygons)
    assert split.tolist() == [True, False]
    assert triangulate(polygons, split).tolist() == [[0, 1, 3], [1, 2, 3], [3, 2, 4]]
    assert triangulate(polygons, ~split)[:2].tolist() == [[0, 1, 2], [0, 2, 3]]


def test_skin_is_the_11k_mesh_and_comes_first(ict_face):
    assert ict_face.n_skin == 11248
    assert ict_face.topology.n_vertices == 26719
    assert len(ict_face.topology.parts) == 17
    starts, stops = zip(*ict_face.topology.parts.values())
    assert starts[1:] == stops[:-1]
    assert ict_face.blendshape_names == BLENDSHAPE_NAMES
    skin = ict_face.skin()
    assert skin.topology.faces.max() < 11248
    assert len(boundary_loops(skin.topology.faces)) == 4  # mouth, two eyes, the cut at the shoulders


def test_mirror_map_is_an_involution_that_mirrors_positions_triangles_and_shapes(ict_face):
    mirror, mean = ict_face.topology.mirror, ict_face.mean_shape
    assert np.array_equal(mirror[mirror], np.arange(len(mirror)))
    assert np.linalg.norm(mean[mirror] * FLIP - mean, axis=1)[: ict_face.n_skin].max() < 0.1
    triangles = {tuple(t) for t in np.sort(ict_face.skin().topology.faces, axis=1)}
    assert {tuple(t) for t in np.sort(mirror[ict_face.skin().topology.faces], axis=1)} == triangles
    skin = slice(0, ict_face.n_skin)
    mirrored = ict_face.blendshape_deltas[mirror_order()][:, mirror] * FLIP
    error = np.linalg.norm(mirrored[:, skin] - ict_face.blendshape_deltas[:, skin], axis=2)
    assert error.max() < 1.3  # ICT-FaceKit's own two sides differ by this much in one place
    assert np.sqrt((error**2).mean()) < 0.02


def test_eyes_look_down_is_both_gazes_and_turns_the_eyeballs(ict_face):
    topology = ict_face.topology
    down = ict_face.mean_shape + ict_face.blendshape_deltas[-1]
    for side in ("left", "right"):
        pupil = topology.masks[f"pupil_{side}"]
        assert (down[pupil, 1] - ict_face.mean_shape[pupil, 1]).max() < -4
        ball = slice(*topology.parts[f"eyeball_{side}"])
        before = np.ptp(ict_face.mean_shape[ball], axis=0)
        assert np.abs(np.linalg.norm(np.ptp(down[ball], axis=0)) - np.linalg.norm(before)) < 1.0


def test_masks_are_where_they_say(ict_face):
    topology, mean = ict_face.topology, ict_face.mean_shape
    masks = topology.masks
    middle = {name: mean[ids].mean(axis=0) for name, ids in masks.items()}
    assert middle["forehead"][1] > middle["brow_left"][1] > middle["eyelid_upper_left"][1]
    assert middle["eyelid_upper_left"][1] > middle["eyelid_lower_left"][1] > middle["cheeks_left"][1]
    assert middle["nose"][1] > middle["lips_upper"][1] > middle["lips_lower"][1] > middle["chin"][1]
    assert middle["nose"][2] > middle["cheeks_left"][2]
    for name, ids in masks.items():
        assert len(ids), name
        if "contact" not in name:
            assert np.array_equal(ids, np.unique(ids)), name
        if name.endswith("_left"):
            assert mean[ids, 0].min() > 0, name
            twin = masks[name.replace("_left", "_right")]
            assert np.array_equal(np.sort(topology.mirror[ids]), np.sort(twin)), name
    assert set(masks["lips_upper"]) | set(masks["lips_lower"]) <= set(masks["lips"])
    assert not set(masks["lips_upper"]) & set(masks["lips_lower"])


def test_contact_pairs_touch(ict_face):
    masks, mean = ict_face.topology.masks, ict_face.mean_shape
    closed = mean + ict_face.blendshape_deltas[10] + ict_face.blendshape_deltas[11]
    for points, pair in (
        (mean, ("lip_contact_upper", "lip_contact_lower")),
        (closed, ("lid_contact_upper_left", "lid_contact_lower_left")),
        (closed, ("lid_contact_upper_right", "lid_contact_lower_right")),
    ):
        upper, lower = (masks[name] for name in pair)
        assert len(upper) == len(lower) >= 20
        assert np.linalg.norm(points[upper] - points[lower], axis=1).max() < 1.5
    assert set(masks["lip_contact_upper"]) <= set(masks["lips_upper"])


def test_74_points_mirror_each_other_and_lie_on_the_skin(ict_face):
    topology, mean = ict_face.topology, ict_face.mean_shape
    for name in ("fw74", "ibug68"):
        vertices, scheme = topology.landmarks[name], load_scheme(name)
        assert ((vertices >= 0) & (vertices < ict_face.n_skin)).all()
        if name == "fw74":
            assert np.array_equal(topology.mirror[vertices], vertices[scheme.mirror])
            assert len(np.unique(vertices)) == 74
        moved = mean[vertices] * FLIP - mean[vertices[scheme.mirror]]
        assert np.linalg.norm(moved, axis=1).max() < 4.0
    p = mean[topology.landmarks["fw74"]]
    assert p[27, 0] < p[31, 0] < 0 < p[39, 0] < p[35, 0]  # the subject's right is -x
    assert p[16, 1] > p[19, 1] > p[29, 1] > p[33, 1]
    assert p[45, 2] == p[:, 2].max()  # the tip of the nose
    assert p[57, 1] > p[68, 1] > p[72, 1] > p[63, 1]


def test_a_damaged_compact_file_is_refused(tmp_path, rng):
    path = tmp_path / "bad.npz"
    with pytest.raises(StoreError, match="existing"):
        read_compact_arrays(path)
    path.write_bytes(b"PK\x03\x04 not really")
    with pytest.raises(FileFormatError, match=r"bad\.npz"):
        read_compact_arrays(path)
    np.savez(path, vertices=rng.random((5, 3)))
    with pytest.raises(FileFormatError, match="lacks"):
        read_compact_arrays(path)
    keys = ("vertices", "faces", "uv", "uv_faces", "identity_modes", "expression_deltas", "expression_names")
    np.savez(path, **dict.fromkeys(keys, np.zeros((5, 3))))
    with pytest.raises(FileFormatError, match="shape"):
        read_compact_arrays(path)
    np.savez(path, **dict.fromkeys(keys, np.array([{}], dtype=object)))
    with pytest.raises(FileFormatError, match=r"bad\.npz"):
        read_compact_arrays(path)
    path.write_bytes(path.read_bytes()[:200])
    with pytest.raises(FileFormatError, match=r"bad\.npz"):
        read_compact_arrays(path)
