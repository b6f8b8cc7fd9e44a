"""Characters bound to region-based models: their own shapes come back, inner parts follow, other topologies work."""

from dataclasses import replace

import numpy as np
import pytest

from facewright.errors import ShapeError, TopologyError
from facewright.faces.character_contacts import character_seals, lid_clearance
from facewright.faces.character_places import character_places
from facewright.faces.drive_character import bind_character, local_turns
from facewright.faces.performance_region import performance_region
from facewright.faces.rigid_motion import rigid_vertices
from facewright.mesh.uniform_subsample import subsample_mesh
from facewright.models.dense_drive import DenseDriver
from facewright.models.dense_weights import SurfacePlaces
from facewright.models.region_pca import linear_region_model
from facewright.models.regions import Regions


def _model(face, n=397):
    """The face's own shapes on a coarse mesh of it."""
    skin = face.skin()
    sub = subsample_mesh(skin.mean_shape, skin.topology.faces, n, within=performance_region(face))
    return linear_region_model(
        face.mean_shape[sub.vertex_ids],
        face.blendshape_deltas[:, sub.vertex_ids],
        face.blendshape_names,
        Regions.holistic(len(sub.vertex_ids)),
        sub.faces,
        provenance={"template": face.name, "vertex_ids": sub.vertex_ids.tolist()},
    )


@pytest.fixture(scope="module")
def bound(builtin_face):
    model = _model(builtin_face)
    places = character_places(model, builtin_face)
    return model, DenseDriver(model, bind_character(model, builtin_face, places))


def _posed(bound, **weights):
    model, driver = bound
    names = [name.partition("_")[2] for name in model.coefficient_names[0]]
    zeta = np.zeros(model.n_coefficients)
    for name, value in weights.items():
        zeta[names.index(name)] = value
    return driver.positions(zeta).astype(np.float64)


def _true(face, **weights):
    w = np.zeros(46)
    for name, value in weights.items():
        w[face.blendshape_names.index(name)] = value
    return face.mean_shape + np.tensordot(w, face.blendshape_deltas, 1)


@pytest.mark.parametrize(
    "weights",
    [{"jawOpen": 0.7}, {"mouthSmile_L": 1.0, "mouthSmile_R": 1.0}, {"browOuterUp_L": 1.0}, {"mouthPucker": 0.8}],
)
def test_own_shapes_come_back_from_a_few_points(builtin_face, bound, weights):
    face, n = builtin_face, builtin_face.n_skin
    truth = _true(face, **weights)
    moved = np.linalg.norm((truth - face.mean_shape)[:n], axis=1)
    missed = np.linalg.norm((_posed(bound, **weights) - truth)[:n], axis=1)
    assert np.sqrt((missed**2).mean()) < 0.2 * np.sqrt((moved**2).mean())
    assert missed.max() < 0.35 * moved.max()


def test_nothing_moves_at_rest(builtin_face, bound):
    np.testing.assert_array_equal(_posed(bound), builtin_face.mean_shape)


def test_lower_teeth_follow_the_jaw_rigidly_and_upper_ones_and_eyes_stay(builtin_face, bound):
    face, posed = builtin_face, _posed(bound, jawOpen=0.8)
    truth = _true(face, jawOpen=0.8)
    lower = rigid_vertices(face, "teeth_lower")
    assert np.linalg.norm((truth - face.mean_shape)[lower], axis=1).mean() > 10
    assert np.linalg.norm((posed - truth)[lower], axis=1).mean() < 3.0
    before, after = (np.linalg.norm(shape[lower] - shape[lower[0]], axis=1) for shape in (face.mean_shape, posed))
    np.testing.assert_allclose(after, before, atol=1e-3)
    for part in ("teeth_upper", "eyeball_left", "eyeball_right"):
        ids = rigid_vertices(face, part)
        np.testing.assert_array_equal(posed[ids], face.mean_shape[ids])


def test_lids_close_and_stay_outside_the_eyeballs(builtin_face, bound):
    face, topology = builtin_face, builtin_face.topology
    posed = _posed(bound, eyeBlink_L=1.0)
    gap = posed[topology.masks["lid_contact_upper_left"], 1] - posed[topology.masks["lid_contact_lower_left"], 1]
    assert np.abs(gap).max() < 1.5  # at the corners, which rest apart
    assert np.abs(gap[3:-3]).max() < 0.5
    lids = lid_clearance(face)
    for blink in (0.3, 0.6, 1.0):
        posed = _posed(bound, eyeBlink_L=blink, eyeBlink_R=blink)
        arms = posed[lids.ids] - lids.centres[lids.eye]
        length = np.linalg.norm(arms, axis=1)
        bins = np.linspace(-1, 1, lids.radii.shape[1])
        radius = np.array(
            [np.interp(a[2] / r, bins, lids.radii[e]) for a, r, e in zip(arms, length, lids.eye, strict=True)]
        )
        assert (length - radius - lids.margins).min() > -1e-3


def test_lips_never_cross(builtin_face, bound, rng):
    model, driver = bound
    seals = character_seals(builtin_face)
    names = [name.partition("_")[2] for name in model.coefficient_names[0]]
    for _ in range(5):
        zeta = np.zeros(model.n_coefficients)
        zeta[names.index("mouthShrugLower")], zeta[names.index("mouthClose")] = rng.uniform(0.1, 0.2, 2)
        posed = driver.positions(zeta)
        gap = posed[seals.upper, 1] - posed[seals.lower, 1] - seals.floors
        assert gap.min() > -0.2


def test_turns_are_the_similarity_between_two_faces(rng):
    from scipy.spatial.transform import Rotation

    source = rng.normal(size=(40, 3))
    faces = rng.integers(0, 40, (120, 3))
    turn = Rotation.random(random_state=1).as_matrix()
    found = local_turns(source, source @ turn.T * 1.3 + 5.0, faces)
    used = np.unique(faces)
    np.testing.assert_allclose(found[used], np.tile(1.3 * turn, (len(used), 1, 1)), atol=1e-9)


def test_places_must_be_one_for_each_vertex(builtin_face, bound):
    with pytest.raises(ShapeError, match="one for each"):
        bind_character(bound[0], builtin_face, SurfacePlaces.at_vertices(np.arange(7)))


def test_a_model_must_know_where_its_vertices_come_from(builtin_face, bound):
    model = bound[0]
    for provenance in ({}, {"template": "builtin"}, {"template": "builtin", "vertex_ids": [1, 2]}):
        with pytest.raises(TopologyError, match="which vertices of which face"):
            character_places(replace(model, provenance=provenance), builtin_face)
    far = {"template": "builtin", "vertex_ids": [10**6] * model.n_vertices}
    with pytest.raises(TopologyError, match="skin vertices"):
        character_places(replace(model, provenance=far), builtin_face)


def test_the_other_topology_is_driven_alike(builtin_face, ict_face):
    """The generic shapes of both faces are alike: a model of one moves the other as its own shapes do."""
    model = _model(ict_face)
    places = character_places(model, builtin_face, template=ict_face)
    driven = DenseDriver(model, bind_character(model, builtin_face, places))
    for weights in ({"jawOpen": 0.7}, {"mouthSmile_L": 1.0}, {"browOuterUp_R": 1.0}):
        truth, n = _true(builtin_face, **weights), builtin_face.n_skin
        missed = np.linalg.norm((_posed((model, driven), **weights) - truth)[:n], axis=1)
        moved = np.linalg.norm((truth - builtin_face.mean_shape)[:n], axis=1)
        assert np.sqrt((missed**2).mean()) < 0.5 * np.sqrt((moved**2).mean())
    upper = np.isin(model.provenance["vertex_ids"], ict_face.topology.masks["lips_upper"])
    assert not np.isin(places.corners[upper], builtin_face.topology.masks["lips_lower"]).any()
