"""Two photos' points: what they lose when they must share one shape."""

import numpy as np
import pytest

from facewright.camera.pinhole import Intrinsics, RigidMotion
from facewright.camera.rotation import rotation_from_head_angles
from facewright.errors import ValueRangeError
from facewright.faces.expressions import random_expression_weights
from facewright.faces.simulate import simulate_population
from facewright.fitting.dense_model import CENTRE, FramePose
from facewright.fitting.shape_evidence import ShapeWitness, sharing_loss
from facewright.landmarks.points import Landmarks
from facewright.models.bilinear import fit_bilinear

SIZE = (512, 512)


@pytest.fixture(scope="module")
def witness(builtin_face):
    face = builtin_face.skin()
    tensor = simulate_population(face, 16, np.random.default_rng(1))
    names = ("neutral", *face.blendshape_names)
    return ShapeWitness(fit_bilinear(tensor, 15, 30, topology=face.topology, expression_names=names))


def found_in_a_photo(witness, c, rng):
    """Return the detector's points of a person (I,) with noise, in some pose, expression and lens."""
    dense = witness.dense
    person = dense.person(c, np.zeros(dense.n_modes))
    rotation = rotation_from_head_angles(*rng.uniform(-12, 12, 3))
    middle = np.array([*rng.uniform(-30, 30, 2), rng.uniform(600, 1200)])
    focal = 1.3 * middle[2]
    pose = FramePose(RigidMotion(rotation, middle - rotation @ CENTRE), Intrinsics(focal, focal, 255.5, 255.5))
    known = dict(zip(witness.dense.names, range(dense.n_shapes), strict=True))
    beta = np.zeros(dense.n_shapes)
    from facewright.faces.blendshape_names import BLENDSHAPE_NAMES

    for name, weight in zip(BLENDSHAPE_NAMES, 0.5 * random_expression_weights(rng, 1)[0], strict=True):
        beta[known[name]] = weight
    points = dense.predict(person, pose, np.clip(beta, 0, 1)) + rng.normal(0, 0.3, (dense.points.n_points, 2))
    return Landmarks("mediapipe478", np.linalg.pinv(dense.points.sources) @ points)


def test_one_persons_photos_lose_less_than_two_peoples(witness):
    rng = np.random.default_rng(3)
    people = rng.normal(size=(8, witness.dense.n_identity))
    evidence = [[witness.evidence(found_in_a_photo(witness, c, rng), SIZE) for _ in range(2)] for c in people]
    same = [sharing_loss(*pair) for pair in evidence]
    different = [sharing_loss(evidence[k][0], evidence[(k + 1) % 8][1]) for k in range(8)]
    assert max(same) < min(different)
    assert np.median(same) < 0.0 < np.median(different)


def test_order_does_not_matter_and_a_photo_agrees_with_itself(witness):
    rng = np.random.default_rng(4)
    one, other = (
        witness.evidence(found_in_a_photo(witness, c, rng), SIZE, 1000.0)
        for c in rng.normal(size=(2, witness.dense.n_identity))
    )
    assert sharing_loss(one, other) == pytest.approx(sharing_loss(other, one), rel=1e-9)
    assert sharing_loss(one, one) < min(0.0, sharing_loss(one, other))
    assert np.linalg.eigvalsh(one.information).min() > -1e-6 * np.linalg.eigvalsh(one.information).max()


def test_other_points_are_refused(witness):
    with pytest.raises(ValueRangeError, match="mediapipe478"):
        witness.evidence(Landmarks("fw74", np.zeros((74, 2))), SIZE)
