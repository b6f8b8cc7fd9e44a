import numpy as np
import pytest

from facewright.errors import ValueRangeError
from facewright.landmarks.scheme import SCHEME_NAMES, LandmarkScheme, load_map, load_scheme

MAPS = [("mediapipe478", "fw74"), ("mediapipe478", "ibug68"), ("ibug68", "fw74"), ("fw74", "ibug68")]


@pytest.mark.parametrize("name", SCHEME_NAMES)
def test_schemes_are_consistent(name):
    scheme = load_scheme(name)
    assert scheme.name == name
    assert scheme.n_points == {"fw74": 74, "ibug68": 68, "mediapipe478": 478}[name]
    np.testing.assert_array_equal(scheme.mirror[scheme.mirror], np.arange(scheme.n_points))
    assert len(set(scheme.names)) == scheme.n_points
    assert sorted([*scheme.fixed, *scheme.sliding]) == list(range(scheme.n_points))
    for group, ids in scheme.groups.items():
        other = group.replace("right", "#").replace("left", "right").replace("#", "left")
        assert set(scheme.mirror[ids]) == set(scheme.groups[other])
    for line in scheme.lines:
        assert line.min() >= 0 and line.max() < scheme.n_points


@pytest.mark.parametrize("name", ["fw74", "ibug68"])
def test_groups_tile_the_points_and_names_mirror(name):
    scheme = load_scheme(name)
    assert sorted(np.concatenate(list(scheme.groups.values()))) == list(range(scheme.n_points))
    for i in np.setdiff1d(np.arange(scheme.n_points), scheme.sliding):
        swapped = scheme.names[i].replace("right", "#").replace("left", "right").replace("#", "left")
        assert scheme.names[scheme.mirror[i]] == swapped


def test_fw74_has_the_paper_s_counts():
    groups = load_scheme("fw74").groups
    counts = {
        "contour": 15, "right_brow": 6, "left_brow": 6, "right_eye": 8, "left_eye": 8,
        "nose": 11, "outer_mouth": 12, "inner_mouth": 8,
    }  # fmt: skip
    assert {key: len(ids) for key, ids in groups.items()} == counts
    assert load_scheme("fw74").index("nose_tip") == 45


@pytest.mark.parametrize(("source", "target"), MAPS)
def test_maps_mix_and_mirror(source, target):
    mapping, a, b = load_map(source, target), load_scheme(source), load_scheme(target)
    assert mapping.weights.shape == (b.n_points, a.n_points)
    sums = mapping.weights.sum(axis=1)
    np.testing.assert_allclose(sums[mapping.available], 1.0)
    assert (mapping.weights >= 0).all()
    # the mirrored target is made from the mirrored source
    np.testing.assert_allclose(mapping.weights[b.mirror][:, a.mirror], mapping.weights)
    if source == "mediapipe478":
        assert mapping.available.all()


def test_maps_agree_where_schemes_share_points():
    there, back = load_map("fw74", "ibug68"), load_map("ibug68", "fw74")
    mouth = load_scheme("fw74").groups["outer_mouth"]
    np.testing.assert_allclose((back.weights @ there.weights)[np.ix_(mouth, mouth)], np.eye(len(mouth)))


def test_identity_map():
    np.testing.assert_array_equal(load_map("fw74", "fw74").weights, np.eye(74))


def test_refuses_unknown_names():
    with pytest.raises(ValueRangeError, match="fw74"):
        load_scheme("wflw98")
    with pytest.raises(ValueRangeError, match="no map"):
        load_map("fw74", "mediapipe478")
    with pytest.raises(ValueRangeError):
        load_scheme("fw74").index("third_eye")


def test_refuses_a_mirror_that_is_no_involution():
    with pytest.raises(ValueRangeError, match="inverse"):
        LandmarkScheme("x", "", ("a", "b", "c"), {}, (), np.array([1, 2, 0], np.int32), np.empty(0, np.int32))
