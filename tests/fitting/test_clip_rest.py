import numpy as np
import pytest

from facewright.errors import ShapeError
from facewright.fitting.clip_rest import without_rest


def test_what_is_always_there_goes_and_what_is_acted_stays(rng):
    acted = np.zeros((200, 4))
    acted[50:90, 0] = 0.8
    acted[:, 1] = 0.15 + 0.02 * rng.random(200)
    acted[100:130, 1] += 0.5
    acted[:, 2] = 0.9  # smiles from beginning to end
    ours = without_rest(acted)
    np.testing.assert_array_equal(ours[:, [0, 2, 3]], acted[:, [0, 2, 3]])
    assert ours[:50, 1].max() < 0.03 and ours[100:130, 1].min() > 0.48


def test_short_clips_keep_more_and_none_is_no_fault():
    short = np.full((15, 1), 0.2)
    np.testing.assert_allclose(without_rest(short), 0.2 * (1 - 15 / 75))
    assert without_rest(np.zeros((0, 46))).shape == (0, 46)
    with pytest.raises(ShapeError, match="weights"):
        without_rest(np.zeros(46))
