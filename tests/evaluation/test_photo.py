import numpy as np
import pytest

from facewright.apps.true_landmarks import true_landmarks
from facewright.camera.rotation import head_angles_from_rotation
from facewright.errors import TopologyError, ValueRangeError
from facewright.evaluation import photo as suite
from facewright.evaluation.photo import render_photo, run
from facewright.evaluation.simulated_photo import simulate_photo


@pytest.fixture(scope="module")
def photo(builtin_face):
    return simulate_photo(builtin_face, np.random.default_rng(2))


def test_pictures_keep_their_limits(photo, builtin_face):
    yaw, pitch, roll = head_angles_from_rotation(photo.camera_from_model.rotation)
    assert abs(yaw) <= 35 and abs(pitch) <= 20 and abs(roll) <= 20
    ids = builtin_face.skin().topology.landmarks["fw74"]
    inner = photo.landmarks.definition.fixed
    seen = photo.intrinsics.project(photo.camera_from_model.apply(photo.vertices[ids[inner]]))
    np.testing.assert_allclose(photo.landmarks.points[inner], seen)
    height, width = photo.image_size
    assert (photo.landmarks.points >= 0).all() and (photo.landmarks.points < [width, height]).all()


def test_contour_points_lie_on_the_outline_from_temple_to_temple(photo):
    contour = photo.landmarks.points[photo.landmarks.definition.sliding]
    middle = photo.landmarks.points[43:54].mean(axis=0)
    angles = np.unwrap(np.arctan2(*(contour - middle).T[::-1]))
    assert (np.diff(angles) < 0).all()  # from the picture's left, over the chin, to its right
    assert np.linalg.norm(contour - middle, axis=1).min() > 0.5 * photo.landmarks.interocular_distance()


def test_same_seed_same_picture(photo, builtin_face):
    again = simulate_photo(builtin_face, np.random.default_rng(2))
    np.testing.assert_array_equal(again.vertices, photo.vertices)
    a, b = (photo.noisy_landmarks(1.0, np.random.default_rng(1)).points for _ in range(2))
    np.testing.assert_array_equal(a, b)
    assert 0.8 < (a - photo.landmarks.points).std() < 1.2


def test_rendering_shows_the_head(photo, builtin_face):
    picture = render_photo(builtin_face, photo, np.random.default_rng(0))
    assert picture.shape == (*photo.image_size, 3)
    x, y = photo.landmarks.points[45].astype(int)
    assert (picture[y, x] != picture[0, 0]).any()


def test_refuses_bad_input(builtin_face):
    with pytest.raises(ValueRangeError, match="subjects"):
        run(builtin_face, 0, subjects=0)
    from dataclasses import replace

    skin = builtin_face.skin()
    bare = replace(skin.topology, landmarks={})
    with pytest.raises(TopologyError):
        true_landmarks(bare, skin.mean_shape, skin.mean_shape, None, None)


def test_model_is_the_size_of_the_papers():
    assert (suite.N_PEOPLE, suite.N_IDENTITY, suite.N_EXPRESSION) == (150, 50, 25)


@pytest.mark.slow
def test_suite_beats_the_mean_face(builtin_face, monkeypatch):
    monkeypatch.setattr(suite, "N_PEOPLE", 60)
    monkeypatch.setattr(suite, "N_IDENTITY", 40)
    metrics = run(builtin_face, 1, subjects=6)
    assert metrics["surface_mm"] < 0.8 * metrics["mean_face_mm"]
    assert metrics["correspondence_mm"] < 0.8 * metrics["mean_face_correspondence_mm"]
    assert metrics["similarity_surface_mm"] < 0.8 * metrics["similarity_mean_face_mm"]
    assert metrics["similarity_surface_mm"] < metrics["surface_mm"]
    assert metrics["reprojection_iod"] < 0.03
    if "detection_rate" in metrics:
        assert metrics["detection_rate"] == 1.0
        assert metrics["astronaut_iod"] <= 0.03
