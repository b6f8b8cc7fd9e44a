from dataclasses import replace

import numpy as np
import pytest

from facewright.camera.pinhole import Intrinsics, RigidMotion
from facewright.camera.rotation import rotation_from_head_angles
from facewright.fitting import image_term
from facewright.fitting.clip_person import FrameState
from facewright.fitting.dense_model import CENTRE, FramePose
from facewright.fitting.face_surface import SurfacePoints
from facewright.fitting.image_term import (
    ImageTerm,
    _derivatives,
    _placed,
    _sampled,
    _shaded,
    _without,
    observe,
    softened,
)
from facewright.fitting.perspective_refinement import bounded_step
from facewright.fitting.rest_appearance import RestAppearance
from facewright.landmarks.face_crops import FaceCrop

LIGHT = np.array([0.2, -0.3, -0.1, 0.05, 0.1, -0.05, 0.05, 0.1])


@pytest.fixture(scope="module")
def surface(small_model):
    return SurfacePoints(small_model).of(small_model.blendshapes(small_model.sample_identity(np.random.default_rng(3))))


def make_state(beta):
    R = rotation_from_head_angles(12.0, -5.0, 3.0)
    motion = RigidMotion(R, np.array([10.0, -5.0, 650.0]) - R @ CENTRE)
    return FrameState(FramePose(motion, Intrinsics.for_image((480, 640), 960.0)), beta)


def draw(surface, brightness, state, side=160, gain=1.0):
    """Return the square that a camera would see of the points: brightness interpolated between them."""
    from scipy.interpolate import LinearNDInterpolator

    points, normals = surface.at(state.beta)
    seen = state.pose.motion.apply(points)
    pixels = state.pose.intrinsics.project(seen)
    level, _ = _shaded(brightness, LIGHT, normals @ state.pose.motion.rotation.T)
    low, high = pixels.min(axis=0) - 8, pixels.max(axis=0) + 8
    step = float((high - low).max()) / (side - 1)
    grid = low + step * np.stack(np.meshgrid(np.arange(side), np.arange(side)), axis=-1)
    picture = LinearNDInterpolator(pixels, gain * level, fill_value=60.0)(grid)
    return FaceCrop(np.clip(np.rint(picture), 0, 255).astype(np.uint8), low, step)


def texture(surface, rng):
    """Return brightness with detail of a centimetre or two."""
    waves = np.sin(surface.rest @ rng.normal(0, 0.12, (3, 6)) + rng.uniform(0, 6, 6)).mean(axis=1)
    return 120.0 * np.exp(0.5 * waves)


def test_derivatives_by_pose_and_coefficients(surface, rng):
    """J is the derivative of brightness found less brightness drawn, each along its own smooth function."""
    beta = rng.uniform(0, 0.1, 46)
    state = make_state(beta)
    slope = np.array([0.4, -0.7])
    brightness = texture(surface, rng)
    crop = FaceCrop(np.zeros((400, 400), np.uint8), np.array([120.0, 40.0]), 1.0)

    def residual(at):
        points, normals = surface.at(at.beta)
        _, camera, pixels, _ = _placed(crop, points, normals, at)
        return pixels @ slope - _shaded(brightness, LIGHT, camera)[0]

    points, normals = surface.at(beta)
    n = len(points)
    seen, camera, _, _ = _placed(crop, points, normals, state)
    level, by_normal = _shaded(brightness, LIGHT, camera)
    J = np.empty((n, 53), np.float32)
    pose = state.pose
    along = np.tile(slope, (n, 1)).T
    _derivatives(
        J, np.ones(n), level, by_normal, *along, seen, camera, pose.motion.rotation, pose.motion.apply(CENTRE),
        pose.intrinsics.focal_x, pose.scale, surface.deltas, surface.normal_deltas,
    )  # fmt: skip
    for k, h in enumerate([1e-4, 1e-4, 1e-4, 1e-2, 1e-2, 1e-4]):
        step = h * np.eye(6)[k]
        ahead, back = (replace(state, pose=pose.moved(sign * step)) for sign in (1, -1))
        numeric = (residual(ahead) - residual(back)) / (2 * h)
        np.testing.assert_allclose(J[:, k], numeric, atol=2e-3 * np.abs(numeric).max())
    np.testing.assert_allclose(J[:, 6], -level, rtol=1e-5)
    for i in range(0, 46, 7):
        step = 1e-2 * np.eye(46)[i]
        numeric = (residual(replace(state, beta=beta + step)) - residual(replace(state, beta=beta - step))) / 2e-2
        # the normal's length is not differentiated, which counts at the few points where lips roll: compare the others
        off = np.abs(J[:, 7 + i] - numeric)
        usual = off <= np.percentile(off, 95)
        assert np.linalg.norm(off[usual]) < 0.1 * np.linalg.norm(numeric[usual]) + 1e-6


def test_puffed_cheeks_and_a_turn_are_found(small_model, surface, rng):
    names = small_model.expression_names[1:]
    i = names.index("cheekPuff_L")
    beta = np.zeros(46)
    beta[i] = 0.7
    true = make_state(beta)
    brightness = texture(surface, rng)
    crop = draw(surface, brightness, true, gain=1.15)  # exposed longer than the clip is
    term = ImageTerm(surface, RestAppearance(brightness, LIGHT, np.zeros(len(brightness))))
    start = np.array([0.01, -0.015, 0.0, 0.4, -0.4, 0.0])
    state = FrameState(true.pose.moved(start), np.zeros(46))
    for _ in range(4):
        H, g = term.quadratic(crop, state)
        H[np.diag_indices(52)] += np.r_[np.full(6, 1e-6 * H.diagonal()[:6].max()), np.full(46, 8.0)]
        g[6:] += 4.0 + 8.0 * state.beta  # few shapes act
        step, beta = bounded_step(H, g, 6, state.beta, 0.0)
        state = FrameState(state.pose.moved(step), beta)
    assert abs(state.beta[i] - 0.7) < 0.12
    assert np.delete(state.beta, i).max() < 0.3
    turn = state.pose.motion.rotation @ true.pose.motion.rotation.T
    assert np.rad2deg(np.arccos((np.trace(turn) - 1) / 2)) < 0.35  # one degree at the start


def test_what_is_outside_or_unknown_does_not_count(surface, rng):
    state = make_state(np.zeros(46))
    brightness = texture(surface, rng)
    crop = draw(surface, brightness, state)
    nothing = ImageTerm(surface, RestAppearance(brightness, LIGHT, np.full(len(brightness), np.inf)))
    away = crop._replace(corner=crop.corner + 1000.0)
    for term, picture in ((nothing, crop), (ImageTerm(surface, RestAppearance(brightness, LIGHT, brightness)), away)):
        H, g = term.quadratic(picture, state)
        assert not H.any() and not g.any()
    samples = observe(surface, [crop, away], [state, state])
    assert samples.seen[0].max() == 1.0 and samples.seen[1].max() == 0.0
    level, _ = _shaded(brightness, LIGHT, samples.normals[0])
    well = samples.seen[0] > 0.9
    assert np.abs(samples.brightness[0] - level)[well].mean() < 6.0


def test_pictures_between_their_pixels(rng):
    pixels = rng.integers(0, 256, (20, 30), dtype=np.uint8)
    soft = softened(pixels)
    padded = pixels.astype(float)
    inner = sum(
        a * b * padded[1 + j : 19 + j, 1 + i : 29 + i]
        for j, a in ((-1, 0.25), (0, 0.5), (1, 0.25))
        for i, b in ((-1, 0.25), (0, 0.5), (1, 0.25))
    )
    np.testing.assert_allclose(soft[1:-1, 1:-1], inner, atol=1e-3)
    ramp = (3.0 * np.arange(30)[None] + 2.0 * np.arange(20)[:, None]).astype(np.float32)
    places = np.array([[4.3, 7.8], [20.0, 3.5], [0.5, 5.0], [29.0, 5.0]])
    value, by_x, by_y = _sampled(ramp, places)
    np.testing.assert_allclose(value[:2], places[:2] @ [3.0, 2.0], rtol=1e-6)
    np.testing.assert_allclose([by_x[:2], by_y[:2]], [[3.0, 3.0], [2.0, 2.0]], rtol=1e-5)
    assert not value[2:].any() and not by_x[2:].any()


def test_unknown_at_its_minimum(rng):
    A = rng.normal(size=(9, 5))
    H, g = A.T @ A, rng.normal(size=5)
    small_H, small_g = _without(2, H, g)
    np.testing.assert_allclose(np.linalg.solve(small_H, -small_g), np.delete(np.linalg.solve(H, -g), 2), rtol=1e-8)


def test_wide_errors_count_little(surface, rng, monkeypatch):
    state = make_state(np.zeros(46))
    brightness = texture(surface, rng)
    crop = draw(surface, brightness, state)
    hidden = crop.pixels.copy()
    hidden[60:100, 60:100] = 255
    term = ImageTerm(surface, RestAppearance(brightness, LIGHT, np.ones(len(brightness))))
    _, clean = term.quadratic(crop, state)
    _, robust = term.quadratic(crop._replace(pixels=hidden), state)
    monkeypatch.setattr(image_term, "_TAIL", 1e6)
    _, plain = term.quadratic(crop._replace(pixels=hidden), state)
    assert np.linalg.norm(robust - clean) < 0.1 * np.linalg.norm(plain - clean)
