"""Curves of simulated performers: emotional sentences, a range of motion, single expressions; head motion and gaze."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from facewright.errors import ValueRangeError
from facewright.faces.acting_emotion import EMOTIONS, Emotion, act_emotion, move_head
from facewright.faces.acting_gestures import FACS_COMBINATIONS, RANGE_OF_MOTION
from facewright.faces.acting_speech import Sentence, Speech, close_lips, sentence_seconds, speak
from facewright.faces.acting_style import ActingStyle
from facewright.faces.acting_timing import SHAPE_INDEX, blinks, bump, columns_of, gesture_weights, low_pass, wander
from facewright.faces.blendshape_names import BLENDSHAPE_NAMES
from facewright.models.performance import Performance

FRAMES_PER_SECOND = 120.0
CAMERA_DISTANCE_MM = 650.0
"""How far before the camera a performer's head is, see `Performance.translations`."""

#: Point about which the head turns, model space, mm: the top of the neck.
NECK_MM = np.array([0.0, -60.0, -10.0])
_LEAD_S, _TAIL_S = 0.75, 0.85
_EASE_S = 0.008
_STILL = Emotion((), (), (), (), 1.0, (0.0, 0.0, 0.0), 0.0, 0.0)


def act_sentence(
    sentence: Sentence,
    style: ActingStyle,
    rng: np.random.Generator,
    frames_per_second: float = FRAMES_PER_SECOND,
) -> Performance:
    """Act an emotional sentence: speech with co-articulation, expression, beats, blinks, unrest, a moving head.

    It begins and ends near rest.

    Parameters
    ----------
    sentence : Sentence
        What is said, and in which mood.
    style : ActingStyle
        The performer's habits.
    rng : numpy.random.Generator
        What differs from one take to the next.
    frames_per_second : float
        Rate of the curves.
    """
    emotion = EMOTIONS[sentence.emotion]
    length = _LEAD_S + 1.15 * sentence_seconds(sentence, style.tempo) + _TAIL_S
    times = np.arange(round(length * frames_per_second)) / frames_per_second
    speech = speak(
        sentence.phonemes,
        times,
        _LEAD_S,
        tempo=style.tempo,
        effort=emotion.effort * style.effort * rng.uniform(0.9, 1.1),
        rng=rng,
    )
    n = int(np.searchsorted(times, speech.end + _TAIL_S))  # speech took a little less or more than it usually does
    times, spoken = times[:n], (_LEAD_S, speech.end)
    intended = act_emotion(sentence, style, times, spoken, speech.stresses, rng) * style.reach
    intended += _unrest(times, style, rng)
    # the jaw's speech is not scaled by the reach of gestures: `effort` did that
    weights = (intended + speech.weights[:n]) @ style.recruitment.T
    angles, shifts = move_head(emotion, style, times, spoken, speech.stresses, rng)
    speech = speech._replace(**{name: getattr(speech, name)[:n] for name in ("seal", "bite", "approach")})
    return _finished(weights, angles, shifts, times, style, rng, speech=speech)


def act_range_of_motion(
    style: ActingStyle,
    rng: np.random.Generator,
    *,
    seconds: float = 70.0,
    frames_per_second: float = FRAMES_PER_SECOND,
) -> Performance:
    """Act random facial motion to extremes, part by part and together, for `seconds`."""
    if not seconds > 0:
        raise ValueRangeError(f"seconds must be positive, got {seconds}.")
    times = np.arange(max(2, round(seconds * frames_per_second))) / frames_per_second
    intended = _unrest(times, style, rng)
    for part, gestures in RANGE_OF_MOTION.items():
        t = rng.uniform(0.3, 1.0)
        order: list[int] = []
        while t < seconds - 0.6:
            if not order:
                order = list(rng.permutation(len(gestures)))
            rise, hold, fall = rng.uniform([0.22, 0.05, 0.25], [0.5, 0.5, 0.55])
            rise *= 1.25 if part == "mouth" else 1.0
            course = bump(times, t, rise, hold, fall)
            size = rng.uniform(0.6, 1.1)
            intended += (size * course)[:, None] * gesture_weights(gestures[order.pop()], str(rng.choice(["L", "R"])))
            # parts act together now and rest then
            t += rise + hold + 0.6 * fall + (rng.uniform(0.8, 3.0) if rng.random() < 0.4 else rng.uniform(0.0, 0.4))
    weights = (intended * style.reach) @ style.recruitment.T
    angles, shifts = move_head(_STILL, style, times, (0.0, seconds), np.zeros(0), rng)
    return _finished(weights, 2.0 * angles, shifts, times, style, rng)


def act_combination(
    number: int, style: ActingStyle, rng: np.random.Generator, frames_per_second: float = FRAMES_PER_SECOND
) -> Performance:
    """Act one of the FACS combinations, 0 to 85: once with less than half, once with full strength.

    Raises
    ------
    ValueRangeError
        If there is no such combination.
    """
    if not 0 <= number < len(FACS_COMBINATIONS):
        raise ValueRangeError(f"number must be in [0, {len(FACS_COMBINATIONS) - 1}], got {number}.")
    rises, holds, falls = rng.uniform([0.25, 0.1, 0.3], [0.4, 0.35, 0.5], (2, 3)).T
    length = 0.2 + float((rises + holds + falls).sum()) + 0.2
    times = np.arange(round(length * frames_per_second)) / frames_per_second
    first = rng.uniform(0.35, 0.55) * bump(times, 0.15, rises[0], holds[0], falls[0])
    second = rng.uniform(0.85, 1.0) * bump(times, 0.2 + rises[0] + holds[0] + falls[0], rises[1], holds[1], falls[1])
    target = gesture_weights(FACS_COMBINATIONS[number])
    weights = (first + second)[:, None] * target * np.sqrt(style.reach)  # asked for, it is done more evenly
    # trained performers isolate what they are asked for, but not all of it
    weights = weights @ (0.6 * np.eye(len(target)) + 0.4 * style.recruitment).T + 0.5 * _unrest(times, style, rng)
    angles, shifts = move_head(_STILL, style, times, (0.0, length), np.zeros(0), rng)
    return _finished(weights, 0.5 * angles, 0.5 * shifts, times, style, rng, blinking=False)


def act_neutral(seconds: float = 0.5, frames_per_second: float = FRAMES_PER_SECOND) -> Performance:
    """Hold still at rest for `seconds`, facing straight ahead: the take that the neutral is read from."""
    times = np.arange(max(2, round(seconds * frames_per_second))) / frames_per_second
    rotations, translations = _head_pose(np.zeros((len(times), 3)), np.zeros((len(times), 3)))
    return Performance(
        times=times,
        names=BLENDSHAPE_NAMES,
        weights=np.zeros((len(times), len(BLENDSHAPE_NAMES))),
        rotations=rotations,
        translations=translations,
        gaze=np.zeros((len(times), 2, 2)),
        tracked=np.ones(len(times), dtype=bool),
    )


def with_head_motion(performance: Performance, style: ActingStyle, rng: np.random.Generator) -> Performance:
    """Give curves whose source did not say where the head was the small motion of a head in talk."""
    times = performance.times
    angles, shifts = move_head(_STILL, style, times, (float(times[0]), float(times[-1])), np.zeros(0), rng)
    rotations, translations = _head_pose(angles, shifts)
    return Performance(
        times,
        performance.names,
        performance.weights,
        rotations,
        translations,
        performance.gaze,
        performance.tracked,
    )


def _unrest(times: NDArray[np.float64], style: ActingStyle, rng: np.random.Generator) -> NDArray[np.float64]:
    """Return (T, 46) small involuntary activation, which never opens the mouth."""
    weights = style.unrest * np.maximum(wander(times, rng, len(BLENDSHAPE_NAMES), 0.2, 2.5) + 0.5, 0.0)
    for name in ("jawOpen", "mouthClose", "mouthRollLower", "mouthRollUpper", "eyeBlink"):
        weights[:, columns_of(name)] = 0.0
    return weights


def _finished(
    weights: NDArray[np.float64],
    angles: NDArray[np.float64],
    shifts: NDArray[np.float64],
    times: NDArray[np.float64],
    style: ActingStyle,
    rng: np.random.Generator,
    *,
    speech: Speech | None = None,
    blinking: bool = True,
) -> Performance:
    """Delay sides, close lips and lids, keep within [0, 1], add head and gaze."""
    rate = 1.0 / float(times[1] - times[0])
    weights = low_pass(_delayed(_limited(weights), times, style.delays), rate, _EASE_S)
    if speech is not None:
        close_lips(weights, speech)
    close = SHAPE_INDEX["mouthClose"]
    weights[:, close] = np.minimum(weights[:, close], weights[:, SHAPE_INDEX["jawOpen"]])
    if blinking:
        shut = blinks(times, rng, style.blink_interval)[:, None]
        lids = columns_of("eyeBlink")
        weights[:, lids] = np.maximum(weights[:, lids], shut * np.clip(style.reach[lids] + 0.15, 0.9, 1.0))
        for name in ("eyeWide", "eyesLookDown"):
            weights[:, columns_of(name)] *= 1.0 - shut
    rotations, translations = _head_pose(angles, shifts)
    return Performance(
        times=times,
        names=BLENDSHAPE_NAMES,
        weights=np.clip(weights, 0.0, 1.0),
        rotations=rotations,
        translations=translations,
        gaze=_gaze(times, rng),
        tracked=np.ones(len(times), dtype=bool),
    )


def _limited(weights: NDArray[np.float64], knee: float = 0.75) -> NDArray[np.float64]:
    """Bend what exceeds `knee` smoothly below 1: muscles end."""
    over = np.maximum(weights - knee, 0.0) / (1.0 - knee)
    return np.clip(np.minimum(weights, knee) + (1.0 - knee) * np.tanh(over), 0.0, 1.0)


def _delayed(
    weights: NDArray[np.float64], times: NDArray[np.float64], delays: NDArray[np.float64]
) -> NDArray[np.float64]:
    columns = [np.interp(times - delay, times, column) for column, delay in zip(weights.T, delays)]
    return np.stack(columns, axis=1)


def _head_pose(
    angles: NDArray[np.float64], shifts: NDArray[np.float64]
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return rotations (T, 3, 3) and translations (T, 3), camera_from_model, of a head that turns on its neck."""
    # rotation_from_head_angles for all frames at once: yaw, then pitch, then roll
    turns = Rotation.from_euler("yxz", angles * [1.0, -1.0, -1.0], degrees=True)
    flip = np.array([1.0, -1.0, -1.0])
    rotations = flip[:, None] * turns.as_matrix()
    translations = (NECK_MM + shifts) * flip - rotations @ NECK_MM + [0.0, 0.0, CAMERA_DISTANCE_MM]
    return rotations, translations


def _gaze(times: NDArray[np.float64], rng: np.random.Generator) -> NDArray[np.float64]:
    """Return gaze (T, 2, 2): both eyes jump together, mostly back to the partner."""
    gaze = np.zeros((len(times), 2, 2))
    t, at = 0.0, np.zeros(2)
    while t < times[-1]:
        end = t + rng.uniform(0.5, 1.8)
        gaze[(times >= t) & (times < end)] = at
        t, at = end, rng.uniform(-1, 1, 2) * [0.25, 0.12] * (rng.random() < 0.5)
    return gaze
