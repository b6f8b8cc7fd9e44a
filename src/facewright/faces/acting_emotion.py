"""What emotions do to simulated faces: lasting expressions, gestures on beats, postures of the head."""

from __future__ import annotations

import zlib
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from facewright.faces.acting_speech import Sentence
from facewright.faces.acting_style import ActingStyle
from facewright.faces.acting_timing import bump, gesture_weights, smooth_step, wander
from facewright.faces.blendshape_names import BLENDSHAPE_NAMES

Gesture = dict[str, float]


@dataclass(frozen=True)
class Emotion:
    """How an emotion shows.

    Parameters
    ----------
    lasting : tuple of Gesture
        Expressions that last through the sentence, each sentence in a mixture of its own; ``*`` marks one side.
    beats : tuple of Gesture
        Gestures on stressed syllables.
    before, after : tuple of Gesture
        Gestures of the moment before speaking, and of the one after.
    effort : float
        Reach of speech.
    head_degrees : tuple of float
        Yaw, pitch and roll of the posture: pitch up, roll and yaw to the performer's side.
    nod_degrees : float
        Size of nods on stressed syllables.
    shake_degrees : float
        Size of head shakes.
    """

    lasting: tuple[Gesture, ...]
    beats: tuple[Gesture, ...]
    before: tuple[Gesture, ...]
    after: tuple[Gesture, ...]
    effort: float
    head_degrees: tuple[float, float, float]
    nod_degrees: float
    shake_degrees: float


EMOTIONS: dict[str, Emotion] = {
    "pride": Emotion(
        lasting=(
            {"mouthSmile": 0.35, "cheekSquint": 0.15},
            {"browOuterUp": 0.35, "browInnerUp": 0.15},
            {"eyesLookDown": 0.2, "eyeSquint": 0.2},
            {"mouthDimple": 0.25, "mouthShrugLower": 0.12},
            {"jawForward": 0.15, "mouthPress": 0.1},
        ),
        beats=(
            {"browOuterUp": 0.5, "browInnerUp": 0.5},
            {"browOuterUp": 0.45, "eyeWide": 0.3},
            {"mouthSmile": 0.35, "cheekSquint": 0.3},
            {"eyeSquint": 0.4, "cheekSquint": 0.3},
            {"browOuterUp*": 0.5},
        ),
        before=({"mouthPress": 0.4, "mouthSmile": 0.3}, {"browOuterUp": 0.4}, {"mouthRollUpper": 0.3}),
        after=(
            {"mouthSmile": 0.75, "cheekSquint": 0.4},
            {"mouthPress": 0.5, "mouthSmile": 0.5, "mouthDimple": 0.3},
            {"mouthShrugLower": 0.45, "mouthFrown": 0.25, "browOuterUp": 0.4},
        ),
        effort=1.05,
        head_degrees=(0.0, 7.0, 2.0),
        nod_degrees=3.0,
        shake_degrees=0.5,
    ),
    "rage": Emotion(
        lasting=(
            {"browDown": 0.8, "eyeSquint": 0.2},
            {"noseSneer": 0.45, "mouthUpperUp": 0.25},
            {"eyeWide": 0.45, "browDown": 0.5},
            {"mouthStretch": 0.35, "mouthLowerDown": 0.25},
            {"jawForward": 0.3, "mouthShrugLower": 0.15},
            {"cheekSquint": 0.3, "noseSneer": 0.3},
        ),
        beats=(
            {"browDown": 0.5, "noseSneer": 0.5},
            {"mouthLowerDown": 0.45, "mouthStretch": 0.4},
            {"mouthUpperUp": 0.45, "noseSneer": 0.5, "cheekSquint": 0.3},
            {"jawOpen": 0.2, "mouthStretch": 0.3},
            {"eyeWide": 0.5},
            {"mouthUpperUp*": 0.5, "noseSneer*": 0.4},
        ),
        before=(
            {"mouthPress": 0.7, "browDown": 0.5, "mouthRollLower": 0.3},
            {"noseSneer": 0.6, "mouthUpperUp": 0.3},
            {"jawForward": 0.5, "mouthStretch": 0.2},
        ),
        after=(
            {"mouthPress": 0.8, "browDown": 0.5, "mouthFrown": 0.3},
            {"mouthFunnel": 0.4, "mouthUpperUp": 0.3, "mouthLowerDown": 0.4, "noseSneer": 0.5},
            {"mouthStretch": 0.6, "mouthLowerDown": 0.4, "jawOpen": 0.1},
        ),
        effort=1.35,
        head_degrees=(0.0, -4.0, 1.0),
        nod_degrees=5.0,
        shake_degrees=3.5,
    ),
    "contempt": Emotion(
        lasting=(
            {"mouthSmile*": 0.4, "mouthDimple*": 0.3},
            {"mouthDimple*": 0.6, "cheekSquint*": 0.2},
            {"eyesLookDown": 0.3, "eyeBlink": 0.12},
            {"browOuterUp*": 0.4, "browDown": 0.15},
            {"noseSneer*": 0.35, "mouthUpperUp*": 0.2},
            {"mouthFrown": 0.35, "mouthShrugLower": 0.2},
        ),
        beats=(
            {"browOuterUp*": 0.55},
            {"mouthUpperUp*": 0.4, "noseSneer*": 0.45},
            {"eyeSquint": 0.5},
            {"mouthLeft": 0.3},
            {"browInnerUp": 0.4, "browOuterUp": 0.4},
            {"mouthDimple*": 0.5, "mouthSmile*": 0.3},
        ),
        before=({"mouthPress": 0.4, "eyesLookDown": 0.3}, {"mouthPucker": 0.3, "mouth*": 0.3}, {"cheekPuff": 0.25}),
        after=(
            {"mouthSmile*": 0.6, "mouthDimple*": 0.4, "cheekSquint*": 0.3},
            {"mouthShrugLower": 0.5, "mouthFrown": 0.45, "browOuterUp": 0.3},
            {"mouth*": 0.5, "mouthPress": 0.3},
        ),
        effort=0.8,
        head_degrees=(4.0, 4.0, 5.0),
        nod_degrees=2.0,
        shake_degrees=1.5,
    ),
}


def act_emotion(
    sentence: Sentence,
    style: ActingStyle,
    times: NDArray[np.float64],
    spoken: tuple[float, float],
    stresses: NDArray[np.float64],
    rng: np.random.Generator,
) -> NDArray[np.float64]:
    """Return the (T, 46) intended coefficients of a sentence's emotion, speech aside.

    What is done belongs to the sentence, "all actors performed the same sentences with the same emotional background"
    (Tena et al. 2011, section 4): its gestures are the same for all performers; sizes and moments are each one's own.

    Parameters
    ----------
    sentence : Sentence
    style : ActingStyle
    times : ndarray of shape (T,), float64, seconds
    spoken : (start, end)
        When the sentence is spoken, seconds.
    stresses : ndarray of shape (S,), float64, seconds
        Stressed syllables.
    rng : numpy.random.Generator
        Of this performer and sentence.
    """
    emotion = EMOTIONS[sentence.emotion]
    script = np.random.default_rng(zlib.crc32(sentence.name.encode()))
    start, end = spoken
    weights = np.zeros((len(times), len(BLENDSHAPE_NAMES)))
    present = smooth_step((times - start + 0.55) / 0.45) * (1.0 - smooth_step((times - end - 0.25) / 0.6))
    mixture = script.dirichlet(np.full(len(emotion.lasting), 0.8)) * 2.2
    tides = 1.0 + 0.25 * wander(times, rng, len(emotion.lasting), 0.25, 1.2)
    for gesture, share, tide in zip(emotion.lasting, mixture, tides.T):
        size = min(share, 1.3) * rng.uniform(0.8, 1.2)
        weights += (present * np.clip(tide, 0.3, 1.5) * size)[:, None] * gesture_weights(gesture, style.side)
    moments = [(t - 0.14, emotion.beats, 1.0) for t in stresses if script.random() < 0.6]
    moments = [(start - 0.5, emotion.before, 0.9), *moments, (end + 0.0, emotion.after, 1.0)]
    for moment, choices, size in moments:
        gesture = choices[script.integers(len(choices))]
        hold = script.uniform(0.03, 0.22) if choices is emotion.beats else script.uniform(0.2, 0.4)
        rise, fall = script.uniform(0.14, 0.24), script.uniform(0.22, 0.4)
        course = bump(times, moment + rng.normal(0.0, 0.025), rise / style.tempo, hold, fall / style.tempo)
        size *= script.uniform(0.7, 1.1) * rng.uniform(0.75, 1.15)
        weights += (size * course)[:, None] * gesture_weights(gesture, style.side)
    return weights


def move_head(
    emotion: Emotion,
    style: ActingStyle,
    times: NDArray[np.float64],
    spoken: tuple[float, float],
    stresses: NDArray[np.float64],
    rng: np.random.Generator,
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return head angles (T, 3) in degrees (yaw, pitch, roll) and shifts (T, 3) in millimetres, model axes."""
    start, end = spoken
    present = smooth_step((times - start + 0.5) / 0.5) * (1.0 - 0.7 * smooth_step((times - end - 0.2) / 0.8))
    side = 1.0 if style.side == "L" else -1.0
    posture = np.array(emotion.head_degrees) * [side, 1.0, side] * rng.uniform(0.7, 1.3, 3)
    angles = present[:, None] * posture + style.head * wander(times, rng, 3, 0.12, 0.7) * [3.0, 2.0, 1.6]
    for t in stresses:
        size = style.head * emotion.nod_degrees * rng.uniform(0.2, 1.2)
        angles[:, 1] -= size * bump(times, t - 0.16, 0.18, 0.02, 0.3)
    shake = wander(times, rng, 1, 1.2, 2.2)[:, 0]
    angles[:, 0] += style.head * emotion.shake_degrees * shake * present
    shifts = style.head * wander(times, rng, 3, 0.1, 0.5) * [8.0, 3.0, 10.0]
    shifts[:, 2] += present * rng.uniform(-5.0, 20.0)
    return angles, shifts
