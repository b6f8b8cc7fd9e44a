import pytest

from facewright.errors import ValueRangeError
from facewright.evaluation import registration


def test_a_registration_beats_its_baselines(builtin_face, monkeypatch):
    monkeypatch.setattr(registration, "_nricp", lambda *_: None)  # as where trimesh is not installed
    monkeypatch.setattr(registration, "_MODES", 12)
    steps = []
    metrics = registration.run(builtin_face, 4, lambda *s: steps.append(s), subjects=1)
    assert metrics["surface_rms_mm"] < 0.5 * metrics["landmarks_only_surface_rms_mm"]
    assert metrics["correspondence_rms_mm"] < metrics["landmarks_only_correspondence_rms_mm"]
    assert metrics["correspondence_rms_mm"] < 0.7 * metrics["mean_face_correspondence_rms_mm"]
    assert metrics["with_model_surface_rms_mm"] < metrics["mean_face_surface_rms_mm"]
    assert metrics["seconds"] > 0
    assert not any(name.startswith("nricp") for name in metrics)
    assert steps == [("registering", 1, 1)]


def test_what_cannot_be_measured_is_refused(builtin_face, monkeypatch):
    with pytest.raises(ValueRangeError, match="subjects"):
        registration.run(builtin_face, 0, subjects=0)
    monkeypatch.setattr(registration, "_MODES", 10_000)
    with pytest.raises(ValueRangeError, match="identity modes"):
        registration.run(builtin_face, 0)


@pytest.mark.slow
@pytest.mark.timeout(1200)
def test_ahead_of_nricp_on_ict(ict_face):
    pytest.importorskip("trimesh")
    pytest.importorskip("rtree")
    metrics = registration.run(ict_face, 0, subjects=1)
    for name in ("surface_rms_mm", "correspondence_rms_mm", "seconds"):
        assert metrics[name] < metrics[f"nricp_{name}"]
