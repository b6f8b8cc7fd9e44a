import numpy as np
import pytest

from facewright.camera.pinhole import Intrinsics, RigidMotion
from facewright.camera.rotation import rotation_from_head_angles
from facewright.fitting.dense_model import FramePose
from facewright.fitting.performance_smoothing import fill_gaps, smooth_coefficients, smooth_motion
from facewright.models.performance import Performance

NAMES = ("eyeBlink_L", "jawOpen", "browDown_L")


def quadratics(measured, precision):
    T, B = measured.shape
    return np.tile(precision * np.eye(B), (T, 1, 1)), -precision * measured


def test_quiet_noise_goes_and_blinks_stay(rng):
    truth = np.zeros((80, 3))
    truth[40:43, 0] = [0.6, 1.0, 0.6]
    truth[20:60, 1] = 0.5
    measured = truth + rng.normal(0, 0.05, truth.shape)
    H, s = quadratics(measured, 1 / 0.05**2)
    steps = np.full(79, 0.04)
    smooth = smooth_coefficients(H, s, np.clip(measured, 0, 1), steps, NAMES)
    assert smooth.min() >= 0 and smooth.max() <= 1
    assert smooth[41, 0] > 0.85 and smooth[37, 0] < 0.15 and smooth[45, 0] < 0.15
    assert np.abs(smooth[:, 2]).mean() < 0.85 * np.abs(np.clip(measured[:, 2], 0, 1)).mean()
    assert np.abs(np.diff(smooth[:, 2], 2)).mean() < 0.5 * np.abs(np.diff(np.clip(measured[:, 2], 0, 1), 2)).mean()
    assert np.abs(smooth[25:55, 1] - 0.5).mean() < 0.04


def test_it_minimises_its_energy(rng):
    """The stated energy (which has several minima) has no slope left that the bounds do not hold."""
    T = 6
    A = rng.normal(size=(T, 5, 3))
    H = A.transpose(0, 2, 1) @ A + np.eye(3)
    s = -(H @ rng.uniform(0, 1, (T, 3, 1)))[..., 0]
    sigma2 = np.array([0.2, 0.06, 0.04]) ** 2

    def energy(x):
        x = x.reshape(T, 3)
        d = np.diff(x, axis=0)
        frames = 0.5 * np.einsum("ti,tij,tj->", x, H, x) + (s * x).sum()
        return frames + (2.5 * np.log1p(d**2 / sigma2 / 4.0)).sum()

    start = np.full((T, 3), 0.5)
    ours = start
    for _ in range(20):
        ours = smooth_coefficients(H, s, ours, np.full(T - 1, 0.04), NAMES)
    x, h = ours.ravel(), 1e-6
    slope = np.array([(energy(x + h * e) - energy(x - h * e)) / (2 * h) for e in np.eye(len(x))])
    held = ((x < 1e-9) & (slope > 0)) | ((x > 1 - 1e-9) & (slope < 0))
    assert np.abs(np.where(held, 0.0, slope)).max() * sigma2.min() < 1e-3  # in units of coefficients
    assert energy(x) < energy(start.ravel())


def test_heads_are_smoothed_without_lag(rng):
    T = 60
    poses, truth = [], []
    for k in range(T):
        yaw = 15 * np.sin(2 * np.pi * k / 40)
        truth.append(yaw)
        R = rotation_from_head_angles(yaw + rng.normal(0, 0.5), 0, 0)
        poses.append(FramePose(RigidMotion(R, np.array([0, 0, 600.0])), Intrinsics.for_image((480, 640))))
    rotations, translations = smooth_motion(poses, np.arange(T) / 25.0)
    from facewright.camera.rotation import head_angles_from_rotation

    yaws = np.array([head_angles_from_rotation(R)[0] for R in rotations])
    rough = np.array([head_angles_from_rotation(p.motion.rotation)[0] for p in poses])
    assert np.abs(yaws - truth).mean() < 0.7 * np.abs(rough - truth).mean()
    assert np.abs(np.diff(yaws, 2)).mean() < 0.6 * np.abs(np.diff(rough, 2)).mean()
    assert translations.shape == (T, 3)
    same = smooth_motion(poses[:2], np.arange(2) / 25.0)[0]
    np.testing.assert_allclose(same[0], poses[0].motion.rotation)


def test_gaps_hold_then_ease_to_the_neutral():
    T = 60
    tracked = np.ones(T, bool)
    tracked[10:50] = False
    weights = np.zeros((T, 3))
    weights[:10, 1] = 0.8
    P = Performance(
        np.arange(T) / 25.0,
        NAMES,
        weights,
        np.tile(np.eye(3), (T, 1, 1)),
        np.zeros((T, 3)),
        np.zeros((T, 2, 2)),
        tracked,
    )
    filled = fill_gaps(P)
    assert filled.weights[15, 1] == pytest.approx(0.8)
    assert filled.weights[45, 1] == 0.0
    assert (np.diff(filled.weights[10:50, 1]) <= 1e-12).all()
    assert fill_gaps(filled.__class__(**{**filled.__dict__, "tracked": np.ones(T, bool)})) is not None
