import numpy as np
import pytest

from facewright.errors import ShapeError, ValueRangeError
from facewright.landmarks.track import LandmarkTrack


def make(rng, n=6, missing=(2,), cuts=None):
    frames = [None if k in missing else rng.uniform(0, 100, (478, 2)) for k in range(n)]
    return LandmarkTrack.of(np.arange(n) / 25.0, frames, (120, 160), cuts), frames


def test_keeps_points_and_losses(rng):
    track, frames = make(rng)
    assert track.n_frames == 6 and track.points.dtype == np.float32
    assert track.tracked.tolist() == [True, True, False, True, True, True]
    assert np.isnan(track.points[2]).all()
    np.testing.assert_allclose(track.landmarks(1).points, frames[1], atol=1e-4)
    assert not track.landmarks(2).present.any()
    part = track.part(slice(1, 4))
    assert part.n_frames == 3 and part.tracked.tolist() == [True, False, True]


def test_shots_are_what_lies_between_cuts(rng):
    track, _ = make(rng, cuts=[True, False, False, True, False, False])
    assert track.shots() == [slice(0, 3), slice(3, 6)]
    assert make(rng)[0].shots() == [slice(0, 6)]


def test_refuses_what_is_no_track(rng):
    frames = [rng.uniform(0, 100, (478, 2))] * 2
    with pytest.raises(ValueRangeError, match="increase"):
        LandmarkTrack.of([0.0, 0.0], frames, (120, 160))
    with pytest.raises(ShapeError, match="as many as times"):
        LandmarkTrack.of([0.0], frames, (120, 160))
    with pytest.raises(ShapeError):
        LandmarkTrack.of([0.0, 1.0], [np.zeros((468, 2)), None], (120, 160))
    with pytest.raises(ValueRangeError, match="finite"):
        LandmarkTrack.of([0.0], [np.full((478, 2), np.nan)], (120, 160))
    with pytest.raises(ValueRangeError, match="image_size"):
        LandmarkTrack.of([0.0], [frames[0]], (0, 160))
