import numpy as np
import pytest

from facewright.errors import ValueRangeError
from facewright.evaluation.scan import _Way, record_expressions, run
from facewright.faces.expressions import expression_weights


class FakeFitter:
    """Returns the truth moved by a known amount, so that every metric is known."""

    def __init__(self, face, shift):
        from facewright.fitting.scan_contact import ContactPairs

        self.face, self.shift, self.contacts = face.skin(), shift, ContactPairs(face.skin())


def expression_of(face, fitter):
    from facewright.camera.pinhole import RigidMotion
    from facewright.fitting.scan import ScanFit

    truth = fitter.face.mean_shape.astype(float)
    still = RigidMotion(np.eye(3), np.zeros(3))
    report = {"stage1_rms_mm": 1.0, "stage2_rms_mm": 0.3}
    fit = ScanFit(truth + fitter.shift, truth + fitter.shift, np.zeros(1), still, report)

    class Expression:
        pass

    expression = Expression()
    expression.truth = truth
    return expression, fit


def test_a_known_error_is_measured(builtin_face):
    fitter = FakeFitter(builtin_face, np.array([0.0, 3.0, 0.0]))
    way = _Way(fitter)
    expression, fit = expression_of(builtin_face, fitter)
    way._measure(fit, expression, True)
    metrics = way.metrics()
    assert metrics["neutral_correspondence_rms_mm"] == pytest.approx(3.0)
    assert 0.2 < metrics["neutral_surface_rms_mm"] < 3.0, "a shift along the face is less far from its surface"
    assert metrics["mean_face_surface_rms_mm"] == pytest.approx(0.0, abs=1e-5)
    assert metrics["lip_gap_mm"] == pytest.approx(0.0, abs=1e-9), "a shift opens no lips"
    assert metrics["neutral_stage2_to_depth_rms_mm"] == 0.3


def test_opened_lips_are_a_gap(builtin_face):
    fitter = FakeFitter(builtin_face, np.zeros(3))
    upper = fitter.contacts.pairs["lips"][0]
    fitter.shift = np.zeros(fitter.face.mean_shape.shape)
    fitter.shift[upper] = [0, 2.0, 0]
    way = _Way(fitter)
    expression, fit = expression_of(builtin_face, fitter)
    way._measure(fit, expression, True)
    assert way.metrics()["lip_gap_mm"] == pytest.approx(2.0)


def test_missing_landmarks_count_as_a_failed_fit(builtin_face):
    way = _Way(FakeFitter(builtin_face, np.zeros(3)))
    way.add(None, None, at_rest=True)
    assert way.metrics() == {"failed_fits": 1.0}


def test_refuses_no_subjects(builtin_face):
    with pytest.raises(ValueRangeError, match="subjects"):
        run(builtin_face, 0, subjects=0)


@pytest.mark.slow
def test_fused_recordings_are_fitted_within_the_targets(builtin_face):
    pytest.importorskip("open3d")
    from facewright.apps.simulated_recording import simulate_capture_subject
    from facewright.fitting.scan import ScanFitter

    rng = np.random.default_rng(4)
    subject = simulate_capture_subject(builtin_face, rng)
    way = _Way(ScanFitter(builtin_face))
    guides = np.stack([np.zeros(46), expression_weights("mouth_stretch")])
    for number, expression in enumerate(record_expressions(subject, rng, None, n_frames=12, expressions=guides)):
        way.add(expression, expression.refined, at_rest=number == 0)
    metrics = way.metrics()
    assert metrics["failed_fits"] == 0
    assert metrics["neutral_stage2_to_depth_rms_mm"] <= 0.39
    assert metrics["neutral_surface_rms_mm"] <= 0.8 < metrics["mean_face_surface_rms_mm"]
    assert metrics["expressions_surface_rms_mm"] <= 1.0
    assert metrics["lip_gap_mm"] < 1.0
