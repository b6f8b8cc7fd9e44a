"""Speech of simulated performers: phonemes become mouth shapes that blend into one another (co-articulation)."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cache
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from facewright.errors import ValueRangeError
from facewright.faces.acting_timing import SHAPE_INDEX, columns_of, low_pass, smooth_step
from facewright.faces.blendshape_names import BLENDSHAPE_NAMES, read_package_json
from facewright.numeric.check import check_choice

#: Targets of each phoneme; of diphthongs, of their ends one after the other. Lips that must meet ("seal") and the lower
#: lip at the teeth ("bite") have courses of their own, for nothing may blend them away.
_VOWELS: dict[str, tuple[dict[str, float], ...]] = {
    "AA": ({"jawOpen": 0.36, "mouthLowerDown": 0.2},),
    "AE": ({"jawOpen": 0.30, "mouthStretch": 0.25, "mouthLowerDown": 0.3, "mouthUpperUp": 0.15},),
    "AH": ({"jawOpen": 0.2, "mouthLowerDown": 0.1},),
    "AO": ({"jawOpen": 0.27, "mouthFunnel": 0.45},),
    "AW": ({"jawOpen": 0.34, "mouthLowerDown": 0.2}, {"jawOpen": 0.1, "mouthPucker": 0.55}),
    "AY": ({"jawOpen": 0.34, "mouthLowerDown": 0.2}, {"jawOpen": 0.1, "mouthStretch": 0.3, "mouthSmile": 0.12}),
    "EH": ({"jawOpen": 0.21, "mouthStretch": 0.22, "mouthLowerDown": 0.2},),
    "ER": ({"jawOpen": 0.14, "mouthFunnel": 0.3, "mouthPucker": 0.12},),
    "EY": ({"jawOpen": 0.2, "mouthStretch": 0.25}, {"jawOpen": 0.09, "mouthStretch": 0.3, "mouthSmile": 0.12}),
    "IH": ({"jawOpen": 0.13, "mouthStretch": 0.18, "mouthLowerDown": 0.1},),
    "IY": ({"jawOpen": 0.09, "mouthStretch": 0.32, "mouthSmile": 0.18},),
    "OW": ({"jawOpen": 0.24, "mouthFunnel": 0.4}, {"jawOpen": 0.1, "mouthPucker": 0.6}),
    "UH": ({"jawOpen": 0.15, "mouthFunnel": 0.35},),
    "UW": ({"jawOpen": 0.09, "mouthPucker": 0.65, "mouthFunnel": 0.1},),
}
_BILABIALS = ("P", "B", "M")
_CONSONANTS: dict[str, dict[str, float]] = {
    **{name: {"jawOpen": 0.09, "mouthPress": 0.3, "seal": 1.0} for name in _BILABIALS},
    **{name: {"jawOpen": 0.07, "mouthUpperUp": 0.15, "bite": 1.0} for name in ("F", "V")},
    **{name: {"jawOpen": 0.08, "mouthLowerDown": 0.12} for name in ("T", "D", "N", "L")},
    **{name: {"jawOpen": 0.04, "mouthStretch": 0.2, "mouthLowerDown": 0.2} for name in ("S", "Z")},
    **{name: {"jawOpen": 0.06, "mouthFunnel": 0.55, "mouthLowerDown": 0.1} for name in ("SH", "ZH", "CH", "JH")},
    **{name: {"jawOpen": 0.09, "mouthLowerDown": 0.2} for name in ("TH", "DH")},
    **{name: {"jawOpen": 0.12} for name in ("K", "G", "NG", "HH")},
    "W": {"jawOpen": 0.08, "mouthPucker": 0.7},
    "R": {"jawOpen": 0.1, "mouthFunnel": 0.35},
    "Y": {"jawOpen": 0.08, "mouthStretch": 0.2},
    "|": {},
}
#: How much what stands between two phonemes gives way to each: a consonant fixes the jaw less than a vowel does, and
#: says nothing about shapes it does not need.
_VOWEL_ALPHA, _CONSONANT_ALPHA, _SILENT_ALPHA = 1.0, 0.6, 0.25
_ROUNDING = ("mouthFunnel", "mouthPucker")
#: Decay of a phoneme's dominance with the distance from its centre, 1/s: lips round early and long, the jaw is quick.
_JAW_RATE, _LIP_RATE, _ROUNDING_RATE = 22.0, 18.0, 11.0
_LONGER = {"1": 1.3, "2": 1.1, "0": 0.85, "": 1.0}
_VOWEL_SECONDS, _CONSONANT_SECONDS, _PAUSE_SECONDS = 0.115, 0.075, 0.26
_SEAL_MOVE, _SEAL_HOLD, _APPROACH_S = 0.1, 0.04, 0.24
_SMOOTH_S = 0.016


@dataclass(frozen=True)
class Sentence:
    """What is said, and in which mood.

    Parameters
    ----------
    name : str
        ``pride_01`` and so on.
    emotion : str
        ``pride``, ``rage`` or ``contempt``.
    text : str
        English.
    phonemes : tuple of str
        ARPAbet, vowels with their stress (1, 2 or 0); ``|`` is a pause.
    """

    name: str
    emotion: str
    text: str
    phonemes: tuple[str, ...]


class Speech(NamedTuple):
    """What the mouth does while a sentence is spoken.

    Parameters
    ----------
    weights : ndarray of shape (T, 46), float64
        Coefficients of speech alone, without what closes the lips.
    seal : ndarray of shape (T,), float64
        How firmly the lips are meant to meet (p, b, m), 0 to 1.
    bite : ndarray of shape (T,), float64
        How firmly the lower lip is held at the upper teeth (f, v), 0 to 1.
    approach : ndarray of shape (T,), float64
        How near in time lips that meet are, 0 to 1: the jaw does not open wide between.
    stresses : ndarray of shape (S,), float64, seconds
        Middles of the stressed syllables.
    end : float
        When the last phoneme ends, seconds.
    """

    weights: NDArray[np.float64]
    seal: NDArray[np.float64]
    bite: NDArray[np.float64]
    approach: NDArray[np.float64]
    stresses: NDArray[np.float64]
    end: float


class _Segment(NamedTuple):
    centre: float
    length: float
    phoneme: str
    stress: str
    target: Mapping[str, float]
    alpha: float


@cache
def load_sentences() -> tuple[Sentence, ...]:
    """Return the 18 sentences that performers speak, six of each emotion."""
    content: Any = read_package_json("sentences.json")
    return tuple(
        Sentence(name, each["emotion"], each["text"], tuple(each["phonemes"].split()))
        for name, each in content["sentences"].items()
    )


def sentence_seconds(sentence: Sentence, tempo: float = 1.0) -> float:
    """Return how long the phonemes of a sentence take at a tempo, seconds."""
    segments = _segments(sentence.phonemes, 0.0, tempo)
    return segments[-1].centre + 0.5 * segments[-1].length


def speak(
    phonemes: tuple[str, ...],
    times: NDArray[np.float64],
    start: float,
    *,
    tempo: float = 1.0,
    effort: float = 1.0,
    rng: np.random.Generator | None = None,
) -> Speech:
    """Turn phonemes into coefficients over time.

    Every phoneme pulls the mouth to its target with a dominance that decays from its middle, and the coefficients are
    the mean of the targets weighted by dominance [1]_: lips round before a rounded vowel begins, and the jaw of a short
    vowel between two stops does not open all the way. Lips that must meet do, whatever stands beside them.

    Parameters
    ----------
    phonemes : tuple of str
        ARPAbet with stresses, see `Sentence`.
    times : ndarray of shape (T,), float64, seconds
        Evenly spaced.
    start : float
        When the first phoneme begins, seconds.
    tempo : float
        Speed relative to a usual one of about eleven phonemes a second.
    effort : float
        How far jaw and lips go, relative to calm speech.
    rng : numpy.random.Generator, optional
        Varies lengths and reaches a little; none where absent.

    Raises
    ------
    ValueRangeError
        If there is no phoneme, one is unknown, or `tempo` is not positive.

    References
    ----------
    .. [1] Cohen and Massaro, Modeling coarticulation in synthetic visual speech, 1993.
    """
    segments = _segments(phonemes, start, tempo, rng)
    centres = np.array([segment.centre for segment in segments])
    lengths = np.array([segment.length for segment in segments])
    distance = np.maximum(np.abs(times[:, None] - centres) - 0.25 * lengths, 0.0)
    weights = np.zeros((len(times), len(BLENDSHAPE_NAMES)))
    named = sorted({name for segment in segments for name in segment.target} - {"seal", "bite"})
    for name in named:
        rate = _JAW_RATE if name == "jawOpen" else _ROUNDING_RATE if name in _ROUNDING else _LIP_RATE
        alpha = np.array([_alpha(segment, name) for segment in segments])
        target = np.array([segment.target.get(name, 0.0) for segment in segments])
        dominance = alpha * np.exp(-rate * distance)
        # before the first and after the last phoneme the mouth goes back to rest
        rest = _SILENT_ALPHA * np.exp(-rate * 0.08) * ((times < start) | (times > centres[-1] + 0.5 * lengths[-1]))
        course = dominance @ target / (dominance.sum(axis=1) + rest + 1e-9)
        course *= smooth_step((times - start + 0.16) / 0.2)
        course *= 1.0 - smooth_step((times - centres[-1] - 0.5 * lengths[-1]) / 0.25)
        weights[:, columns_of(name)] = np.clip(effort * course, 0.0, 1.0)[:, None]
    rate_s = float(np.median(np.diff(times))) if len(times) > 1 else 1.0
    return Speech(
        low_pass(weights, 1.0 / rate_s, _SMOOTH_S),
        _held(segments, times, "seal", _SEAL_MOVE, tempo),
        _held(segments, times, "bite", _SEAL_MOVE, tempo),
        _held(segments, times, "seal", _APPROACH_S, tempo),
        np.array([segment.centre for segment in segments if segment.stress == "1"]),
        float(centres[-1] + 0.5 * lengths[-1]),
    )


def _alpha(segment: _Segment, name: str) -> float:
    """Return the strength with which a phoneme insists on its target of a shape."""
    if segment.phoneme == "|":
        return _SILENT_ALPHA
    if name == "jawOpen" and segment.phoneme in _BILABIALS:
        return 2.0  # the jaw helps the lips to meet
    if name != "jawOpen" and name not in segment.target and segment.phoneme in _CONSONANTS:
        return 0.3 * segment.alpha  # most consonants leave the lips to the vowels around them
    return segment.alpha


def _segments(
    phonemes: tuple[str, ...], start: float, tempo: float, rng: np.random.Generator | None = None
) -> list[_Segment]:
    """Lay phonemes end to end; a diphthong becomes two targets."""
    if not phonemes or not tempo > 0:
        raise ValueRangeError(f"speech needs a phoneme and a positive tempo, got {len(phonemes)} and {tempo}.")
    segments = []
    t = start
    for symbol in phonemes:
        phoneme, stress = symbol.rstrip("012"), symbol[len(symbol.rstrip("012")) :]
        check_choice("phoneme", phoneme, (*_VOWELS, *_CONSONANTS))
        targets = _VOWELS.get(phoneme) or (_CONSONANTS[phoneme],)
        length = _PAUSE_SECONDS if phoneme == "|" else _CONSONANT_SECONDS
        if phoneme in _VOWELS:
            length = _VOWEL_SECONDS * _LONGER[stress] * (1.35 if len(targets) > 1 else 1.0)
        reach = 1.15 if stress == "1" else 0.9 if stress == "0" else 1.0
        if rng is not None:
            length *= np.exp(0.12 * rng.standard_normal())
            reach *= np.exp(0.12 * rng.standard_normal())
        length /= tempo
        alpha = _VOWEL_ALPHA if phoneme in _VOWELS else _CONSONANT_ALPHA
        for k, target in enumerate(targets):
            part = length / len(targets)
            scaled = {name: value * (1.0 if name in ("seal", "bite") else reach) for name, value in target.items()}
            segments.append(_Segment(t + (k + 0.5) * part, part, phoneme, stress if k == 0 else "", scaled, alpha))
        t += length
    return segments


def _held(
    segments: list[_Segment], times: NDArray[np.float64], name: str, move_s: float, tempo: float
) -> NDArray[np.float64]:
    """Return the course of a contact: smoothly there, held, smoothly away, around each phoneme that needs it."""
    course = np.zeros(len(times))
    for segment in segments:
        if name in segment.target:
            hold = _SEAL_HOLD / tempo
            distance = np.abs(times - segment.centre) - 0.5 * hold
            course = np.maximum(course, 1.0 - smooth_step(distance / move_s))
    return course


def close_lips(weights: NDArray[np.float64], speech: Speech) -> None:
    """Bring the lips together where speech seals them, and the lower lip to the teeth where it bites; in place.

    ``mouthClose`` takes back as much of the jaw's opening, which is smaller around, and what would part the lips fades
    meanwhile.
    """
    seal, bite = speech.seal, speech.bite
    open_lips = 1.0 - np.maximum(seal, 0.6 * bite)
    for name in ("mouthFunnel", "mouthLowerDown", "mouthUpperUp", "mouthShrugUpper"):
        weights[:, columns_of(name)] *= open_lips[:, None]
    weights[:, columns_of("mouthStretch")] *= (1.0 - 0.5 * seal)[:, None]
    weights[:, SHAPE_INDEX["jawOpen"]] *= 1.0 - 0.55 * speech.approach
    jaw = np.clip(weights[:, SHAPE_INDEX["jawOpen"]], 0.0, 1.0)
    close = columns_of("mouthClose")
    weights[:, close] = np.maximum(weights[:, close], (np.maximum(seal, 0.55 * bite) * jaw)[:, None])
    weights[:, columns_of("mouthRollLower")] += 0.35 * bite[:, None]
    weights[:, columns_of("mouthUpperUp")] += 0.12 * bite[:, None]
