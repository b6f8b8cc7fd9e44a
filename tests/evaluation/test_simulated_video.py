from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from facewright.camera.rotation import head_angles_from_rotation
from facewright.evaluation.performance_error import coefficient_errors, head_jitter, jitter, lip_gaps, point_distances
from facewright.evaluation.simulated_performance import simulate_performance
from facewright.evaluation.simulated_video import IMAGE_SIZE, simulate_video
from facewright.faces.blendshape_names import BLENDSHAPE_NAMES


@pytest.mark.parametrize("rest_first", [True, False])
def test_performances_hold_what_is_measured(rng, rest_first):
    performance, rest = simulate_performance(rng, 10.0, 25.0, rest_first=rest_first)
    W, index = performance.weights, BLENDSHAPE_NAMES.index
    assert performance.n_frames == 250 and 15 <= rest.sum() <= 45
    blink = W[:, index("eyeBlink_L")]
    W_rest = np.delete(W[rest], [index("eyeBlink_L"), index("eyeBlink_R")], axis=1)
    assert W_rest.max() == 0.0
    assert (W[0].max() > 0.3) != rest_first
    assert blink.max() > 0.9 and 3 <= ((blink[1:] > 0.5) & (blink[:-1] <= 0.5)).sum() <= 10
    for name in ("cheekPuff_L", "noseSneer_R", "mouthSmile_L", "browDown_L", "jawOpen"):
        assert W[:, index(name)].max() > 0.3
    closed = W[:, index("mouthClose")]
    assert (closed > 0.15).any() and (closed <= W[:, index("jawOpen")] + 1e-9).all()
    angles = np.array([head_angles_from_rotation(R) for R in performance.rotations])
    assert 8 < np.ptp(angles[:, 0]) < 60 and np.abs(angles).max() < 35
    assert head_jitter(performance.rotations, rest).max() < 1e-6
    assert jitter(np.delete(W, [index("eyeBlink_L"), index("eyeBlink_R")], axis=1), rest).max() < 1e-12


def test_clips_are_drawn_as_they_say(builtin_face, rng):
    clip = simulate_video(builtin_face, rng, 0.2, rest_first=True)
    images = list(clip.images())
    assert len(images) == clip.n_frames == 5
    assert images[0].shape == (*IMAGE_SIZE, 3) and images[0].dtype == np.uint8
    pixels = clip.intrinsics.project(clip.motion(0).apply(clip.vertices(0)))
    x, y = np.rint(pixels[builtin_face.topology.landmarks["ibug68"][30]]).astype(int)
    wall = np.abs(images[0][y, x].astype(int) - clip.background[y, x]).max()
    assert wall > 8  # there is a nose before the wall
    assert np.abs(images[0][2, 2].astype(int) - clip.background[2, 2]).max() < 12


def test_errors_by_group_are_told_apart():
    names = BLENDSHAPE_NAMES
    truth = np.zeros((10, 46))
    truth[2:6, names.index("eyeBlink_L")] = 1.0
    half = 0.6 * truth
    good = coefficient_errors(half, truth, names)
    assert good["recall_blink"] == 1.0 and good["precision_blink"] == 1.0
    assert good["correlation_blink"] == pytest.approx(1.0)
    assert good["coefficient_mae"] == pytest.approx(0.4 * good["neutral_mae"])
    assert good["active_mae"] == pytest.approx(0.4) and good["neutral_active_mae"] == 1.0 and good["resting_mae"] == 0.0
    none = coefficient_errors(np.zeros_like(truth), truth, names)
    assert none["recall_blink"] == 0.0 and none["correlation_blink"] == 0.0 and "precision_blink" not in none
    false = coefficient_errors(truth[:, ::-1], truth, names)
    assert false["recall_blink"] == 0.0 and false["coefficient_mae"] > good["neutral_mae"]
    assert false["resting_mae"] > 0.0
    assert "active_mae" not in coefficient_errors(half, np.zeros_like(truth), names)


def test_distances_in_the_picture(builtin_face, rng):
    clip = simulate_video(builtin_face, rng, 0.2, rest_first=False)
    person = clip.person
    rig = SimpleNamespace(neutral=person.neutral, deltas=person.deltas)
    identity = SimpleNamespace(rig=rig, intrinsics=clip.intrinsics)
    ids = builtin_face.topology.landmarks["ibug68"]
    eyes = ids[36:42], ids[42:48]

    def distances(performance):
        fit = SimpleNamespace(identity=identity, performance=performance)
        return point_distances(person, clip.performance, clip.intrinsics, fit, ids[48:], eyes)

    np.testing.assert_allclose(distances(clip.performance), 0.0, atol=1e-7)
    # a head 1 mm to the side is 1 mm of about 60 off
    aside = replace(clip.performance, translations=clip.performance.translations + [1.0, 0.0, 0.0])
    assert distances(aside).shape == (clip.n_frames,)
    assert (distances(aside) > 0.010).all() and (distances(aside) < 0.025).all()
    still = replace(clip.performance, weights=np.zeros_like(clip.performance.weights))
    assert distances(still).max() > 0.003


def test_jitter_and_lips():
    values = np.zeros((6, 2))
    values[3, 0] = 1.0
    everywhere = np.ones(6, bool)
    np.testing.assert_allclose(jitter(values, everywhere), [0, 0.5, 1.0, 0.5])
    only = np.array([1, 1, 1, 0, 0, 0], bool)
    np.testing.assert_allclose(jitter(values, only), [0.0])
    meshes = np.zeros((2, 8, 3))
    meshes[1, 4:, 1] = -3.0
    np.testing.assert_allclose(lip_gaps(meshes, (np.arange(4), np.arange(4, 8))), [0, 3])
