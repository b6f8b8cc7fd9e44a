import numpy as np
import pytest

from facewright.faces.acting_skin import ActingSkin, swing_of
from facewright.faces.acting_timing import SHAPE_INDEX
from facewright.faces.simulate import simulate_person


@pytest.fixture(scope="module")
def person(builtin_face):
    return simulate_person(builtin_face, np.random.default_rng(11))


@pytest.fixture(scope="module")
def skin(builtin_face, person):
    return ActingSkin(builtin_face, person, np.random.default_rng(12))


def weights_of(**named):
    weights = np.zeros((1, 46))
    for name, value in named.items():
        weights[0, SHAPE_INDEX[name]] = value
    return weights


def lip_heights(face, vertices):
    upper, lower = (vertices[:, face.topology.masks[f"lip_contact_{which}"]] for which in ("upper", "lower"))
    return (upper - lower)[..., 1]


def test_rest_is_the_neutral_and_single_shapes_are_the_persons(skin, person):
    assert np.allclose(skin.positions(np.zeros((1, 46)))[0], person.neutral, atol=0.02)
    for name in ("browDown_L", "mouthSmile_R", "jawOpen", "eyeBlink_L", "cheekPuff_R"):
        posed = skin.positions(weights_of(**{name: 1.0}))[0]
        assert np.abs(posed - person.neutral - person.deltas[SHAPE_INDEX[name]]).max() < 0.75, name


def test_ways_are_curved_and_shapes_do_not_add_up(builtin_face, skin, person):
    n = builtin_face.n_skin
    half = skin.positions(weights_of(mouthSmile_L=0.5))[0] - person.neutral
    straight = 0.5 * person.deltas[SHAPE_INDEX["mouthSmile_L"]]
    assert 0.05 < np.linalg.norm((half - straight)[:n]) / np.linalg.norm(straight[:n]) < 0.5
    one, other = weights_of(jawOpen=0.8), weights_of(mouthSmile_L=0.9, mouthSmile_R=0.9)
    both = skin.positions(one + other)[0] - person.neutral
    apart = skin.positions(one)[0] + skin.positions(other)[0] - 2.0 * person.neutral
    assert 0.5 < np.linalg.norm((both - apart)[:n], axis=1).max() < 12.0


def test_the_jaw_turns_about_a_hinge(builtin_face, skin, person):
    teeth = builtin_face.topology.part_slice("teeth_lower")
    rest = person.neutral[teeth].astype(float)
    for opening in (0.25, 0.5, 0.75, 1.0):
        moved = skin.positions(weights_of(jawOpen=opening), vertices=np.arange(len(person.neutral))[teeth])[0]
        straight = rest + opening * person.deltas[SHAPE_INDEX["jawOpen"]][teeth]
        apart, turned, slid = (
            np.linalg.norm(points[:, None] - points[None], axis=2) for points in (rest, moved.astype(float), straight)
        )
        # nearly rigid at every angle, which a straight way is not
        assert np.abs(turned - apart).max() < max(0.3 * np.abs(slid - apart).max(), 0.01)
    chin = builtin_face.topology.landmarks["ibug68"][8]
    way = skin.positions(np.linspace(0, 1, 21)[:, None] * weights_of(jawOpen=1.0), vertices=np.array([chin]))[:, 0]
    straight = way[0] + np.linspace(0, 1, 21)[:, None] * (way[-1] - way[0])
    assert 0.5 < np.linalg.norm(way - straight, axis=1).max() < 8.0


def test_lips_do_not_cross_and_sealed_lips_meet(builtin_face, skin, rng):
    weights = np.clip(rng.normal(0.0, 0.5, (200, 46)), 0, 1)
    close, jaw = SHAPE_INDEX["mouthClose"], SHAPE_INDEX["jawOpen"]
    weights[:, close] = np.minimum(weights[:, close], weights[:, jaw])
    heights = lip_heights(builtin_face, skin.positions(weights))
    assert heights.min() > -1.5 and np.median(heights.min(axis=1)) > -0.3
    crossing = skin.neutral + np.einsum("tk,kvc->tvc", weights, skin._basis[:46].astype(float))
    assert lip_heights(builtin_face, crossing).min() < 2.0 * heights.min()
    sealed = weights.copy()
    sealed[:, close] = sealed[:, jaw]
    shut = np.abs(lip_heights(builtin_face, skin.positions(sealed[sealed[:, jaw] > 0.1])))
    assert np.quantile(shut, 0.9) < 1.0


def test_a_part_of_the_vertices_is_the_same_as_all(skin, rng):
    weights, swing = rng.uniform(0, 0.7, (6, 46)), rng.normal(size=(6, 3))
    every = skin.positions(weights, swing)
    ids = rng.permutation(len(skin.neutral))[:300]
    assert np.allclose(skin.positions(weights, swing, ids), every[:, ids], atol=1e-3)
    assert np.allclose(skin.positions(weights, swing, slice(10, 90)), every[:, 10:90], atol=1e-3)


def test_soft_tissue_swings_where_it_is_soft(builtin_face, skin):
    weights = np.zeros((1, 46))
    moved = skin.positions(weights, np.array([[0.0, -1.0, 0.0]]))[0] - skin.positions(weights)[0]
    masks = builtin_face.topology.masks
    assert moved[masks["cheeks_left"], 1].min() < -0.6
    assert np.abs(moved[masks["forehead"]]).max() < 0.1 and np.abs(moved[:, [0, 2]]).max() < 1e-3


def test_swing_is_a_damped_lag_behind_the_head():
    times = np.arange(360) / 120.0
    steady = np.stack([100.0 * times, 0 * times, 0 * times], axis=1)
    upright = np.repeat(np.eye(3)[None], len(times), axis=0)
    assert np.abs(swing_of(upright, steady, 1 / 120)).max() < 1e-9
    pushed = np.zeros((360, 3))
    pushed[:, 0] = 20.0 * np.clip((times - 1.0) / 0.15, 0, 1) ** 2  # sets off to its left
    lag = swing_of(upright, pushed, 1 / 120)
    assert np.abs(lag[:115]).max() == 0 and lag[120:130, 0].min() < -0.2 and np.abs(lag[-1]).max() < 0.02
    turned = np.array([[0.0, 0.0, 1.0], [0.0, 1.0, 0.0], [-1.0, 0.0, 0.0]])
    assert np.allclose(swing_of(upright @ turned, pushed, 1 / 120) @ turned.T, lag)
    assert (swing_of(upright[:2], steady[:2], 1 / 120) == 0).all()
