import numpy as np
import pytest

from facewright.camera.pinhole import Intrinsics, RigidMotion
from facewright.camera.rotation import rotation_from_head_angles
from facewright.errors import DegenerateError, ShapeError, ValueRangeError
from facewright.faces.expressions import random_expression_weights
from facewright.fitting.image import PhotoFitOptions
from facewright.fitting.joint import JointFitter, fit_jointly
from facewright.landmarks.points import Landmarks

SIZE = (640, 640)


@pytest.fixture
def make_person(small_model):
    """Return a function (rng, n) -> neutral (V, 3), coefficients (n, 46), landmarks of n pictures of one person."""
    from facewright.apps.true_landmarks import true_landmarks

    def make(rng, n):
        w_id = small_model.sample_identity(rng)
        neutral = small_model.synthesise(w_id, small_model.expression_weights[0])
        betas = random_expression_weights(rng, n)
        betas[0] = 0.0
        found = []
        for beta in betas:
            vertices = small_model.synthesise(w_id, small_model.expression_from_blendshapes(beta))
            rotation = rotation_from_head_angles(*rng.uniform([-30, -15, -10], [30, 15, 10]))
            motion = RigidMotion(rotation, np.array([10.0, -5.0, 900.0]) - rotation @ [0, 0, 40.0])
            intrinsics = Intrinsics.for_image(SIZE, 1400.0)
            found.append(
                true_landmarks(small_model.topology, small_model.mean_face, vertices, intrinsics, motion).points
                + rng.normal(0, 0.3, (74, 2))
            )
        return neutral, betas, [Landmarks("fw74", points) for points in found]

    return make


def _neutral_error(fit, truth):
    model = fit.model
    neutral = model.synthesise(fit.identity_weights, model.expression_weights[0])
    inner = model.topology.landmarks["fw74"]
    inner = inner[inner >= 0]
    a, b = neutral[inner] - neutral[inner].mean(axis=0), truth[inner] - truth[inner].mean(axis=0)
    return float(np.sqrt(((a * (a * b).sum() / (a * a).sum() - b) ** 2).sum(axis=1).mean()))


def test_one_identity_is_found_better_than_from_single_pictures(fitter, make_person, rng):
    options = PhotoFitOptions(noise_mm=0.3, focal_length=1400.0)
    joint_mm, single_mm, joint_beta, single_beta = [], [], [], []
    joint = JointFitter(fitter.model)
    for _ in range(4):
        neutral, betas, landmarks = make_person(rng, 3)
        fits = joint.fit(landmarks, [SIZE] * 3, options)
        alone = [fitter.fit(each, SIZE, options) for each in landmarks]
        for fit in fits[1:]:
            np.testing.assert_array_equal(fit.identity_weights, fits[0].identity_weights)  # Eq. (16)
        joint_mm.append(_neutral_error(fits[0], neutral))
        single_mm += [_neutral_error(fit, neutral) for fit in alone]
        joint_beta += [np.abs(fit.blendshape_weights - beta).mean() for fit, beta in zip(fits, betas, strict=True)]
        single_beta += [np.abs(fit.blendshape_weights - beta).mean() for fit, beta in zip(alone, betas, strict=True)]
        assert all(np.nanmean(fit.residuals_px[fit.landmarks.definition.fixed]) < 1.5 for fit in fits)
    assert np.mean(joint_mm) < np.mean(single_mm)
    assert np.mean(joint_beta) < np.mean(single_beta)


def test_one_picture_is_its_own_fit(fitter, make_person, small_model, rng):
    _, _, landmarks = make_person(rng, 1)
    one = fit_jointly(small_model, landmarks, [SIZE])[0]
    own = fitter.fit(landmarks[0], SIZE)
    np.testing.assert_allclose(one.blendshape_weights, own.blendshape_weights, atol=1e-9)
    np.testing.assert_allclose(one.vertices, own.vertices, atol=1e-4)


def test_the_order_of_the_pictures_does_not_matter(make_person, small_model, rng):
    _, _, landmarks = make_person(rng, 2)
    there = fit_jointly(small_model, landmarks, [SIZE] * 2)
    back = fit_jointly(small_model, landmarks[::-1], [SIZE] * 2)
    np.testing.assert_allclose(there[0].vertices, back[1].vertices, atol=0.05)


def test_refuses_what_cannot_be_fitted(make_person, small_model, rng):
    _, _, landmarks = make_person(rng, 2)
    with pytest.raises(ValueRangeError, match="at least one picture"):
        fit_jointly(small_model, [], [])
    with pytest.raises(ShapeError, match="as many pictures"):
        fit_jointly(small_model, landmarks, [SIZE])
    with pytest.raises(ShapeError, match="as many pictures"):
        fit_jointly(small_model, landmarks, [SIZE] * 2, [PhotoFitOptions()])
    few = Landmarks("fw74", np.zeros((74, 2)), np.r_[np.ones(20), np.zeros(54)])
    with pytest.raises(DegenerateError, match="landmarks inside the face"):
        fit_jointly(small_model, [landmarks[0], few], [SIZE] * 2)
