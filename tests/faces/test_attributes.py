from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from facewright.errors import ShapeError, TopologyError, ValueRangeError
from facewright.faces.attributes import (
    ATTRIBUTE_MEANINGS,
    ATTRIBUTE_NAMES,
    attribute_names,
    attribute_points,
    measure_attributes,
    measure_points,
)


@pytest.fixture(scope="module")
def skin(builtin_face):
    return builtin_face.skin()


def moved(face, landmarks, offset):
    """The mean face with some landmarks, and everything near them, shifted."""
    shape = face.mean_shape.astype(float)
    ids = face.topology.landmarks["fw74"][landmarks]
    result = shape.copy()
    result[ids] += offset
    return result


def change(face, landmarks, offset):
    before = measure_attributes(face.mean_shape, face.topology)
    after = measure_attributes(moved(face, landmarks, offset), face.topology)
    return dict(zip(ATTRIBUTE_NAMES, after - before))


def test_measures_of_the_generic_face_are_a_face_s(skin):
    measured = dict(zip(ATTRIBUTE_NAMES, measure_attributes(skin.mean_shape, skin.topology)))
    assert set(ATTRIBUTE_MEANINGS) == set(ATTRIBUTE_NAMES)
    assert 105 < measured["face length"] < 125  # anthropometric means of adults, mm
    assert 125 < measured["face width"] < 150
    assert 45 < measured["mouth width"] < 58
    assert 30 < measured["eye spacing"] < 42
    assert 15 < measured["nose height"] < 32


@pytest.mark.parametrize(
    ("name", "landmarks", "offset", "expected"),
    [
        ("mouth width", [60], [3.0, 0, 0], 3.0),
        ("face length", [7], [0, -4.0, 0], 4.0),
        ("chin height", [7], [0, -4.0, 0], 4.0),
        ("nose height", [45], [0, 0, 2.0], 2.0),
        ("nose width", [46], [-1.5, 0, 0], 1.5),
        ("jaw width", [4, 5], [-2.0, 0, 0], 2.0),
        ("eye spacing", [31], [-1.0, 0, 0], 1.0),
        ("brow height", [16, 17, 18, 19, 22, 23, 24, 25], [0, 3.0, 0], 3.0),
    ],
)
def test_a_moved_feature_is_measured_in_millimetres(skin, name, landmarks, offset, expected):
    assert change(skin, landmarks, np.array(offset))[name] == pytest.approx(expected, rel=0.12)


def test_full_cheeks_high_forehead_and_large_eyes(skin):
    topology, mean = skin.topology, skin.mean_shape.astype(float)
    before = dict(zip(ATTRIBUTE_NAMES, measure_attributes(mean, topology)))
    cheeks = np.concatenate([topology.masks["cheeks_left"], topology.masks["cheeks_right"]])
    full = mean.copy()
    full[cheeks] += 2.0 * np.sign(full[cheeks, :1]) * [0.6, 0, 0] + [0, 0, 1.6]
    high = mean.copy()
    high[topology.masks["forehead"], 1] += 3.0
    eyes = topology.landmarks["fw74"][27:43]
    large = mean.copy()
    large[eyes, 1] = mean[eyes, 1].mean() + 1.2 * (mean[eyes, 1] - mean[eyes, 1].mean())

    def after(shape, name):
        return dict(zip(ATTRIBUTE_NAMES, measure_attributes(shape, topology)))[name] - before[name]

    assert 1.0 < after(full, "cheek fullness") < 2.5
    assert after(high, "forehead height") == pytest.approx(6.0, rel=0.1)
    assert after(large, "eye size") > 0.5


def test_the_head_s_pose_does_not_matter(skin, rng):
    turned = skin.mean_shape @ Rotation.from_euler("yxz", [25, -15, 8], degrees=True).as_matrix().T + [5, -20, 300]
    measured = measure_attributes(np.stack([skin.mean_shape, turned]), skin.topology)
    np.testing.assert_allclose(measured[0], measured[1], atol=1e-3)


def test_points_are_linear_in_the_vertices(skin):
    basis = skin.identity_basis[:5]
    c = np.array([1.0, -2.0, 0.5, 0.0, 3.0])
    whole = attribute_points(skin.mean_shape + np.tensordot(c, basis, 1), skin.topology)
    parts = attribute_points(skin.mean_shape, skin.topology) + np.tensordot(
        c, attribute_points(basis, skin.topology), 1
    )
    np.testing.assert_allclose(whole, parts, atol=1e-3)


def test_a_topology_without_vertex_sets_has_fewer_attributes(skin):
    bare = replace(skin.topology, masks={})
    names = attribute_names(bare)
    assert set(ATTRIBUTE_NAMES) - set(names) == {"forehead height", "cheek fullness"}
    measured = measure_attributes(skin.mean_shape, bare)
    assert measured.shape == (len(names),) and np.isfinite(measured).all()


def test_refuses(skin):
    with pytest.raises(TopologyError, match="fw74"):
        measure_attributes(skin.mean_shape, replace(skin.topology, landmarks={}))
    with pytest.raises(ShapeError):
        measure_attributes(skin.mean_shape[:-1], skin.topology)
    with pytest.raises(ValueRangeError, match="got 'smile'"):
        measure_points(attribute_points(skin.mean_shape, skin.topology)[None], ("smile",))
