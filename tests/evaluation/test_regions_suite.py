from dataclasses import fields

import numpy as np
import pytest

from facewright.errors import ValueRangeError
from facewright.evaluation import regions_session
from facewright.evaluation.regions_session import register_session
from facewright.evaluation.suites import TARGETS, run_suite
from facewright.faces.performers import Performer, simulate_performers


class Brief(Performer):
    """A performer of three clips."""

    clips = ("neutral", "pride_01", "rage_05")
    train = ("pride_01",)
    test = ("rage_05",)


@pytest.fixture(scope="module")
def brief(builtin_face):
    patch = pytest.MonkeyPatch()
    (performer,) = simulate_performers(builtin_face, np.random.default_rng(4), names=("F1",))
    made = Brief(**{each.name: getattr(performer, each.name) for each in fields(Performer)})
    patch.setattr(regions_session, "simulate_performers", lambda *args, **kwargs: (made,))
    steps = []
    session = register_session(builtin_face, 4, lambda *step: steps.append(step))
    patch.undo()
    return made, session, steps


def test_registered_clips_are_the_truth_within_a_millimetre_or_so(brief):
    made, session, steps = brief
    metrics = session.errors.metrics()
    assert metrics["registration_surface_rms_mm"] < 1.0
    assert metrics["registration_motion_rms_mm"] < 1.3 < metrics["true_motion_rms_mm"]
    assert steps[-1] == ("registering clips", 3, 3) and ("recording performers", 1, 1) in steps
    assert session.n_frames == sum(-(-made.clip(name).n_frames // 8) for name in made.clips)


def test_all_clips_stand_as_the_template_does(brief):
    made, session, _ = brief
    (data,) = session.performers
    assert data.n_vertices == 397 and data.name == "F1" and data.clip_names == made.clips
    still = data.frames("neutral")
    assert np.abs(still - data.neutral).max() < 1.5  # noise of 0.2 mm a marker
    offset = data.neutral - data.reference
    assert np.abs(offset.mean(axis=0)).max() < 0.01  # Procrustes: one centre
    # with its head motion a clip is where it was recorded
    clip = made.clip("rage_05")
    true = clip.meshes(slice(None, None, 8)).vertices[:, data.vertex_ids]
    assert np.sqrt(((data.clip("rage_05").recorded() - true) ** 2).sum(axis=2).mean()) < 2.5


@pytest.mark.parametrize("subjects", [1, 5])
def test_numbers_of_performers_that_cannot_be_are_refused(subjects):
    with pytest.raises(ValueRangeError, match=r"\[2, 4\]"):
        run_suite("regions", "builtin", 5, subjects=subjects)


@pytest.mark.slow
def test_the_suite_measures_all_that_has_a_target():
    metrics = run_suite("regions", "builtin", 5)
    wanted = set(TARGETS["regions"]) - {"drag_us_11248"}
    assert wanted <= set(metrics) and "drag_us_6216" in metrics
    assert metrics["region_below"] == 1.0 and metrics["region_leak"] < metrics["holistic_leak"]
    assert metrics["registration_motion_rms_mm"] < 1.2
    assert 6 <= metrics["regions_k"] <= 30
