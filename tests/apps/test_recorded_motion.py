import numpy as np
import pytest

from facewright.apps.performance_files import curves_from_performance
from facewright.apps.recorded_motion import read_recorded_motion
from facewright.errors import FileFormatError, NoFaceError
from facewright.faces.acting import act_range_of_motion
from facewright.faces.acting_style import draw_style
from facewright.io.live_link import write_live_link
from facewright.models.performance import Performance


def recorded(path, tracked, seconds=4.0, rate=30.0):
    acted = act_range_of_motion(
        draw_style(np.random.default_rng(0)), np.random.default_rng(0), seconds=seconds, frames_per_second=rate
    )
    fields = {name: getattr(acted, name) for name in acted.__dataclass_fields__}
    performance = Performance(**{**fields, "tracked": tracked(acted.times)})
    write_live_link(path, curves_from_performance(performance))
    return acted


def test_curves_become_even_smooth_and_quick(tmp_path):
    acted = recorded(tmp_path / "a.csv", lambda times: (times > 0.5) & (times < 3.5))
    motion = read_recorded_motion(tmp_path / "a.csv", 120.0)
    assert motion.times[0] == 0 and np.allclose(np.diff(motion.times), 1 / 120) and motion.tracked.all()
    assert 2.8 < motion.times[-1] < 3.0  # what lies before and after the face is left out
    # curves pass where they were, and are no longer polygons
    kept = acted.times[(acted.times > 0.5) & (acted.times < 3.5)]
    jaw = acted.weights.std(axis=0).argmax()  # or whatever moves most
    there = acted.weights[np.searchsorted(acted.times, kept), jaw]
    assert np.abs(np.interp(kept - kept[0], motion.times, motion.weights[:, jaw]) - there).max() < 0.05
    linear = np.interp(motion.times + kept[0], acted.times, acted.weights[:, jaw])
    assert np.abs(np.diff(motion.weights[:, jaw], 3)).max() < 0.6 * np.abs(np.diff(linear, 3)).max()


def test_too_little_of_a_face_is_refused(tmp_path):
    recorded(tmp_path / "a.csv", lambda times: (times > 1.0) & (times < 1.4))
    with pytest.raises(FileFormatError, match="at least 1 s"):
        read_recorded_motion(tmp_path / "a.csv", 120.0)
    recorded(tmp_path / "b.csv", lambda times: times < -1)
    with pytest.raises(NoFaceError):
        read_recorded_motion(tmp_path / "b.csv", 120.0)


def test_the_real_recording_can_be_acted(test_data):
    motion = read_recorded_motion(test_data / "curves" / "alex_rom_3.csv", 120.0)
    assert 120 < motion.times[-1] < 140 and (motion.weights.max(axis=0) > 0.3).sum() > 30
