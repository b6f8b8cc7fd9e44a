"""What simulated people act: rest, gestures of all parts of the face, speech, blinks, gaze and a moving head."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from facewright.camera.rotation import rotation_from_head_angles
from facewright.faces.blendshape_names import BLENDSHAPE_NAMES
from facewright.models.performance import Performance

Gesture = dict[str, float]

#: Gestures that may follow one another in one part of the face; parts act at the same time.
_MOUTH: tuple[Gesture, ...] = (
    {"cheekPuff": 0.9},
    {"mouthSmile": 0.9, "cheekSquint": 0.6},
    {"mouthSmile_L": 0.8, "mouthDimple_L": 0.4},
    {"mouthFrown": 0.8, "mouthShrugLower": 0.5},
    {"mouthPucker": 0.9},
    {"mouthFunnel": 0.8, "jawOpen": 0.25},
    {"mouthLeft": 0.8},
    {"mouthRight": 0.6, "jawRight": 0.7},
    {"mouthRollLower": 0.7, "mouthRollUpper": 0.6, "mouthPress": 0.5},
    {"mouthStretch": 0.8, "jawOpen": 0.3},
    {"mouthUpperUp": 0.7, "mouthLowerDown": 0.7},
    {"jawOpen": 0.9},
    {"jawForward": 0.8},
    {"cheekPuff_L": 0.8, "cheekPuff_R": 0.2},
)
_BROWS: tuple[Gesture, ...] = (
    {"browDown": 0.9},
    {"browInnerUp": 0.8, "browOuterUp": 0.8},
    {"browInnerUp": 0.8},
    {"browOuterUp_L": 0.8},
    {"browDown": 0.6, "noseSneer": 0.5},
)
_NOSE: tuple[Gesture, ...] = ({"noseSneer": 0.9}, {"noseSneer_R": 0.8})
_LIDS: tuple[Gesture, ...] = (
    {"eyeSquint": 0.8, "cheekSquint": 0.7},
    {"eyeWide": 0.8},
    {"eyesLookDown": 0.8},
    {"cheekSquint_L": 0.8},
)
#: Mouths of vowels, over an open jaw.
_VOWELS: tuple[Gesture, ...] = (
    {"mouthFunnel": 0.5},
    {"mouthPucker": 0.6},
    {"mouthStretch": 0.3, "mouthLowerDown": 0.2},
    {"mouthSmile": 0.25},
    {"mouthLowerDown": 0.3, "mouthUpperUp": 0.2},
    {},
)
_INDEX = {name: i for i, name in enumerate(BLENDSHAPE_NAMES)}
_REST_SECONDS = 1.6
_SPEECH_SHARE = 0.35
_DISTANCE_MM = 650.0


def simulate_performance(
    rng: np.random.Generator, seconds: float, frames_per_second: float, *, rest_first: bool
) -> tuple[Performance, NDArray[np.bool_]]:
    """Draw a performance: rest, gestures of mouth, cheeks, nose, lids and brows, speech, blinks, head, gaze.

    Parameters
    ----------
    rng : numpy.random.Generator
        Source of randomness.
    seconds, frames_per_second : float
        Length and rate.
    rest_first : bool
        Whether it begins at rest; else it begins in the middle of a gesture, and the rest comes later.

    Returns
    -------
    performance : Performance
        Coefficients, head motion, gaze.
    rest : ndarray of shape (T,), bool
        Frames in which head and face are still (but for blinks).
    """
    T = round(seconds * frames_per_second)
    times = np.arange(T) / frames_per_second
    rest_length = min(_REST_SECONDS, 0.2 * seconds)
    talk = _SPEECH_SHARE * (seconds - rest_length)
    act = seconds - rest_length - talk
    if rest_first:
        rest_from, act_from = 0.0, rest_length
    else:
        rest_from, act_from = 0.6 * act, 0.0
    weights = np.zeros((T, len(BLENDSHAPE_NAMES)))
    clock = _acting_clock(times, rest_from, rest_length, act_from, act)
    for part, seconds_each in ((_MOUTH, 0.55), (_BROWS, 1.0), (_NOSE, 1.6), (_LIDS, 1.0)):
        _act(weights, clock, part, act, seconds_each, rng, begin_within=not rest_first)
    _speak(weights, times, act_from + act + (0.0 if rest_first else rest_length), talk, rng)
    resting = (times >= rest_from) & (times < rest_from + rest_length)
    weights[resting] = 0.0
    weights = _smooth(weights, frames_per_second)
    _blink(weights, times, rng)
    moving = _smooth((~resting).astype(float)[:, None], 4.0 * frames_per_second)[:, 0]
    rotations, translations = _head(times, np.cumsum(moving) / frames_per_second, rng)
    performance = Performance(
        times=times,
        names=BLENDSHAPE_NAMES,
        weights=np.clip(weights, 0.0, 1.0),
        rotations=rotations,
        translations=translations,
        gaze=_gaze(times, rng),
        tracked=np.ones(T, dtype=bool),
    )
    still = resting & (moving < 1e-6) & (np.abs(np.diff(weights, axis=0, prepend=weights[:1])).max(axis=1) < 1e-9)
    return performance, still


def _acting_clock(
    times: NDArray[np.float64], rest_from: float, rest_length: float, act_from: float, act: float
) -> NDArray[np.float64]:
    """Return the time within the gestures, -1 outside them."""
    t = times - act_from
    after = times >= rest_from + rest_length
    if rest_from > act_from:
        t = np.where(after, t - rest_length, np.where(times >= rest_from, -1.0, t))
    return np.where((t >= 0) & (t < act), t, -1.0)


def _act(
    weights: NDArray[np.float64],
    clock: NDArray[np.float64],
    gestures: tuple[Gesture, ...],
    length: float,
    seconds_each: float,
    rng: np.random.Generator,
    *,
    begin_within: bool,
) -> None:
    """Add gestures of one part of the face, one after the other in random order, the first two among them."""
    n = max(1, int(length / seconds_each))
    others = np.concatenate([rng.permutation(np.arange(2, len(gestures))) for _ in range(1 + n // len(gestures))])
    order = rng.permutation(np.concatenate([[0, 1], others])[:n])
    each = length / n
    for k, gesture in enumerate(order):
        # a clip that begins within a gesture begins at its height
        start = k * each - (0.4 * each if begin_within and k == 0 else 0.0)
        bump = _bump(clock, start, each) * (clock >= 0)
        for name, strength in gestures[gesture].items():
            reach = strength * rng.uniform(0.85, 1.1)
            for i in _columns(name):
                weights[:, i] = np.maximum(weights[:, i], min(reach * rng.uniform(0.92, 1.0), 1.0) * bump)


def _speak(
    weights: NDArray[np.float64], times: NDArray[np.float64], start: float, length: float, rng: np.random.Generator
) -> None:
    """Add syllables: the jaw opens and closes, vowels shape the lips, and every few syllables lips meet."""
    t = start + 0.1
    jaw, close = _INDEX["jawOpen"], _INDEX["mouthClose"]
    while t < start + length - 0.25:
        long = rng.uniform(0.16, 0.30)
        bump = _bump(times, t, long)
        weights[:, jaw] += rng.uniform(0.2, 0.6) * bump
        for name, strength in _VOWELS[rng.integers(len(_VOWELS))].items():
            for i in _columns(name):
                weights[:, i] = np.maximum(weights[:, i], strength * rng.uniform(0.7, 1.2) * bump)
        t += 0.85 * long
        if rng.random() < 0.45:  # p, b, m: the lips meet over a jaw that stays open
            shut = rng.uniform(0.08, 0.14)
            seal = _bump(times, t - 0.02, shut + 0.04)
            open_by = rng.uniform(0.2, 0.4)
            weights[:, jaw] = np.maximum(weights[:, jaw], open_by * _bump(times, t - 0.05, shut + 0.1))
            weights[:, close] = np.maximum(weights[:, close], np.minimum(weights[:, jaw], 1.0) * (seal > 0.5))
            for i in _columns("mouthPress"):
                weights[:, i] = np.maximum(weights[:, i], 0.3 * seal)
            for name in ("mouthFunnel", "mouthStretch_L", "mouthStretch_R", "mouthLowerDown_L", "mouthLowerDown_R"):
                weights[:, _INDEX[name]] *= 1.0 - seal
            t += 0.8 * shut
    weights[:, close] = np.minimum(weights[:, close], weights[:, jaw])


def _blink(weights: NDArray[np.float64], times: NDArray[np.float64], rng: np.random.Generator) -> None:
    """Add blinks, closing within 70 ms and opening within 130 ms, and one wink."""
    t = rng.uniform(0.4, 1.2)
    k, wink = 0, int(rng.integers(1, 4))
    left, right = _INDEX["eyeBlink_L"], _INDEX["eyeBlink_R"]
    while t < times[-1]:
        shut = rng.uniform(0.03, 0.07)
        knots = t + np.array([-0.07, 0.0, shut, shut + 0.13])
        lid = np.interp(times, knots, [0.0, 1.0, 1.0, 0.0])
        for i in (left, right) if k != wink else ((left,) if rng.random() < 0.5 else (right,)):
            weights[:, i] = np.maximum(weights[:, i], lid * rng.uniform(0.95, 1.0))
        for name in ("eyeWide_L", "eyeWide_R", "eyesLookDown"):
            weights[:, _INDEX[name]] *= 1.0 - np.maximum(weights[:, left], weights[:, right])
        t += rng.uniform(0.9, 2.2)
        k += 1


def _head(
    times: NDArray[np.float64], clock: NDArray[np.float64], rng: np.random.Generator
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return rotations and translations of a head that nods, turns and leans; `clock` stands still at rest."""
    angles = []
    for reach, period in ((16.0, 3.2), (8.0, 2.3), (5.0, 4.1)):
        slow, quick = rng.uniform(0.8, 1.3, 2) * [period, 0.35 * period]
        wave = np.sin(2 * np.pi * (clock / slow + rng.random())) + 0.25 * np.sin(
            2 * np.pi * (clock / quick + rng.random())
        )
        angles.append(reach * rng.uniform(0.7, 1.1) * wave)
    rotations = np.stack([rotation_from_head_angles(*row) for row in np.stack(angles, axis=1)])
    sway = [reach * np.sin(2 * np.pi * (clock / (rng.uniform(0.8, 1.3) * 4.0) + rng.random())) for reach in (15, 8, 30)]
    middle = np.array([0.0, 0.0, 40.0])
    return rotations, np.stack(sway, axis=1) + [0.0, 0.0, _DISTANCE_MM] - rotations @ middle


def _gaze(times: NDArray[np.float64], rng: np.random.Generator) -> NDArray[np.float64]:
    """Return gaze (T, 2, 2): both eyes jump together every second or so."""
    gaze = np.zeros((len(times), 2, 2))
    t, at = 0.0, np.zeros(2)
    while t < times[-1]:
        end = t + rng.uniform(0.4, 1.5)
        gaze[(times >= t) & (times < end)] = at
        t, at = end, rng.uniform(-1, 1, 2) * [0.35, 0.2] * (rng.random() < 0.7)
    return gaze


def _columns(name: str) -> list[int]:
    """Return a shape's columns; those of both sides where the name says none."""
    return [_INDEX[name]] if name in _INDEX else [_INDEX[f"{name}_L"], _INDEX[f"{name}_R"]]


def _bump(times: NDArray[np.float64], start: float, length: float) -> NDArray[np.float64]:
    """Return a smooth rise and fall within [start, start + length], 1 in its middle third."""
    u = (times - start) / length
    rise = np.clip(np.minimum(u, 1.0 - u) * 3.0, 0.0, 1.0)
    return rise * rise * (3.0 - 2.0 * rise)


def _smooth(values: NDArray[np.float64], width: float) -> NDArray[np.float64]:
    """Return rows smoothed over about a 25th of `width` frames (30 to 40 ms at any rate)."""
    reach = max(1, round(width / 25.0))
    kernel = np.convolve(np.ones(reach + 1), np.ones(reach + 1))
    padded = np.pad(values, ((reach, reach), (0, 0)), mode="edge")
    kernel = kernel / kernel.sum()
    return np.stack([np.convolve(column, kernel, mode="valid") for column in padded.T], axis=1)
