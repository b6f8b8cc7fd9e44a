import numpy as np
import pytest

from facewright.camera.rotation import FRONTAL, rotation_from_head_angles
from facewright.errors import ValueRangeError
from facewright.faces.acting import (
    FRAMES_PER_SECOND,
    _head_pose,
    act_combination,
    act_neutral,
    act_range_of_motion,
    act_sentence,
    with_head_motion,
)
from facewright.faces.acting_gestures import FACS_COMBINATIONS, RANGE_OF_MOTION
from facewright.faces.acting_speech import load_sentences
from facewright.faces.acting_style import draw_style
from facewright.faces.acting_timing import SHAPE_INDEX, blinks, bump, columns_of, gesture_weights, wander
from facewright.faces.blendshape_names import BLENDSHAPE_NAMES
from facewright.numeric.rotation import rotation_vector_from_matrix


@pytest.fixture(scope="module")
def style():
    return draw_style(np.random.default_rng(5))


@pytest.mark.parametrize("number", [0, 7, 14])
def test_a_sentence_takes_three_to_five_seconds_from_rest_to_rest(style, number):
    performance = act_sentence(load_sentences()[number], style, np.random.default_rng(1))
    assert np.allclose(np.diff(performance.times), 1 / FRAMES_PER_SECOND)
    assert 3.0 < performance.times[-1] < 5.0
    lids = np.isin(np.arange(46), columns_of("eyeBlink"))
    ends = performance.weights[[0, -1]][:, ~lids]
    assert ends.max() < 0.25 and ends.mean() < 0.03
    assert performance.weights[:, SHAPE_INDEX["jawOpen"]].max() > 0.12
    close, jaw = performance.weights[:, SHAPE_INDEX["mouthClose"]], performance.weights[:, SHAPE_INDEX["jawOpen"]]
    assert (close <= jaw + 1e-9).all()


def test_what_is_acted_depends_on_the_generator_alone(style):
    sentence = load_sentences()[8]
    first, again = (act_sentence(sentence, style, np.random.default_rng(3)) for _ in range(2))
    other = act_sentence(sentence, style, np.random.default_rng(4))
    assert np.array_equal(first.weights, again.weights) and np.array_equal(first.rotations, again.rotations)
    n = min(first.n_frames, other.n_frames)
    assert np.abs(first.weights[:n] - other.weights[:n]).max() > 0.1


def test_the_emotions_show():
    acted = {"pride": [], "rage": [], "contempt": []}
    for seed in range(2):
        style = draw_style(np.random.default_rng(seed))
        for sentence in load_sentences():
            take = act_sentence(sentence, style, np.random.default_rng(seed), 30.0)
            acted[sentence.emotion].append(take.weights.mean(axis=0))

    def mean_of(emotion, name):
        return np.mean(acted[emotion], axis=0)[columns_of(name)].mean()

    assert mean_of("rage", "browDown") > 3 * mean_of("pride", "browDown")
    assert mean_of("rage", "noseSneer") > 2 * mean_of("pride", "noseSneer")
    assert mean_of("pride", "mouthSmile") > 2 * mean_of("rage", "mouthSmile")
    assert mean_of("rage", "jawOpen") > 1.3 * mean_of("contempt", "jawOpen")


def test_contempt_is_one_sided():
    sides = []
    for seed in range(3):
        style = draw_style(np.random.default_rng(seed))
        for sentence in load_sentences()[12:]:
            acted = act_sentence(sentence, style, np.random.default_rng(seed), 30.0)
            left, right = (acted.weights[:, SHAPE_INDEX[f"mouthDimple_{side}"]].mean() for side in "LR")
            sides.append((left - right) * (1 if style.side == "L" else -1))
    assert np.mean(np.array(sides) > 0) > 0.8


def test_range_of_motion_reaches_extremes_everywhere(style):
    performance = act_range_of_motion(style, np.random.default_rng(0), seconds=70.0, frames_per_second=30.0)
    reach = performance.weights.max(axis=0)
    reach[SHAPE_INDEX["mouthClose"]] = 1  # lips close in speech
    assert (reach > 0.45).all(), [BLENDSHAPE_NAMES[i] for i in np.flatnonzero(reach <= 0.45)]
    used = {name.removesuffix("*") for part in RANGE_OF_MOTION.values() for gesture in part for name in gesture}
    assert len(used) > 25


def test_86_combinations_each_twice(style):
    assert len(FACS_COMBINATIONS) == 86
    assert len({tuple(sorted(g.items())) for g in FACS_COMBINATIONS}) == 86
    for number in (0, 40, 70, 85):
        acted = act_combination(number, style, np.random.default_rng(number), 60.0)
        wanted = gesture_weights(FACS_COMBINATIONS[number]) > 0.5
        course = acted.weights[:, wanted].mean(axis=1)
        assert course.max() > 0.5 and course[[0, -1]].max() < 0.1
        high = course > 0.25 * course.max()
        assert (np.diff(high.astype(int)) == 1).sum() == 2
    with pytest.raises(ValueRangeError, match=r"\[0, 85\]"):
        act_combination(86, style, np.random.default_rng(0))
    with pytest.raises(ValueRangeError, match="seconds"):
        act_range_of_motion(style, np.random.default_rng(0), seconds=0.0)


def test_heads_turn_little_and_smoothly_about_the_neck(style):
    acted = act_sentence(load_sentences()[10], style, np.random.default_rng(0))
    angles = np.rad2deg(np.linalg.norm(rotation_vector_from_matrix(FRONTAL @ acted.rotations), axis=1))
    assert 2 < angles.max() < 35
    neck = np.array([0.0, -60.0, -10.0])
    place = acted.rotations @ neck + acted.translations
    assert np.ptp(place, axis=0).max() < 60
    assert np.abs(np.diff(place, 2, axis=0)).max() * 120**2 < 1500  # mm / s^2


def test_head_motion_is_added_to_curves_without(style):
    still = act_neutral(3.0)
    assert still.weights.max() == 0 and np.allclose(still.rotations, FRONTAL)
    moving = with_head_motion(still, style, np.random.default_rng(0))
    assert np.array_equal(moving.weights, still.weights)
    assert np.ptp(moving.translations, axis=0).max() > 2


def test_blinks_close_within_100_to_140_ms():
    times = np.arange(120 * 60) / 120.0
    shut = blinks(times, np.random.default_rng(0), 2.5)
    starts = np.flatnonzero((shut[1:] > 0) & (shut[:-1] == 0))
    tops = np.array([start + shut[start : start + 40].argmax() for start in starts])
    assert 12 < len(starts) < 45
    assert ((tops - starts) / 120.0 <= 0.16).all() and ((tops - starts) / 120.0 >= 0.08).all()
    assert (shut[tops] > 0.9).all()


def test_courses():
    times = np.linspace(0, 2, 201)
    course = bump(times, 0.5, 0.2, 0.3, 0.4)
    assert course[times <= 0.5].max() == 0 and course[times >= 1.4 + 1e-9].max() < 1e-12
    assert course[(times >= 0.7) & (times <= 1.0)] == pytest.approx(1.0)
    drift = wander(np.arange(0, 400, 0.05), np.random.default_rng(0), 5, 0.2, 1.0)
    assert drift.std(axis=0) == pytest.approx(1.0, abs=0.1) and np.abs(drift.mean(axis=0)).max() < 0.1
    assert gesture_weights({"mouthSmile*": 0.5}, "R")[SHAPE_INDEX["mouthSmile_R"]] == 0.5
    assert gesture_weights({"mouth*": 0.5}, "R")[SHAPE_INDEX["mouthRight"]] == 0.5


def test_heads_are_posed_as_everywhere(rng):
    angles = 20.0 * rng.normal(size=(5, 3))
    rotations, _ = _head_pose(angles, np.zeros((5, 3)))
    assert np.allclose(rotations, [rotation_from_head_angles(*row) for row in angles])
