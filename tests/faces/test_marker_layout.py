import dataclasses

import numpy as np
import pytest
from scipy.spatial import cKDTree

from facewright.errors import DegenerateError, TopologyError, ValueRangeError
from facewright.faces.marker_layout import MarkerLayout, draw_marker_layout, marker_region
from facewright.mesh.closest_point import closest_points
from facewright.mesh.topology import Topology


@pytest.fixture(scope="module")
def layout(builtin_face):
    return draw_marker_layout(builtin_face, builtin_face.mean_shape, np.random.default_rng(0))


def test_markers_are_about_a_centimetre_apart(builtin_face, layout):
    feet = layout.feet(builtin_face.mean_shape)
    nearest = cKDTree(feet).query(feet, k=2)[0][:, 1]
    assert 8.5 < nearest.mean() < 10.5 and nearest.min() > 5.0 and nearest.max() < 15.0
    assert 200 < len(layout.labels) < 400 and len(set(layout.labels)) == len(layout.labels)


def test_spheres_stand_off_the_skin_by_their_radius(builtin_face, layout):
    skin = builtin_face.skin()
    centres = layout.centres(skin.mean_shape)
    on_skin = closest_points(skin.mean_shape, skin.topology.faces, centres)
    assert np.median(on_skin.distances) == pytest.approx(1.5, abs=0.02)
    assert on_skin.distances.max() < 1.5 + 1e-6
    assert np.linalg.norm(centres - layout.feet(skin.mean_shape), axis=1) == pytest.approx(1.5)


def test_markers_follow_any_pose_of_the_skin(builtin_face, layout, rng):
    posed = builtin_face.mean_shape + builtin_face.blendshape_deltas[[3, 18]]
    together = layout.centres(posed)
    assert together.shape == (2, len(layout.labels), 3)
    assert np.allclose(together[1], layout.centres(posed[1]))
    turn = np.linalg.qr(rng.normal(size=(3, 3)))[0]
    turn *= np.linalg.det(turn)
    assert np.allclose(layout.centres(posed[0] @ turn.T + 5.0), together[0] @ turn.T + 5.0, atol=1e-3)


def test_lids_lips_ears_and_neck_stay_free(builtin_face, layout):
    masks, rest = builtin_face.topology.masks, builtin_face.mean_shape.astype(float)
    feet = cKDTree(layout.feet(rest))
    for name, distance in (
        ("lip_contact_upper", 3.0),
        ("lash_line_left", 2.5),
        ("lash_line_right", 2.5),
        ("nostril_insides", 1.0),
        ("ears", 2.0),
    ):
        assert feet.query(rest[masks[name]])[0].min() > distance, name
    chin = rest[builtin_face.topology.landmarks["ibug68"][8]]
    assert feet.data[:, 1].min() > chin[1] - 8
    # forehead, cheeks, chin and both lips have some
    brows = rest[builtin_face.topology.landmarks["ibug68"][17:27], 1].max()
    assert (feet.data[:, 1] > brows + 20).sum() > 10
    corner_left, top, _, bottom = rest[builtin_face.topology.landmarks["ibug68"][[54, 51, 48, 57]]]
    for rim in (corner_left, top, bottom):
        assert feet.query(rim)[0] < 9.0


def test_layouts_are_nearly_symmetric_and_no_two_alike(builtin_face, layout):
    feet = layout.feet(builtin_face.mean_shape)
    other = draw_marker_layout(builtin_face, builtin_face.mean_shape, np.random.default_rng(1))
    mirrored = cKDTree(feet).query(feet * [-1, 1, 1])[0]
    apart = cKDTree(feet).query(other.feet(builtin_face.mean_shape))[0]
    assert np.median(mirrored) < 2.0 < np.median(apart)


def test_larger_faces_wear_more(builtin_face, layout):
    larger = draw_marker_layout(builtin_face, 1.15 * builtin_face.mean_shape, np.random.default_rng(0))
    assert len(larger.labels) > 1.15 * len(layout.labels)


def test_the_ict_face_can_wear_markers(ict_face):
    allowed = marker_region(ict_face, ict_face.mean_shape)
    assert 0.3 < allowed.mean() < 0.8
    inside = ict_face.mean_shape[: ict_face.n_skin][allowed]
    for side in (-1, 1):  # nostrils
        assert np.linalg.norm(inside - [7.0 * side, -5.0, 117.0], axis=1).min() > 3.0
    assert abs((inside[:, 0] > 0).mean() - 0.5) < 0.03


def test_mistakes_are_refused(builtin_face):
    rng = np.random.default_rng(0)
    with pytest.raises(ValueRangeError, match="spacing_mm"):
        draw_marker_layout(builtin_face, builtin_face.mean_shape, rng, spacing_mm=0.0)
    t = builtin_face.topology
    bare = dataclasses.replace(builtin_face, topology=Topology(t.name, t.n_vertices, t.faces, parts=t.parts))
    with pytest.raises(TopologyError, match="face_region"):
        marker_region(bare, builtin_face.mean_shape)
    masks = {**t.masks, "face_region": t.masks["face_region"][:2]}
    tiny = dataclasses.replace(builtin_face, topology=dataclasses.replace(t, masks=masks))
    with pytest.raises(DegenerateError, match="room"):
        draw_marker_layout(tiny, builtin_face.mean_shape, rng)
    with pytest.raises(ValueError, match="corners"):
        MarkerLayout(("a", "b"), np.zeros((1, 3), np.int32), np.zeros((2, 3)))
