import importlib.util
from pathlib import Path

import numpy as np
import pytest

from facewright.deform._rigging_kernels import correct_gradients
from facewright.deform.acted_weights import (
    ActingPrior,
    estimate_amplitudes,
    estimate_reach,
    split_amplitudes,
)
from facewright.deform.example_based_rigging import RigFitter, fit_rig
from facewright.errors import ShapeError, ValueRangeError
from facewright.mesh.random_field import smooth_random_field

_spec = importlib.util.spec_from_file_location("reference_deform", Path(__file__).with_name("reference_deform.py"))
reference = importlib.util.module_from_spec(_spec)
_spec.loader.exec_module(reference)


def bump_shapes(vertices, n, rng):
    """Shapes of 5 mm that live around different places."""
    centres = vertices[rng.choice(len(vertices), n, replace=False)]
    reach = np.exp(-((vertices[None] - centres[:, None]) ** 2).sum(axis=2) / (2 * 12.0**2))
    directions = rng.normal(size=(n, 1, 3))
    return 5 * reach[:, :, None] * directions / np.linalg.norm(directions, axis=2, keepdims=True)


@pytest.fixture
def person(patch, rng):
    """Neutral, faces, generic shapes and true ones: other amplitudes, a smooth perturbation, nothing else."""
    neutral, faces = patch(rng, 14, 80.0, 0.6)
    generic = bump_shapes(neutral, 10, rng)
    scale = rng.uniform(0.7, 1.2, 10)
    size = np.linalg.norm(generic, axis=2, keepdims=True)
    truth = generic * scale[:, None, None] + 0.15 * size * smooth_random_field(neutral, 20, 1, rng, n_fields=10)
    return neutral, faces, generic, truth


def rms(x):
    return np.sqrt((x**2).sum(axis=-1).mean())


def test_kernel_equals_the_printed_normal_equations(rng):
    F, N, B, C = 7, 5, 9, 6
    weights = rng.uniform(size=(N, B)) * (rng.random((N, B)) < 0.5)
    prior, poses = rng.normal(size=(F, B, C)), rng.normal(size=(F, N, C))
    penalties = rng.uniform(0.5, 50, (F, B))
    beta = 0.07
    variances = 1 / penalties
    gram = np.einsum("nb,fb,mb->fnm", weights, variances, weights)
    found = prior.copy()
    correct_gradients(gram, beta, poses - weights @ prior, variances, weights, found)
    expected = reference.rig_gradients(poses, weights, prior, penalties, beta)
    np.testing.assert_allclose(found, expected, atol=1e-9)


def test_enough_exact_poses_give_the_exact_shapes(person, rng):
    neutral, faces, generic, truth = person
    weights = rng.uniform(size=(40, 10))
    poses = neutral + np.tensordot(weights, truth, 1)
    rig = RigFitter(neutral, generic, faces).fit(poses, weights, weights_known=True, betas=(1e-7,))
    # Shapes are placed by their still vertices, so that a small common shift may remain.
    assert rms(rig.deltas - truth) < 0.02
    np.testing.assert_array_equal(rig.weights, weights)


def test_poses_of_the_generic_face_change_nothing(person, rng):
    neutral, faces, generic, _ = person
    weights = np.eye(10)[:6] * 0.8
    poses = neutral + np.tensordot(weights, generic, 1)
    rig = fit_rig(neutral, generic, faces, poses, weights)
    np.testing.assert_allclose(rig.amplitudes, 1.0, atol=1e-3)
    np.testing.assert_allclose(rig.weights, weights, atol=1e-3)
    assert rms(rig.deltas - generic) < 1e-3


def test_poses_at_rest_only_return_the_generic_shapes(person):
    neutral, faces, generic, _ = person
    rig = fit_rig(neutral, generic, faces, neutral[None], np.zeros((1, 10)))
    np.testing.assert_allclose(rig.deltas, generic, atol=1e-9)
    np.testing.assert_allclose(rig.amplitudes, 1.0)


def test_imperfect_poses_beat_the_generic_shapes_on_unseen_expressions(person, rng):
    neutral, faces, generic, truth = person
    guide = (rng.random((12, 10)) < 0.3) * rng.uniform(0.5, 1, (12, 10))
    acted = guide * rng.uniform(0.85, 1.1, guide.shape)
    poses = neutral + np.tensordot(acted, truth, 1) + smooth_random_field(neutral, 25, 0.1, rng, n_fields=12)
    unseen = rng.uniform(size=(30, 10)) * (rng.random((30, 10)) < 0.4)
    fitter = RigFitter(neutral, generic, faces)
    stages = []
    unknown = fitter.fit(poses, guide, progress=lambda *stage: stages.append(stage))
    known = fitter.fit(poses, acted, weights_known=True)
    error = [rms(np.tensordot(unseen, d - truth, 1)) for d in (generic, unknown.deltas, known.deltas)]
    assert error[1] < 0.75 * error[0]
    assert error[2] < error[1]
    assert stages == [("fitting blendshapes", 1, 2), ("fitting blendshapes", 2, 2)]
    np.testing.assert_array_equal(fitter.fit(poses, guide, amplitudes="generic").amplitudes, 1.0)


def test_reach_is_the_product_of_weight_and_amplitude(person, rng):
    _, _, generic, _ = person
    guide = np.eye(10)
    amplitude = rng.uniform(0.8, 1.2, 10)
    moved = generic * amplitude[:, None, None]
    reach = estimate_reach(generic, moved, guide, ActingPrior(weight_spread=1e3, surface_noise_mm=0.01))
    np.testing.assert_allclose(np.diag(reach), amplitude, atol=1e-2)
    stiff = estimate_reach(generic, moved, guide, ActingPrior(weight_spread=1e-6, spurious_weight=1e-6))
    np.testing.assert_allclose(stiff, guide, atol=1e-6)


def test_split_follows_the_evidence(rng):
    guide = np.full((200, 2), 0.8)
    amplitude = np.array([1.3, 0.7])
    reach = guide * amplitude * np.exp(0.1 * rng.normal(size=guide.shape))
    free = ActingPrior(coupling=0.0, pose_spread=1e-3)
    np.testing.assert_allclose(split_amplitudes(reach, guide, [], free), amplitude, rtol=0.05)
    one = split_amplitudes(reach[:1], guide[:1], [], free)
    assert (np.abs(np.log(one)) < np.abs(np.log(reach[0] / guide[0]))).all()  # shared with the acting
    # A shape that nobody acted follows the one it is coupled to.
    guide[:, 1] = 0.0
    coupled = split_amplitudes(reach, guide, [(0, 1)], ActingPrior(pose_spread=1e-3))
    assert 1.1 < coupled[1] < coupled[0]
    assert split_amplitudes(reach, guide, [], free)[1] == pytest.approx(1.0)


def test_known_weights_reveal_amplitudes(person, rng):
    _, _, generic, _ = person
    weights, amplitude = rng.uniform(size=(30, 10)), rng.uniform(0.7, 1.2, 10)
    moved = np.tensordot(weights * amplitude, generic, 1)
    found = estimate_amplitudes(generic, moved, weights, [], ActingPrior())
    np.testing.assert_allclose(found, amplitude, atol=0.02)


def test_refuses(person):
    neutral, faces, generic, _ = person
    with pytest.raises(ShapeError):
        RigFitter(neutral, generic[:, :-1], faces)
    with pytest.raises(ValueRangeError):
        RigFitter(neutral, generic * np.nan, faces)
    with pytest.raises(ValueRangeError, match="coupled"):
        RigFitter(neutral, generic, faces, coupled=[(0, 10)])
    with pytest.raises(ShapeError, match="coupled"):
        RigFitter(neutral, generic, faces, coupled=[(0, 1, 2)])
    with pytest.raises(ValueRangeError, match="kappa"):
        RigFitter(neutral, generic, faces, kappa=0)
    fitter = RigFitter(neutral, generic, faces)
    poses, weights = neutral[None], np.zeros((1, 10))
    for bad_poses, bad_weights, options in (
        (neutral, weights, {}),
        (poses, weights[:, :-1], {}),
        (poses * np.nan, weights, {}),
        (poses, weights - 1, {}),
        (poses, weights * np.nan, {}),
        (poses, weights, {"betas": ()}),
        (poses, weights, {"betas": (0.0,)}),
        (poses, weights, {"amplitudes": "some"}),
    ):
        with pytest.raises((ShapeError, ValueRangeError)):
            fitter.fit(bad_poses, bad_weights, **options)
