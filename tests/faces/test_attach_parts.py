import numpy as np
import pytest

from facewright.errors import ShapeError, ValueRangeError
from facewright.faces.attach_parts import parts_attacher
from facewright.faces.blendshape_names import BLENDSHAPE_NAMES
from facewright.faces.expressions import expression_weights
from facewright.faces.eyeball import clearance
from facewright.faces.rigid_motion import rigid_vertices
from facewright.faces.simulate import simulate_person
from facewright.mesh.random_field import smooth_random_field

PARTS_MM = 1.2  # every part, at a skin that is 0.5 mm wrong; the mean face's parts are 2 to 7 mm away


@pytest.fixture(scope="module", params=["builtin", "ict"])
def face(request):
    return request.getfixturevalue(f"{request.param}_face")


@pytest.fixture(scope="module")
def case(face):
    """A person, what a scan would give of the skin, and the parts attached to it."""
    rng = np.random.default_rng(21)
    person = simulate_person(face, rng)
    error = smooth_random_field(face.mean_shape[: face.n_skin], 25.0, 0.5, rng, n_fields=1)[0]
    skin = person.neutral[: face.n_skin].astype(np.float64) + error
    attacher = parts_attacher(face)
    neutral = attacher.neutral(skin)
    deltas = attacher.blendshapes(neutral, person.deltas[:, : face.n_skin], person.amplitudes)
    return person, error, skin, neutral, deltas


def rms(difference):
    return float(np.sqrt((np.asarray(difference, np.float64) ** 2).sum(axis=-1).mean()))


def parts(face):
    return {name: slice(*limits) for name, limits in face.topology.parts.items() if limits[0] >= face.n_skin}


def test_parts_are_placed_by_the_neutral(face, case):
    person, _, skin, neutral, _ = case
    assert np.array_equal(neutral[: face.n_skin], skin)
    for name, part in parts(face).items():
        error, trivial = rms(neutral[part] - person.neutral[part]), rms(face.mean_shape[part] - person.neutral[part])
        assert error < PARTS_MM, name
        assert error < 0.7 * trivial, name


def test_blendshapes_move_parts_as_the_person_does(face, case):
    person, _, _, _, deltas = case
    for name, part in parts(face).items():
        limit = 1.2 if name.startswith("mouth") else 0.6 if name.startswith("gums") else 0.2
        assert rms(deltas[:, part] - person.deltas[:, part]) < limit, name


def test_rigid_pieces_keep_their_shape_in_shapes_and_expressions(face, case):
    person, error, _, neutral, deltas = case
    weights = expression_weights("mouth_stretch") + expression_weights("eyes_closed")
    skin = person.pose(weights)[: face.n_skin] + error
    posed = parts_attacher(face).expression(neutral, deltas, skin, weights, person.amplitudes)
    for name in face.rigid_parts:
        ids = rigid_vertices(face, name)[::17]
        between = np.linalg.norm(neutral[ids, None] - neutral[None, ids], axis=2)
        for moved in (*(neutral + deltas)[:, ids], posed[ids]):
            assert np.abs(np.linalg.norm(moved[:, None] - moved[None], axis=2) - between).max() < 1e-3, name


def test_skull_pieces_stay_and_jaw_pieces_go_with_the_jaw(face, case):
    person, error, _, neutral, deltas = case
    weights = expression_weights("mouth_stretch")
    skin = person.pose(weights)[: face.n_skin] + error
    posed = parts_attacher(face).expression(neutral, deltas, skin, weights, person.amplitudes)
    for name, kind in face.rigid_parts.items():
        ids = rigid_vertices(face, name)
        if kind == "jaw":
            truth = person.pose(weights)[ids] - person.neutral[ids]
            assert rms(truth) > 5
            assert rms((posed - neutral)[ids] - truth) < 0.8
        else:
            assert rms((posed - neutral)[ids]) < 1e-6


def test_closed_lids_are_as_clear_of_the_eyeballs_as_the_generic_ones(face, case):
    person, error, _, neutral, deltas = case
    weights = expression_weights("eyes_closed")
    generic = face.mean_shape + np.tensordot(weights, face.blendshape_deltas, 1)
    skin = person.pose(weights)[: face.n_skin] + error
    for side in ("left", "right"):  # lids that a bad scan put into the eyeball
        lid = face.topology.masks[f"eyelid_upper_{side}"]
        skin[lid, 2] -= 2.0
    posed = parts_attacher(face).expression(neutral, deltas, skin, weights, person.amplitudes)
    for side in ("left", "right"):
        lid = face.topology.masks[f"eyelid_upper_{side}"]
        ball = rigid_vertices(face, f"eyeball_{side}")
        wanted = np.minimum(clearance(generic[lid], generic[ball]), 1.0)
        before = clearance(np.vstack([skin, posed[face.n_skin :]])[lid], posed[ball])
        assert (before - wanted).min() < -0.5
        assert (clearance(posed[lid], posed[ball]) - wanted).min() > -0.05
        i = BLENDSHAPE_NAMES.index(f"eyeBlink_{side[0].upper()}")
        blink, generic_blink = neutral + deltas[i], face.mean_shape + face.blendshape_deltas[i]
        wanted = np.minimum(clearance(generic_blink[lid], generic_blink[ball]), 1.0)
        assert (clearance(blink[lid], blink[ball]) - wanted).min() > -0.05


def test_lashes_follow_the_lids(ict_face):
    attacher = parts_attacher(ict_face)
    person = simulate_person(ict_face, np.random.default_rng(4))
    skin = person.neutral[: ict_face.n_skin].astype(np.float64)
    neutral = attacher.neutral(skin)
    deltas = attacher.blendshapes(neutral, person.deltas[:, : ict_face.n_skin], person.amplitudes)
    weights = expression_weights("eyes_closed")
    closed = attacher.expression(neutral, deltas, person.pose(weights)[: ict_face.n_skin], weights, person.amplitudes)
    for side in ("left", "right"):
        lashes = slice(*ict_face.topology.parts[f"eyelashes_{side}"])
        truth = person.pose(weights)[lashes]
        assert rms(truth - person.neutral[lashes]) > 2
        assert rms(closed[lashes] - truth) < 0.5


def test_the_mean_skin_gets_the_mean_parts(face):
    attacher = parts_attacher(face)
    assert np.abs(attacher.neutral(face.mean_shape[: face.n_skin]) - face.mean_shape).max() < 1e-3
    ones = np.ones(46)
    deltas = attacher.blendshapes(face.mean_shape, face.blendshape_deltas[:, : face.n_skin], ones)
    change = np.linalg.norm(deltas - face.blendshape_deltas, axis=2)
    blinks = [BLENDSHAPE_NAMES.index(f"eyeBlink_{s}") for s in "LR"]  # generic lids leave a gap that ours close
    assert change[np.setdiff1d(np.arange(46), blinks)].max() < 0.3


def test_what_does_not_fit_is_refused(builtin_face):
    attacher = parts_attacher(builtin_face)
    skin = builtin_face.mean_shape[: builtin_face.n_skin].astype(np.float64)
    with pytest.raises(ShapeError, match="skin"):
        attacher.neutral(builtin_face.mean_shape)
    bad = skin.copy()
    bad[0, 0] = np.nan
    with pytest.raises(ValueRangeError, match="skin"):
        attacher.neutral(bad)
    shapes = builtin_face.blendshape_deltas
    with pytest.raises(ShapeError, match="skin_deltas"):
        attacher.blendshapes(builtin_face.mean_shape, shapes, np.ones(46))
    with pytest.raises(ShapeError, match="weights"):
        attacher.expression(builtin_face.mean_shape, shapes, skin, np.ones(47), np.ones(46))
