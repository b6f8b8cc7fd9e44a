"""Frames without a face hold, ease to neutral and come back smoothly; cuts carry nothing over."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from facewright.apps.untracked_frames import HOLD, fill_untracked, gaps_sentence, pause_sentence
from facewright.camera.rotation import rotation_from_head_angles
from facewright.errors import NoFaceError
from facewright.models.performance import Performance

RATE = 25.0


def acted(tracked: np.ndarray, level: float = 0.8) -> Performance:
    n = len(tracked)
    rotations = np.array([rotation_from_head_angles(20 * k / n, 0, 0) for k in range(n)])
    weights = np.where(tracked[:, None], level, 0.0) * np.ones((n, 2))
    zeros = np.zeros((n, 3))
    gaze = np.where(tracked[:, None, None], 0.2, 0.0) * np.ones((n, 2, 2))
    return Performance(np.arange(n) / RATE, ("jawOpen", "eyeBlink_L"), weights, rotations, zeros, gaze, tracked)


def missing(n: int, *runs: tuple[int, int]) -> np.ndarray:
    tracked = np.ones(n, bool)
    for first, last in runs:
        tracked[first : last + 1] = False
    return tracked


def test_long_gap_holds_then_eases_to_neutral_and_back() -> None:
    filled, gaps = fill_untracked(acted(missing(120, (20, 90))))
    level = filled.weights[:, 0]
    held = int(HOLD * RATE)
    np.testing.assert_allclose(level[: 20 + held], 0.8)
    np.testing.assert_array_equal(level[50:84], 0)
    np.testing.assert_allclose(level[91:], 0.8)
    assert np.abs(np.diff(level)).max() < 0.3  # no jump
    assert gaps == ((20, 90, False),)
    assert np.isclose(filled.gaze, 0.2).all()


def test_short_gap_is_bridged() -> None:
    start = acted(missing(40, (10, 13)))
    weights = start.weights.copy()
    weights[14:] = 0.3
    filled, gaps = fill_untracked(
        Performance(start.times, start.names, weights, start.rotations, start.translations, start.gaze, start.tracked)
    )
    np.testing.assert_allclose(filled.weights[9:15, 0], np.linspace(0.8, 0.3, 6))
    assert gaps[0].bridged


def test_start_and_end_without_a_face() -> None:
    filled, _ = fill_untracked(acted(missing(100, (0, 30), (60, 99))))
    assert (filled.weights[:25] == 0).all() and (filled.weights[90:] == 0).all()
    np.testing.assert_array_equal(filled.rotations[:31], np.repeat(filled.rotations[31:32], 31, axis=0))


def test_nothing_is_carried_over_a_cut() -> None:
    cuts = np.zeros(60, bool)
    cuts[22] = True
    filled, gaps = fill_untracked(acted(missing(60, (20, 40))), cuts)
    np.testing.assert_allclose(filled.weights[20:22], 0.8)  # holds to the cut
    assert (filled.weights[22:35] == 0).all()
    assert [(gap.first, gap.last) for gap in gaps] == [(20, 21), (22, 40)]


def test_no_face_at_all_is_refused() -> None:
    with pytest.raises(NoFaceError):
        fill_untracked(acted(np.zeros(5, bool)))


def test_sentence_names_the_frames() -> None:
    _, gaps = fill_untracked(acted(missing(100, (0, 0), (60, 99))))
    sentence = gaps_sentence(gaps, 100)
    assert sentence is not None and "41 of 100 frames (0, 60-99)" in sentence
    assert gaps_sentence((), 10) is None


@given(st.lists(st.booleans(), min_size=1, max_size=80), st.lists(st.booleans(), min_size=80, max_size=80))
def test_filling_is_valid_keeps_what_was_seen_and_does_nothing_twice(seen: list[bool], cut: list[bool]) -> None:
    tracked = np.array(seen)
    if not tracked.any():
        return
    start, cuts = acted(tracked), np.array(cut[: len(seen)])
    once, gaps = fill_untracked(start, cuts)
    twice, _ = fill_untracked(once, cuts)
    np.testing.assert_array_equal(once.weights[tracked], start.weights[tracked])
    np.testing.assert_array_equal(once.rotations[tracked], start.rotations[tracked])
    np.testing.assert_array_equal(twice.weights, once.weights)
    np.testing.assert_allclose(twice.rotations, once.rotations, atol=1e-12)
    assert sum(gap.last - gap.first + 1 for gap in gaps) == (~tracked).sum()
    np.testing.assert_allclose(
        once.rotations @ once.rotations.transpose(0, 2, 1), np.eye(3)[None] * np.ones((len(seen), 1, 1)), atol=1e-9
    )


def test_pauses_between_rows_are_named():
    times = np.r_[np.arange(10) / RATE, 4.0 + np.arange(10) / RATE]
    assert pause_sentence(times, 1 / RATE) == (
        "No rows from 0.36 to 4.00 s: the expression goes evenly from the one before to the one after."
    )
    assert pause_sentence(np.arange(20) / RATE, 1 / RATE) is None
