import numpy as np
import pytest

from facewright.apps.pose_state import PoseHistory, PoseState
from facewright.errors import ValueRangeError


def _state(**changes):
    return PoseState({}, {}, **changes)


def test_steps_merge_and_the_oldest_are_forgotten():
    states = [_state(beta=k) for k in range(6)]
    history = PoseHistory(states[0], limit=3)
    for state in states[1:]:
        history.push("drag", state)
    assert [history.back().beta for _ in range(3)] == [4, 3, 2]
    with pytest.raises(ValueRangeError, match="undo"):
        history.back()
    assert history.redo_label == "drag" and history.forth().beta == 3
    history.push("weights", _state(beta=7), merge=True)
    history.push("weights", _state(beta=8), merge=True)
    assert history.redo_label is None and history.undo_label == "weights"
    assert history.present.beta == 8 and history.back().beta == 3


@pytest.mark.parametrize("changes", [{"beta": -1.0}, {"gamma": np.nan}, {"time": -0.5}, {"beta": np.inf}])
def test_refuses(changes):
    with pytest.raises(ValueRangeError, match=next(iter(changes))):
        _state(**changes)
