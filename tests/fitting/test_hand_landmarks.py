import numpy as np
import pytest

from facewright.errors import NoFaceError, ShapeError, ValueRangeError
from facewright.fitting.hand_landmarks import landmarks_from_points
from facewright.landmarks.scheme import load_scheme


@pytest.fixture
def scan(builtin_face, rng):
    """A person in centimetres, turned and moved."""
    from facewright.camera.rotation import rotation_from_vector

    weights = rng.normal(size=len(builtin_face.identity_basis))
    person = builtin_face.mean_shape + np.tensordot(weights, builtin_face.identity_basis, 1)
    return 0.1 * person @ rotation_from_vector(rng.normal(size=3)).T + 20.0


def errors_mm(face, landmarks, confidence, scan):
    true = scan[face.topology.landmarks["fw74"]]
    return 10.0 * np.linalg.norm(landmarks - true, axis=1)[confidence > 0]


def test_74_points_stay_what_they_are(builtin_face, scan):
    true = scan[builtin_face.topology.landmarks["fw74"]]
    true[20] = np.nan
    landmarks, confidence = landmarks_from_points(builtin_face, true)
    np.testing.assert_array_equal(landmarks, true)
    assert confidence[20] == 0 and confidence.sum() == 73


def test_68_points_become_the_templates_own_landmarks(builtin_face, scan):
    points = scan[builtin_face.topology.landmarks["ibug68"]]
    landmarks, confidence = landmarks_from_points(builtin_face, points)
    assert (confidence[load_scheme("fw74").sliding] == 0).all()
    assert (confidence > 0).sum() >= 55
    assert np.sqrt((errors_mm(builtin_face, landmarks, confidence, scan) ** 2).mean()) < 1.5
    sure = confidence > 0.9
    true = scan[builtin_face.topology.landmarks["fw74"]]
    assert 10 * np.linalg.norm(landmarks - true, axis=1)[sure].max() < 1.5


def test_missing_ones_of_68_points_cost_little(builtin_face, scan):
    points = scan[builtin_face.topology.landmarks["ibug68"]]
    points[[30, 40, 50]] = np.nan
    landmarks, confidence = landmarks_from_points(builtin_face, points)
    assert np.sqrt((errors_mm(builtin_face, landmarks, confidence, scan) ** 2).mean()) < 2.0


@pytest.mark.parametrize("eyes", [([31], [39]), ([27], [35]), (range(27, 35), range(35, 43))])
@pytest.mark.parametrize("left_first", [False, True])
def test_five_points_of_any_convention(builtin_face, scan, eyes, left_first):
    true = scan[builtin_face.topology.landmarks["fw74"]]
    five = np.stack([true[list(eyes[0])].mean(0), true[list(eyes[1])].mean(0), true[45], true[54], true[60]])
    if left_first:
        five = five[[1, 0, 2, 4, 3]]
    landmarks, confidence = landmarks_from_points(builtin_face, five)
    sure = confidence == 1
    assert sure.sum() == (5 if len(eyes[0]) == 1 else 3)
    np.testing.assert_allclose(landmarks[sure], true[sure], atol=1e-6)
    implied = (confidence > 0) & ~sure
    assert 10 * np.median(np.linalg.norm(landmarks - true, axis=1)[implied]) < 5.0


def test_what_is_no_face_is_refused(builtin_face, scan, rng):
    true = scan[builtin_face.topology.landmarks["fw74"]]
    five = true[[31, 39, 45, 54, 60]]
    for wrong in (five[[3, 4, 2, 0, 1]], five[[1, 0, 2, 3, 4]], rng.normal(size=(5, 3))):
        with pytest.raises(NoFaceError):
            landmarks_from_points(builtin_face, wrong)
    with pytest.raises(ValueRangeError, match="size"):
        landmarks_from_points(builtin_face, 3.0 * five)
    with pytest.raises(ValueRangeError, match="finite"):
        landmarks_from_points(builtin_face, five * np.nan)
    with pytest.raises(ShapeError, match="74"):
        landmarks_from_points(builtin_face, true[:20])
