"""A dense character driven through precomputed weights, against the same in plain NumPy."""

import importlib.util
from pathlib import Path

import numpy as np
import pytest
from scipy import sparse
from scipy.spatial.transform import Rotation

from facewright.errors import ShapeError, ValueRangeError
from facewright.models.character_contact import RADIUS_BINS, LidClearance, Seals
from facewright.models.dense_drive import CharacterWeights, DenseDriver, JawFollowers
from facewright.models.region_blend import RegionBlend

_spec = importlib.util.spec_from_file_location("reference_regions", Path(__file__).with_name("reference_regions.py"))
reference = importlib.util.module_from_spec(_spec)
_spec.loader.exec_module(reference)

V, N = 60, reference.N


def _weights(rng, **parts):
    follow = sparse.random(V, N, density=0.2, random_state=np.random.RandomState(3), format="csr")
    turns = Rotation.random(N, random_state=4).as_matrix() * rng.uniform(0.8, 1.2, (N, 1, 1))
    rest = rng.normal(size=(V, 3)).astype(np.float32) * 30
    parts = {"jaw": JawFollowers.none(V), **parts}
    return CharacterWeights(rest, follow, turns, **parts)


def _jaw(rng):
    shares = np.zeros(V)
    shares[40:50], shares[50:55] = 1.0, 0.4
    return JawFollowers(
        points=np.array([3, 9, 30]),
        matrix=rng.normal(size=(6, 9)) * 0.05,
        centre=np.array([0.0, -40.0, 20.0]),
        shares=shares,
        skin_ids=np.array([1, 7]),
        skin_lean=rng.normal(size=(2, 3, 6)),
    )


def test_vertices_follow_by_weights_and_jaw(rng):
    weights = _weights(rng, jaw=_jaw(rng))
    moved = rng.normal(size=(N, 3)) * 3
    carried = np.einsum("nab,nb->na", weights.turns, moved)
    expected = weights.rest + weights.follow @ carried
    motion = weights.jaw.matrix @ carried[weights.jaw.points].ravel()
    arms = weights.rest - weights.jaw.centre
    turned = arms @ Rotation.from_rotvec(motion[:3]).as_matrix().T + motion[3:] - arms
    expected = expected + weights.jaw.shares[:, None] * turned
    expected[weights.jaw.skin_ids] += weights.jaw.skin_lean @ motion
    model = reference.small_model(rng)
    np.testing.assert_allclose(DenseDriver(model, weights).drive(moved), expected, atol=2e-4)


def test_coefficients_go_straight_into_the_callers_buffer(rng):
    model, weights = reference.small_model(rng), _weights(rng)
    driver = DenseDriver(model, weights, "gradient")
    zeta, out = rng.normal(size=15), np.zeros((V, 3), np.float32)
    assert driver.positions(zeta, out) is out
    moved = RegionBlend(model, "gradient").displacements(zeta)
    np.testing.assert_allclose(
        out, weights.rest + weights.follow @ np.einsum("nab,nb->na", weights.turns, moved), atol=1e-4
    )
    assert driver.n_vertices == V


def test_nothing_moves_at_rest(rng):
    model, weights = reference.small_model(rng), _weights(rng, jaw=_jaw(rng))
    np.testing.assert_array_equal(DenseDriver(model, weights).positions(np.zeros(15)), weights.rest)


def test_crossing_pairs_meet_and_open_ones_stay(rng):
    """Three pairs: one crosses by 2 mm, one is all but closed, one is wide open."""
    rest = np.zeros((V, 3), np.float32)
    rest[:3, 1] = [-2.0, 0.1, 9.0]
    seals = Seals(
        upper=np.arange(3),
        lower=np.arange(3, 6),
        floors=np.zeros(3),
        reaches=np.full(3, 0.6),
        moved=np.arange(6),
        spread=np.vstack([0.5 * np.eye(3), -0.5 * np.eye(3)]),
    )
    weights = CharacterWeights(
        rest, sparse.csr_matrix((V, N)), np.tile(np.eye(3), (N, 1, 1)), JawFollowers.none(V), seals
    )
    out = DenseDriver(reference.small_model(rng), weights).drive(np.zeros((N, 3)))
    np.testing.assert_allclose(out[:3, 1] - out[3:6, 1], [0.0, 0.0, 9.0], atol=1e-6)
    np.testing.assert_allclose(out[0, 1], -1.0, atol=1e-6)  # half the way each


def test_lids_stay_outside_the_eyeball(rng):
    rest = np.zeros((V, 3), np.float32)
    rest[:3] = [[0, 0, 11.0], [0, 6.0, 6.0], [0, 0, 15.0]]
    lids = LidClearance(
        ids=np.arange(3),
        eye=np.zeros(3, int),
        margins=np.array([0.5, 0.5, 0.5]),
        centres=np.zeros((1, 3)),
        radii=np.full((1, RADIUS_BINS), 12.0),
    )
    weights = CharacterWeights(
        rest, sparse.csr_matrix((V, N)), np.tile(np.eye(3), (N, 1, 1)), JawFollowers.none(V), lids=lids
    )
    out = DenseDriver(reference.small_model(rng), weights).drive(np.zeros((N, 3)))
    np.testing.assert_allclose(np.linalg.norm(out[:3], axis=1), [12.5, 12.5, 15.0], atol=1e-5)
    np.testing.assert_allclose(out[1, :2], [0.0, 6.0], atol=1e-6)  # at its height: lids that meet go on meeting


def test_wrong_shapes_are_refused(rng):
    model = reference.small_model(rng)
    weights = _weights(rng)
    driver = DenseDriver(model, weights)
    with pytest.raises(ShapeError, match="moved"):
        driver.drive(np.zeros((N - 1, 3)))
    with pytest.raises(ShapeError, match="out"):
        driver.drive(np.zeros((N, 3)), np.zeros((V + 1, 3), np.float32))
    with pytest.raises(ShapeError, match="zeta"):
        driver.positions(np.zeros(3))
    with pytest.raises(ShapeError, match="follow the model's 45"):
        other = CharacterWeights(weights.rest, sparse.csr_matrix((V, 7)), np.zeros((7, 3, 3)), JawFollowers.none(V))
        DenseDriver(model, other)
    with pytest.raises(ShapeError):
        CharacterWeights(weights.rest[:-1], weights.follow, weights.turns, weights.jaw)
    with pytest.raises(ValueRangeError, match="finite"):
        CharacterWeights(weights.rest * np.nan, weights.follow, weights.turns, weights.jaw)
