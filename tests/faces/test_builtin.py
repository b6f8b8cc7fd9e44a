import json
import time
from importlib import resources

import numpy as np
import pytest

from facewright.errors import FileFormatError
from facewright.faces import builtin
from facewright.faces.blendshape_names import BLENDSHAPE_NAMES, mirror_order
from facewright.faces.builtin_mesh import build_control_mesh
from facewright.faces.builtin_parts import (
    EYE_POLES,
    EYE_RADII,
    EYE_RINGS,
    HANDLES,
    build_eyeball,
    build_rigid_parts,
    handle_weights,
)
from facewright.faces.expressions import EXPRESSION_NAMES, expression_weights
from facewright.imaging.rasterise import rasterise
from facewright.mesh.connectivity import boundary_loops, unique_edges, vertex_components

MIRROR_X = np.array([-1.0, 1.0, 1.0])
SHAPE = {name: k for k, name in enumerate(BLENDSHAPE_NAMES)}


def posed(face, **weights):
    shape = face.mean_shape.astype(np.float64)
    for name, weight in weights.items():
        for k in (SHAPE.get(name), SHAPE.get(f"{name}_L"), SHAPE.get(f"{name}_R")):
            if k is not None:
                shape = shape + weight * face.blendshape_deltas[k]
    return shape


def contact_gap(face, shape, kind, side=""):
    masks = face.topology.masks
    return np.linalg.norm(
        shape[masks[f"{kind}_contact_upper{side}"]] - shape[masks[f"{kind}_contact_lower{side}"]], axis=1
    )


def lid_clearance(face, shape):
    """Distance of the left lids from the surface of the left eyeball, mm; negative inside."""
    masks, (start, stop) = face.topology.masks, face.topology.parts["eyeball_left"]
    ball = shape[start:stop]
    axis = ball[0] - ball[-1]
    size = np.linalg.norm(axis) / sum(EYE_POLES)
    centre = ball[-1] + axis * EYE_POLES[1] / sum(EYE_POLES)
    lids = np.concatenate([masks["eyelid_upper_left"], masks["eyelid_lower_left"], masks["lash_line_left"]])
    arm = shape[lids] - centre
    distance = np.linalg.norm(arm, axis=1)
    angle = np.degrees(np.arccos(np.clip(arm @ axis / (distance * np.linalg.norm(axis)), -1, 1)))
    radius = np.interp(angle, [0, *EYE_RINGS, 180], [EYE_POLES[0], *EYE_RADII, EYE_POLES[1]])
    return distance - size * radius


# -- size and bookkeeping -------------------------------------------------------------------------------------------
def test_it_is_of_the_promised_size(builtin_face):
    data = builtin._read()
    file = resources.files("facewright.faces") / "data" / "builtin_face.npz"
    assert len(file.read_bytes()) < 1_000_000
    assert 300 <= len(data["cage_mirror"]) <= 600
    assert 5000 <= builtin_face.topology.n_vertices <= 7000
    assert len(builtin_face.identity_basis) >= 40 and builtin_face.blendshape_names == BLENDSHAPE_NAMES
    assert (data["cage_faces"][:, 3] < 0).sum() <= 2  # all quads but two


def test_it_loads_in_less_than_a_second():
    builtin.load_builtin_face()  # imports and disk cache
    seconds = []
    for _ in range(3):
        start = time.perf_counter()
        builtin.load_builtin_face()
        seconds.append(time.perf_counter() - start)
    assert min(seconds) < 1.0


def test_parts_tile_the_vertices_in_order(builtin_face):
    parts = builtin_face.topology.parts
    assert tuple(parts) == (
        "face", "head_and_neck", "mouth_cavity", "eyeball_left", "eyeball_right", "teeth_upper", "teeth_lower",
    )  # fmt: skip
    ends = [0, *(stop for _, stop in parts.values())]
    assert [start for start, _ in parts.values()] == ends[:-1] and ends[-1] == builtin_face.topology.n_vertices
    assert builtin_face.n_skin == parts["head_and_neck"][1]


def test_a_damaged_data_file_is_reported(monkeypatch, tmp_path):
    (tmp_path / "data").mkdir()
    (tmp_path / "data" / "builtin_face.npz").write_bytes(b"PK\x03\x04 nothing")
    monkeypatch.setattr(builtin.resources, "files", lambda _: tmp_path)
    with pytest.raises(FileFormatError, match="builtin_face"):
        builtin.load_builtin_face()


# -- topology ---------------------------------------------------------------------------------------------------------
def test_every_surface_is_manifold_oriented_and_whole(builtin_face):
    topology = builtin_face.topology
    faces = topology.faces
    directed = np.concatenate([faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]]).astype(np.int64)
    assert len(np.unique(directed, axis=0)) == len(directed)  # no edge twice in one direction
    assert np.array_equal(np.unique(faces), np.arange(topology.n_vertices))
    assert vertex_components(faces, topology.n_vertices).max() == 4  # head, two eyes, two rows of teeth
    skin_and_cavity = topology.part_slice("face", "head_and_neck", "mouth_cavity").stop
    head = faces[(faces < skin_and_cavity).all(axis=1)]
    assert len(boundary_loops(head)) == 3  # two eyes, the neck; the mouth goes on into the cavity
    assert skin_and_cavity - len(unique_edges(head)) + len(head) == 2 - 3
    for part in ("eyeball_left", "eyeball_right", "teeth_upper", "teeth_lower"):
        start, stop = topology.parts[part]
        own = faces[((faces >= start) & (faces < stop)).all(axis=1)]
        assert stop - start - len(unique_edges(own)) + len(own) == 2, part


def test_faces_look_outwards_and_have_area(builtin_face):
    faces, mean = builtin_face.topology.faces, builtin_face.mean_shape.astype(np.float64)
    a, b, c = (mean[faces[:, k]] for k in range(3))
    normal = np.cross(b - a, c - a)
    assert 0.5 * np.linalg.norm(normal, axis=1).min() > 1e-3  # mm^2
    for part in ("eyeball_left", "eyeball_right", "teeth_upper", "teeth_lower"):
        start, stop = builtin_face.topology.parts[part]
        own = ((faces >= start) & (faces < stop)).all(axis=1)
        assert np.einsum("nc,nc->", a[own] - mean[start], normal[own]) > 0, part
    region = np.isin(faces, builtin_face.topology.masks["forehead"]).all(axis=1)
    assert (normal[region, 2] > 0).mean() > 0.95


def test_neighbouring_triangles_never_fold_over_in_the_front(builtin_face):
    face = builtin_face
    allowed = np.zeros(face.topology.n_vertices, bool)
    allowed[face.topology.masks["face_region"]] = True
    tucked = [m for k, m in face.topology.masks.items() if k.startswith(("nostril", "lash_line", "lips"))]
    allowed[np.concatenate(tucked)] = False
    faces = face.topology.faces[allowed[face.topology.faces].all(axis=1)]
    for shape in (posed(face), posed(face, mouthSmile=1), posed(face, jawOpen=1), posed(face, browInnerUp=1)):
        a, b, c = (shape[faces[:, k]] for k in range(3))
        normal = np.cross(b - a, c - a)
        normal /= np.linalg.norm(normal, axis=1, keepdims=True)
        edges = np.sort(np.concatenate([faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]]), axis=1)
        owner = np.tile(np.arange(len(faces)), 3)
        order = np.lexsort(edges.T)
        same = (edges[order][1:] == edges[order][:-1]).all(axis=1)
        first, second = owner[order][:-1][same], owner[order][1:][same]
        assert (normal[first] * normal[second]).sum(axis=1).min() > -0.2


def test_the_mirror_map_is_an_involution_that_keeps_the_mesh(builtin_face):
    topology, mean = builtin_face.topology, builtin_face.mean_shape.astype(np.float64)
    mirror = topology.mirror
    np.testing.assert_array_equal(mirror[mirror], np.arange(topology.n_vertices))
    np.testing.assert_allclose(mean[mirror] * MIRROR_X, mean, atol=1e-5)
    have = {tuple(sorted(t)) for t in topology.faces.tolist()}
    image = {tuple(sorted(t)) for t in mirror[topology.faces].tolist()}
    assert len(have & image) >= 0.999 * len(have)


def test_the_atlas_does_not_overlap(builtin_face):
    uv, uv_faces = builtin_face.topology.uv.astype(np.float64), builtin_face.topology.uv_faces
    assert uv.min() >= 0 and uv.max() <= 1 and len(uv_faces) == len(builtin_face.topology.faces)
    p, q, r = (uv[uv_faces[:, k]] for k in range(3))
    area = 0.5 * ((q - p)[:, 0] * (r - p)[:, 1] - (q - p)[:, 1] * (r - p)[:, 0])
    assert area.min() > 0
    size = 1024  # a picture of the atlas covers as many pixels as its triangles have area
    covered = rasterise(uv * size - 0.5, np.ones(len(uv)), uv_faces, (size, size), perspective=False).covered
    np.testing.assert_allclose(covered.mean(), area.sum(), rtol=0.005)
    corner_vertex = np.full(len(uv), -1)
    corner_vertex[uv_faces.ravel()] = builtin_face.topology.faces.ravel()
    assert (corner_vertex[uv_faces] == builtin_face.topology.faces).all()


# -- shape ------------------------------------------------------------------------------------------------------------
def test_left_and_right_expressions_are_mirror_images(builtin_face):
    deltas, mirror = builtin_face.blendshape_deltas, builtin_face.topology.mirror
    np.testing.assert_allclose(deltas[mirror_order()][:, mirror] * MIRROR_X, deltas, atol=5e-3)


def test_identity_modes_are_symmetric_or_antisymmetric_and_ordered(builtin_face):
    basis, mirror = builtin_face.identity_basis, builtin_face.topology.mirror
    image = basis[:, mirror] * MIRROR_X.astype(np.float32)
    sign = np.sign((image * basis).sum(axis=(1, 2)))
    np.testing.assert_allclose(image * sign[:, None, None], basis, atol=5e-3)
    energy = (basis.astype(np.float64) ** 2).sum(axis=(1, 2))
    assert energy[0] > 5 * energy[20] > 0 and 2.0 < np.sqrt(energy.sum() / basis.shape[1]) < 12.0  # mm


def test_lips_are_sealed_in_every_neutral(builtin_face, rng):
    assert contact_gap(builtin_face, posed(builtin_face), "lip").max() < 0.1
    for _ in range(10):
        person = builtin_face.mean_shape + np.tensordot(rng.normal(size=60), builtin_face.identity_basis, 1)
        assert contact_gap(builtin_face, person, "lip").max() < 0.1
    assert len(builtin_face.topology.masks["lip_contact_upper"]) > 30


def test_lips_do_not_pass_through_one_another_in_neutral(builtin_face):
    """Next to the contact line, the upper lip stays above the lower one."""
    masks, mean = builtin_face.topology.masks, builtin_face.mean_shape
    quads = builtin_face.topology.quads[(builtin_face.topology.quads >= 0).all(axis=1)]
    edges = np.concatenate([quads[:, [k, (k + 1) % 4]] for k in range(4)])
    beside = {}
    for side in ("upper", "lower"):
        line = masks[f"lip_contact_{side}"]
        near = [np.setdiff1d(edges[(edges == v).any(axis=1)], line) for v in line[8:-8]]
        beside[side] = np.array([mean[ids[np.argsort(mean[ids, 2])]] for ids in near])  # behind, before
    assert (beside["upper"][..., 1] - beside["lower"][..., 1]).min() > 0.1


def test_mouth_close_closes_an_open_jaw_and_smiles_stay_sealed(builtin_face):
    face = builtin_face
    assert contact_gap(face, posed(face, jawOpen=1), "lip").max() > 15.0
    assert contact_gap(face, posed(face, jawOpen=1, mouthClose=1), "lip").max() < 0.1
    for name in ("mouthSmile", "mouthFrown", "mouthPress", "cheekPuff", "mouthDimple", "mouthStretch"):
        assert contact_gap(face, posed(face, **{name: 1}), "lip").max() < 0.1, name


def test_teeth_go_with_skull_and_jaw(builtin_face):
    face = builtin_face
    upper, lower = (slice(*face.topology.parts[name]) for name in ("teeth_upper", "teeth_lower"))
    moved = posed(face, jawOpen=1) - face.mean_shape
    assert np.abs(moved[upper]).max() < 0.1
    assert moved[lower, 1].min() < -15.0
    assert set(face.rigid_parts) == {"teeth_upper", "teeth_lower", "eyeball_left", "eyeball_right"}


def test_blinking_closes_the_eyes(builtin_face):
    shut = posed(builtin_face, eyeBlink=1)
    for side in ("_left", "_right"):
        assert contact_gap(builtin_face, shut, "lid", side).max() < 0.3
        assert contact_gap(builtin_face, posed(builtin_face), "lid", side).max() > 6.0


@pytest.mark.parametrize(
    "pose",
    [{}, {"eyeBlink": 1}, {"eyeBlink": 0.5}, {"eyeBlink": 0.25}, {"eyeBlink": 0.75}, {"eyeSquint": 1}, {"eyeWide": 1},
     {"eyesLookDown": 1}, {"eyesLookDown": 0.5}, {"mouthSmile": 1, "cheekSquint": 1}],
)  # fmt: skip
def test_lids_stay_before_the_eyeball(builtin_face, pose):
    assert lid_clearance(builtin_face, posed(builtin_face, **pose)).min() > 0.1


def test_looking_down_turns_the_eyeballs(builtin_face):
    start, stop = builtin_face.topology.parts["eyeball_left"]
    down = builtin_face.blendshape_deltas[SHAPE["eyesLookDown"], start:stop]
    assert down[0, 1] < -4.0  # the pupil sinks
    ball = builtin_face.mean_shape[start:stop] + down
    size = np.linalg.norm(ball - ball.mean(axis=0), axis=1)
    before = builtin_face.mean_shape[start:stop]
    np.testing.assert_allclose(size, np.linalg.norm(before - before.mean(axis=0), axis=1), atol=0.01)


# -- annotation -------------------------------------------------------------------------------------------------------
def test_masks_are_where_they_should_be(builtin_face):
    masks, mean = builtin_face.topology.masks, builtin_face.mean_shape
    for name in ("lips_upper", "lips_lower", "nose", "nostrils", "chin", "forehead", "ears", "face_region", "left",
                 "right", "iris_left", "pupil_right", "cheeks_left", "brow_left", "eyelid_upper_right"):  # fmt: skip
        assert len(masks[name]), name
    for name, ids in masks.items():
        if "contact" not in name:
            assert (np.diff(ids) > 0).all(), name
    for name in ("eyelid_upper", "eyelid_lower", "brow", "cheeks", "iris", "pupil", "lash_line"):
        image = np.sort(builtin_face.topology.mirror[masks[f"{name}_left"]])
        np.testing.assert_array_equal(image, masks[f"{name}_right"], err_msg=name)
        assert mean[masks[f"{name}_left"], 0].mean() > 10
    height = {
        k: mean[masks[k], 1].mean() for k in ("forehead", "brow_left", "nose", "lips_upper", "lips_lower", "chin")
    }
    assert list(height.values()) == sorted(height.values(), reverse=True)


@pytest.mark.parametrize("scheme", ["fw74", "ibug68"])
def test_landmarks_mirror_and_lie_on_the_right_features(builtin_face, scheme):
    ids, mean = builtin_face.topology.landmarks[scheme], builtin_face.mean_shape
    content = json.loads((resources.files("facewright.landmarks") / "data" / f"{scheme}.json").read_text())
    assert len(ids) == len(content["mirror"]) and (ids >= 0).all() and (ids < builtin_face.n_skin).all()
    image = builtin_face.topology.mirror[ids[content["mirror"]]]
    np.testing.assert_allclose(mean[image], mean[ids], atol=1.5)
    mouth = content["groups"]["outer_mouth"] + content["groups"]["inner_mouth"]
    assert np.isin(ids[mouth], builtin_face.topology.masks["lips"]).all()
    eye = content["groups"]["left_eye"]
    assert np.isin(ids[eye], builtin_face.topology.masks["lash_line_left"]).all()


def test_all_expressions_are_finite_and_moderate(builtin_face):
    for name in EXPRESSION_NAMES:
        moved = np.tensordot(expression_weights(name), builtin_face.blendshape_deltas, 1)
        assert np.isfinite(moved).all() and np.abs(moved).max() < 60.0


# -- construction -----------------------------------------------------------------------------------------------------
def test_control_mesh_mixes_levels_without_cracks():
    quads = np.array([[0, 1, 4, 3], [1, 2, 5, 4]])
    mesh = build_control_mesh(quads, 6, np.array([True, False]), np.array([0, 1]), np.arange(6))
    np.testing.assert_allclose(mesh.matrix.sum(axis=1), 1.0)
    sides = [(mesh.quads[:, k], mesh.quads[:, (k + 1) % 4]) for k in range(4)]
    triangle = mesh.quads[:, 3] < 0
    edges = np.concatenate(
        [np.stack([a, b], 1)[(a >= 0) & (b >= 0)] for a, b in sides] + [mesh.quads[triangle][:, [2, 0]]]
    )
    _, count = np.unique(np.sort(edges, axis=1), axis=0, return_counts=True)
    assert count.max() == 2 and (count == 1).sum() == 3 * 4 + 3 * 2  # border: fine sides in four, coarse in two
    assert mesh.parts == {"face": (0, 25), "head_and_neck": (25, 31), "mouth_cavity": (31, 31)}


def test_handles_reproduce_the_rigid_parts():
    for k, part in enumerate(build_rigid_parts().values()):
        weights = handle_weights(k, part.vertices)
        np.testing.assert_allclose(weights.sum(axis=1), 1.0)
        np.testing.assert_allclose(weights @ HANDLES[4 * k : 4 * k + 4], part.vertices, atol=1e-9)


def test_the_right_eyeball_mirrors_the_left():
    left, right = build_eyeball("left"), build_eyeball("right")
    np.testing.assert_allclose(left.vertices * MIRROR_X, right.vertices)
    assert {tuple(sorted(q)) for q in left.quads.tolist()} == {tuple(sorted(q)) for q in right.quads.tolist()}
