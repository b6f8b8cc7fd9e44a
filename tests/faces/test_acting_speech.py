import numpy as np
import pytest

from facewright.errors import ValueRangeError
from facewright.faces.acting_speech import close_lips, load_sentences, sentence_seconds, speak
from facewright.faces.acting_timing import SHAPE_INDEX, columns_of

TIMES = np.arange(480) / 120.0
JAW, CLOSE = SHAPE_INDEX["jawOpen"], SHAPE_INDEX["mouthClose"]


def test_there_are_six_sentences_of_each_emotion_of_three_seconds_or_so():
    sentences = load_sentences()
    assert [s.name for s in sentences] == [f"{e}_{k:02d}" for e in ("pride", "rage", "contempt") for k in range(1, 7)]
    assert all(s.name.startswith(s.emotion) and s.text for s in sentences)
    assert all(1.8 < sentence_seconds(s) < 3.5 for s in sentences)


def test_a_sentence_at_twice_the_tempo_takes_half_as_long():
    sentence = load_sentences()[3]
    assert sentence_seconds(sentence, 2.0) == pytest.approx(0.5 * sentence_seconds(sentence))


def test_the_jaw_opens_more_in_open_vowels():
    def opening(*phonemes):
        return speak(phonemes, TIMES, 1.0).weights[:, JAW].max()

    assert opening("T", "AA1", "T") > 1.5 * opening("T", "IY1", "T") > 0
    assert opening("T", "AA1", "T") > opening("T", "AA0", "T")
    assert speak(("T", "AA1", "T"), TIMES, 1.0, effort=1.3).weights[:, JAW].max() == pytest.approx(
        1.3 * opening("T", "AA1", "T")
    )


def test_lips_round_before_the_rounded_vowel_begins():
    pucker = columns_of("mouthPucker")[0]
    rounded = speak(("S", "T", "UW1"), TIMES, 1.0)
    plain = speak(("S", "T", "IY1"), TIMES, 1.0)
    at = np.searchsorted(TIMES, 1.04)  # in the middle of the s
    assert rounded.weights[at, pucker] > 0.1 and plain.weights[at, pucker] == 0


def test_lips_meet_in_bilabials_whatever_stands_beside_them():
    speech = speak(("AA1", "P", "AA1"), TIMES, 1.0)
    weights = speech.weights.copy()
    weights[:, columns_of("mouthUpperUp")] = 0.5
    open_before = weights[:, JAW].max()
    close_lips(weights, speech)
    at = speech.seal.argmax()
    assert speech.seal[at] == 1.0
    assert weights[at, CLOSE] == pytest.approx(weights[at, JAW]) and weights[at, JAW] > 0.03
    assert weights[at, columns_of("mouthUpperUp")].max() == 0
    assert (weights[:, CLOSE] <= weights[:, JAW] + 1e-12).all()
    far = np.abs(TIMES - TIMES[at]) > 0.4
    assert weights[far, CLOSE].max() == 0 and weights[:, JAW].max() <= open_before
    # nothing is sealed where nothing is bilabial
    assert speak(("AA1", "T", "AA1"), TIMES, 1.0).seal.max() == 0


def test_lips_close_within_a_tenth_of_a_second_and_not_faster():
    seal = speak(("AA1", "P", "AA1"), TIMES, 1.0).seal
    rising = TIMES[(seal > 0.05) & (seal < 0.95) & (np.arange(len(seal)) < seal.argmax())]
    assert 0.04 < rising[-1] - rising[0] < 0.12


def test_the_mouth_rests_before_and_after():
    speech = speak(load_sentences()[0].phonemes, np.arange(700) / 120.0, 1.0)
    assert speech.weights[:60].max() < 1e-3 and speech.weights[-60:].max() < 1e-3
    assert speech.weights.min() >= 0 and speech.weights.max() <= 1
    assert ((speech.stresses > 1.0) & (speech.stresses < speech.end)).all() and len(speech.stresses) >= 5


def test_mistakes_are_refused():
    with pytest.raises(ValueRangeError, match="a phoneme"):
        speak((), TIMES, 0.0)
    with pytest.raises(ValueRangeError, match="tempo"):
        speak(("AA1",), TIMES, 0.0, tempo=0.0)
    with pytest.raises(ValueRangeError, match="QQ"):
        speak(("QQ1",), TIMES, 0.0)
