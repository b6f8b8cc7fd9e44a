import numpy as np
import pytest

from facewright.camera.rotation import rotation_from_vector
from facewright.errors import ValueRangeError
from facewright.evaluation import subject as suite
from facewright.faces.expressions import EXPRESSION_NAMES, EXPRESSION_WEIGHTS, random_expression_weights
from facewright.faces.simulate import simulate_person
from facewright.warehouse.subject import Subject


@pytest.fixture(scope="module")
def truth(builtin_face):
    person = simulate_person(builtin_face, np.random.default_rng(3))
    meshes = person.pose(EXPRESSION_WEIGHTS)
    return suite.TrueSubject(EXPRESSION_NAMES, EXPRESSION_WEIGHTS, meshes, person.neutral, person.deltas)


def subject(truth, meshes=None, deltas=None):
    neutral = truth.meshes[0] if meshes is None else meshes[0]
    shapes = neutral + np.concatenate([np.zeros_like(truth.deltas[:1]), truth.deltas if deltas is None else deltas])
    return Subject(
        name="p",
        expressions=truth.expressions,
        meshes=(truth.meshes if meshes is None else meshes).astype(np.float32),
        blendshapes=shapes.astype(np.float32),
    )


def test_the_truth_has_no_error_and_generic_shapes_have(builtin_face, truth, rng):
    judged = suite.judge(builtin_face, subject(truth), truth, random_expression_weights(rng, 20))
    for key in ("unseen_rms_mm", "posed_rms_mm", "neutral_correspondence_rms_mm", "parts_rms_mm"):
        assert judged[key] < 1e-3, key
    assert judged["head_jitter_mm"] < 1e-3
    assert judged["head_jitter_degrees"] < 1e-3
    assert judged["generic_rms_mm"] > 0.5
    assert 0.05 < judged["true_meshes_unseen_rms_mm"] < judged["generic_rms_mm"]
    assert judged["expressions"] == 20


def test_a_head_that_is_elsewhere_is_no_error_but_one_that_jumps_is(builtin_face, truth, rng):
    unseen = random_expression_weights(rng, 10)
    turn, shift = rotation_from_vector(np.array([0.05, 0.1, 0.0])), np.array([3.0, -20.0, 8.0])
    moved = subject(truth, truth.meshes @ turn.T + shift, truth.deltas @ turn.T)
    judged = suite.judge(builtin_face, moved, truth, unseen)
    assert judged["unseen_rms_mm"] < 2e-3
    assert judged["head_jitter_mm"] < 2e-3
    jumping = truth.meshes.copy()
    jumping[1:] += rng.normal(size=(19, 1, 3)) * 0.5
    assert 0.6 < suite.judge(builtin_face, subject(truth, jumping), truth, unseen)["head_jitter_mm"] < 1.2


def test_nobody_cannot_be_measured(builtin_face):
    with pytest.raises(ValueRangeError, match="subjects"):
        suite.run(builtin_face, 1, subjects=0)


@pytest.mark.slow
@pytest.mark.landmarks
def test_one_person_from_end_to_end(builtin_face):
    pytest.importorskip("mediapipe")
    pytest.importorskip("open3d")
    metrics = suite.run(builtin_face, 20261201, subjects=1)
    stages = sum(value for key, value in metrics.items() if key.endswith("_seconds"))
    assert 0 < metrics["seconds"] < 1.2 * stages + 5
    assert metrics["expressions"] >= 18
    assert metrics["unseen_rms_mm"] < 1.1 * metrics["generic_rms_mm"]
    assert metrics["neutral_surface_rms_mm"] < 2.0
    assert metrics["head_jitter_mm"] < 1.0
