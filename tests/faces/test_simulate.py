import importlib.util
from pathlib import Path

import numpy as np
import pytest

from facewright.errors import ShapeError, ValueRangeError
from facewright.faces.blendshape_names import BLENDSHAPE_NAMES, mirrored_name
from facewright.faces.rigid_motion import rigid_vertices
from facewright.faces.simulate import (
    AMPLITUDE,
    PERTURBATION,
    simulate_neutrals,
    simulate_person,
    simulate_population,
)

spec = importlib.util.spec_from_file_location("reference_faces", Path(__file__).parent / "reference_faces.py")
reference = importlib.util.module_from_spec(spec)
spec.loader.exec_module(reference)


@pytest.fixture(scope="module", params=["builtin", "ict"])
def face(request):
    return request.getfixturevalue(f"{request.param}_face")


@pytest.fixture(scope="module")
def person(face):
    return simulate_person(face, np.random.default_rng(11))


def rms(field):
    return float(np.sqrt((np.asarray(field, float) ** 2).sum(axis=-1).mean()))


def test_the_same_seed_draws_the_same_people(face):
    first, again = (simulate_neutrals(face, 2, np.random.default_rng(4)) for _ in range(2))
    other = simulate_neutrals(face, 2, np.random.default_rng(5))
    assert first.dtype == np.float32
    assert np.array_equal(first, again)
    assert rms(first - other) > 1.0


def test_neutrals_lie_outside_the_modes_by_half_a_millimetre(face):
    skin = face.skin()
    samples = simulate_neutrals(skin, 8, np.random.default_rng(1)) - skin.mean_shape
    lips = np.concatenate([ids for name, ids in skin.topology.masks.items() if "lip" in name])
    keep = np.setdiff1d(np.arange(skin.n_skin), lips)
    basis = skin.identity_basis[:, keep].reshape(len(skin.identity_basis), -1).T.astype(float)
    flat = samples[:, keep].reshape(8, -1).T.astype(float)
    outside = flat - basis @ np.linalg.lstsq(basis, flat, rcond=None)[0]
    size = np.sqrt((outside**2).sum(axis=0) / len(keep))
    assert (size > 0.1).all()  # part of the field looks like modes
    assert (size < 0.6).all()


def test_neutral_coefficients_are_standard_normal(face):
    skin = face.skin()
    samples = simulate_neutrals(skin, 24, np.random.default_rng(2)) - skin.mean_shape
    basis = skin.identity_basis.reshape(len(skin.identity_basis), -1).T.astype(float)
    c = np.linalg.lstsq(basis, samples.reshape(24, -1).T.astype(float), rcond=None)[0][:10]
    assert abs(c.mean()) < 0.35
    assert 0.75 < c.std() < 1.25


def test_lips_are_sealed_as_in_the_mean(face):
    masks, mean = face.topology.masks, face.mean_shape
    upper, lower = masks["lip_contact_upper"], masks["lip_contact_lower"]
    people = simulate_neutrals(face, 12, np.random.default_rng(3))
    change = (people[:, upper] - people[:, lower]) - (mean[upper] - mean[lower])
    assert np.abs(change).max() < 0.8
    assert np.sqrt((change**2).sum(axis=2).mean()) < 0.15


def test_closed_lids_meet_whatever_the_amplitude(face):
    masks = face.topology.masks
    for seed in range(2):
        person = simulate_person(face, np.random.default_rng(seed))
        for side, shape in (("left", "eyeBlink_L"), ("right", "eyeBlink_R")):
            closed = person.neutral + person.deltas[BLENDSHAPE_NAMES.index(shape)]
            upper, lower = masks[f"lid_contact_upper_{side}"], masks[f"lid_contact_lower_{side}"]
            gap = np.linalg.norm(closed[upper] - closed[lower], axis=1)
            assert np.median(gap) < 0.6
            assert gap.max() < 2.5


def test_teeth_and_eyeballs_stay_rigid(face, person):
    for name in face.rigid_parts:
        ids = rigid_vertices(face, name)[:150]
        rest = person.neutral[ids].astype(float)
        between = np.linalg.norm(rest[:, None] - rest[None], axis=2)
        for delta in person.deltas[:, ids]:
            moved = rest + delta
            assert np.abs(np.linalg.norm(moved[:, None] - moved[None], axis=2) - between).max() < 1e-3


def test_amplitudes_are_in_range_with_sides_close_together(builtin_face):
    for seed in range(5):
        amplitudes = simulate_person(builtin_face.skin(), np.random.default_rng(seed)).amplitudes
        assert amplitudes.min() > AMPLITUDE[0] * 0.92
        assert amplitudes.max() < AMPLITUDE[1] * 1.08
        for i, name in enumerate(BLENDSHAPE_NAMES):
            if name.endswith("_L"):
                ratio = amplitudes[i] / amplitudes[BLENDSHAPE_NAMES.index(mirrored_name(name))]
                assert 1 / 1.17 < ratio < 1.17


def test_personal_shapes_differ_from_generic_ones_as_much_as_asked(face, person):
    n = face.n_skin
    generic = face.blendshape_deltas[:, :n].astype(float)
    personal = person.deltas[:, :n].astype(float)
    for i, name in enumerate(BLENDSHAPE_NAMES):
        if rms(generic[i]) > 0.3 and "Blink" not in name:
            difference = rms(personal[i] - person.amplitudes[i] * generic[i]) / rms(person.amplitudes[i] * generic[i])
            assert PERTURBATION * 0.6 < difference < 0.6, name


def test_shapes_stay_local(face, person):
    n = face.n_skin
    still = np.linalg.norm(face.blendshape_deltas[:, :n], axis=2) < 1e-3
    brow = BLENDSHAPE_NAMES.index("browInnerUp_L")
    moved = np.linalg.norm(person.deltas[brow, :n], axis=1)
    low = still[brow] & (face.mean_shape[:n, 1] < face.mean_shape[face.topology.landmarks["fw74"][49], 1])
    assert moved[low].max() < 0.05


def test_pose_equals_the_obvious_sum(face, person, rng):
    weights = rng.random((2, 46))
    posed = person.pose(weights)
    assert posed.shape == (2, *person.neutral.shape)
    for row, vertices in zip(weights, posed):
        assert np.abs(reference.pose(person.neutral, person.deltas, row) - vertices).max() < 1e-3
    assert np.allclose(person.pose(weights[1]), posed[1], atol=1e-4)
    with pytest.raises(ShapeError, match="weights"):
        person.pose(np.zeros(47))


def test_a_population_is_people_stacked(builtin_face):
    skin = builtin_face.skin()
    seen = []
    tensor = simulate_population(skin, 3, np.random.default_rng(6), lambda *step: seen.append(step))
    assert tensor.shape == (3, 47, skin.topology.n_vertices, 3)
    assert tensor.dtype == np.float32
    assert seen[-1] == ("simulating people", 3, 3)
    assert np.array_equal(tensor[:, 0], simulate_neutrals(skin, 3, np.random.default_rng(6)))
    out = np.zeros_like(tensor)
    assert simulate_population(skin, 3, np.random.default_rng(6), out=out) is out
    assert np.array_equal(out, tensor)


def test_nobody_is_an_empty_population_and_less_is_refused(builtin_face):
    rng = np.random.default_rng(0)
    assert simulate_neutrals(builtin_face, 0, rng).shape[0] == 0
    assert simulate_population(builtin_face, 0, rng).shape[:2] == (0, 47)
    for draw in (simulate_neutrals, simulate_population):
        with pytest.raises(ValueRangeError, match="-1"):
            draw(builtin_face, -1, rng)
    with pytest.raises(ShapeError, match="out"):
        simulate_population(builtin_face, 1, rng, out=np.zeros((1, 2, 3), np.float32))
