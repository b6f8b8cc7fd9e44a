import numpy as np
import pytest

from facewright.fitting.scan_contact import ContactPairs
from facewright.fitting.scan_target import ScanTarget
from facewright.landmarks.scheme import load_scheme


def target(lips_mm=0.5, lids_mm=9.0):
    """Landmarks whose lips and lids are so far apart; no surface to speak of."""
    names = load_scheme("fw74").names
    points = np.zeros((74, 3))
    for i, name in enumerate(names):
        points[i, 1] = -lips_mm if name.startswith("lower_lip_inner") else 0.0
        points[i, 1] -= lids_mm if "lower_lid_middle" in name else 0.0
    tri = np.array([[0.0, 0, 0], [1, 0, 0], [0, 1, 0]])
    return ScanTarget(tri, np.tile([0, 0, 1.0], (3, 1)), np.array([[0, 1, 2]], np.int32), points, np.ones(74))


@pytest.fixture(scope="module")
def contacts(builtin_face):
    return ContactPairs(builtin_face.skin())


def energy_matrix(term):
    return np.asarray(term.matrix.diagonal())


def test_sealed_lips_get_springs_and_open_lids_none(contacts):
    term = contacts.term(None, target(), np.eye(3), 2.0)
    diagonal = energy_matrix(term)
    upper, lower = contacts.pairs["lips"]
    assert (diagonal[upper] > 0).all() and (diagonal[lower] > 0).all()
    for lids in ("lids_left", "lids_right"):
        assert (diagonal[contacts.pairs[lids][0]] == 0).all()
    assert abs(term.matrix - term.matrix.T).max() == 0
    np.testing.assert_allclose(term.matrix @ np.ones(contacts.n_vertices), 0, atol=1e-12)
    np.testing.assert_allclose(term.rhs.sum(axis=0), 0, atol=1e-9)


def test_lips_that_the_picture_shows_open_are_free(contacts):
    assert contacts.term(None, target(lips_mm=8.0), np.eye(3), 2.0).closed_share == 0


def test_lips_that_the_weights_open_are_free(contacts, builtin_face):
    weights = np.zeros(46)
    weights[builtin_face.blendshape_names.index("jawOpen")] = 1.0
    diagonal = energy_matrix(contacts.term(weights, target(), np.eye(3), 2.0))
    assert (diagonal[contacts.pairs["lips"][0]] > 0).mean() < 0.3


def test_lids_close_only_when_both_say_so(contacts, builtin_face):
    weights = np.zeros(46)
    weights[[builtin_face.blendshape_names.index(f"eyeBlink_{s}") for s in "LR"]] = 1.0
    closed = energy_matrix(contacts.term(weights, target(lids_mm=1.0), np.eye(3), 2.0))
    still_open = energy_matrix(contacts.term(weights, target(lids_mm=8.0), np.eye(3), 2.0))
    upper = contacts.pairs["lids_left"][0]
    assert (closed[upper] > 0).mean() > 0.8
    assert (still_open[upper] == 0).all()


def test_the_springs_pull_to_the_offset_at_rest(contacts, builtin_face):
    """At the mean, whose lips touch, the springs are at rest: gradient zero."""
    mean = builtin_face.skin().mean_shape.astype(float)
    turn = np.diag([1.0, -1.0, -1.0])
    term = contacts.term(None, target(), turn, 2.0)
    x = mean @ turn.T
    np.testing.assert_allclose(term.matrix @ x, term.rhs, atol=1e-6)
