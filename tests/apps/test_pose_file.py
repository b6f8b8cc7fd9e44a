import json

import numpy as np
import pytest

from facewright.apps.pose_file import open_pose
from facewright.apps.pose_session import PoseSession
from facewright.errors import FileFormatError, StoreError


@pytest.fixture
def saved(patch, tmp_path):
    """A session with everything in it, and its file."""
    path = tmp_path / "work.fwpose"
    session = PoseSession(patch[0], holistic=patch[1], autosave=path)
    session.set_key(0.0)
    session.set_symmetric(True)
    session.drag(52, session.model.neutral[52] + [0, 5, 0])
    session.set_key(1.5)
    session.pin(40)
    session.set_weights(1.5, 0.01)
    return session, path


def _changed(path, **changes):
    content = {**json.loads(path.read_text()), **changes}
    path.write_text(json.dumps(content))
    return path


def test_every_step_is_saved_and_all_comes_back(saved, patch):
    session, path = saved
    other = PoseSession(patch[0], holistic=patch[1])
    open_pose(path, other)
    for kind in session.kinds:
        np.testing.assert_array_equal(other.coefficients(kind), session.coefficients(kind))
        np.testing.assert_array_equal(other.positions(kind), session.positions(kind))
        np.testing.assert_array_equal(
            other.state.keyframes[kind].coefficients, session.state.keyframes[kind].coefficients
        )
    assert other.state.pins.keys() == session.state.pins.keys()
    assert (other.state.beta, other.state.gamma, other.state.symmetric) == (1.5, 0.01, True)
    assert other.state.time == 1.5 and other.undo_label is None
    session.undo()
    assert json.loads(path.read_text())["beta"] == 0.5  # an undo is saved too


def test_opens_with_another_or_without_a_holistic_model(saved, patch, tmp_path):
    session, path = saved
    alone = PoseSession(patch[0])
    open_pose(path, alone)
    np.testing.assert_array_equal(alone.positions(), session.positions())
    alone.save(tmp_path / "alone.fwpose")
    both = PoseSession(patch[0], holistic=patch[1])
    open_pose(tmp_path / "alone.fwpose", both)
    moved = np.linalg.norm(both.positions("holistic") - both.model.neutral)
    assert 0 < np.linalg.norm(both.positions("holistic") - both.positions()) < moved
    assert len(both.state.keyframes["holistic"]) == 2


def test_refuses_another_models_pose(saved, patch):
    _, path = saved
    before = PoseSession(patch[1])
    with pytest.raises(FileFormatError, match="another model"):
        open_pose(path, before)
    assert not before.coefficients().any()


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"format": "other"}, "must be a pose"),
        ({"version": 9}, "version 1"),
        ({"beta": -1.0}, "beta must be finite and not negative"),
        ({"gamma": "much"}, "gamma"),
        ({"time": -3.0}, "time must be 0"),
        ({"symmetric": 1}, "true or false"),
        ({"pose": {"region": [1.0]}}, "the pose"),
        ({"keyframes": [{"time": 0.0}]}, "keyframes"),
        ({"pins": [{"vertex": 63, "target_mm": [0, 0, 0]}]}, r"\[0, 63\)"),
        ({"pins": [{"vertex": 1.5, "target_mm": [0, 0, 0]}]}, "whole number"),
        ({"pins": [{"vertex": 1, "target_mm": [0, 0]}]}, "target of a pin"),
        (
            {"pins": [{"vertex": 1, "target_mm": [0, 0, 0]}, {"vertex": 1, "target_mm": [0, 0, 5]}]},
            "at two places.*contradict",
        ),
    ],
)
def test_refuses_values_that_cannot_be(saved, patch, changes, words):
    _, path = saved
    other = PoseSession(patch[0], holistic=patch[1])
    with pytest.raises(FileFormatError, match=words):
        open_pose(_changed(path, **changes), other)
    assert not other.coefficients().any()


def test_refuses_what_is_no_file_or_no_json(tmp_path, patch):
    session = PoseSession(patch[0])
    with pytest.raises(StoreError, match="readable"):
        open_pose(tmp_path / "none.fwpose", session)
    for text in ("", "[1", "[]", "{}"):
        (tmp_path / "x.fwpose").write_text(text)
        with pytest.raises(FileFormatError, match="must be a pose"):
            open_pose(tmp_path / "x.fwpose", session)
    with pytest.raises(StoreError):
        session.save(tmp_path / "nowhere" / "x.fwpose")
