"""Gaze from the irises of a tracked clip."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest

from facewright.camera.pinhole import Intrinsics, RigidMotion
from facewright.camera.rotation import rotation_from_head_angles
from facewright.faces import Face
from facewright.faces.blendshape_names import BLENDSHAPE_NAMES
from facewright.fitting.clip_gaze import clip_gaze, whole_face
from facewright.fitting.gaze import SIDES, Eyeballs
from facewright.landmarks.scheme import load_scheme
from facewright.landmarks.track import LandmarkTrack
from facewright.models.performance import Performance

T = 60
CAMERA = Intrinsics.for_image((480, 640))


def clip(face: Face, rng: np.random.Generator, noise: float) -> tuple[Performance, LandmarkTrack, np.ndarray]:
    """Make irises of a person who looks around, turns the head and blinks in frames 20 to 25."""
    t = np.arange(T) / 25
    both = np.deg2rad(np.stack([12 * np.sin(2 * t), 6 * np.sin(3 * t + 1)], axis=1))
    both[40:] += np.deg2rad([8.0, 0])  # a glance aside
    gaze = np.repeat(both[:, None], 2, axis=1)
    rotations = np.array([rotation_from_head_angles(10 * np.sin(x), 4 * np.cos(x), 2) for x in t])
    translations = np.tile([5.0, 0.0, 600.0], (T, 1))
    groups = load_scheme("mediapipe478").groups
    points = np.full((T, 478, 2), 300.0, np.float32)
    eyes = Eyeballs(face, face.mean_shape)
    for k in range(T):
        vertices = face.mean_shape.astype(np.float64)
        eyes.turn(vertices, gaze[k])
        seen = CAMERA.project(RigidMotion(rotations[k], translations[k]).apply(vertices))
        for side in SIDES:
            iris = seen[face.topology.masks[f"iris_{side}"]].mean(axis=0)
            points[k, groups[f"{side}_iris"]] = iris + rng.normal(size=2) * noise
    weights = np.zeros((T, 46))
    weights[20:26, BLENDSHAPE_NAMES.index("eyeBlink_L")] = 0.9
    points[20:26] += 5
    tracked = np.ones(T, bool)
    tracked[50:52] = False
    points[50:52] = np.nan
    zeros = np.zeros((T, 2, 2))
    performance = Performance(t, BLENDSHAPE_NAMES, weights, rotations, translations, zeros, tracked)
    return performance, LandmarkTrack(t, points, tracked, (480, 640)), gaze


@pytest.mark.parametrize("noise, limit", [(0.0, 0.8), (0.15, 1.6)])
def test_gaze_is_found_and_held_through_blinks(
    builtin_face: Face, rng: np.random.Generator, noise: float, limit: float
) -> None:
    performance, track, truth = clip(builtin_face, rng, noise)
    found = clip_gaze(builtin_face, builtin_face.mean_shape, CAMERA, performance, track)
    error = np.rad2deg(np.abs(found - truth))
    steady = np.abs(np.arange(T) - 39.5) > 3  # the glance is smoothed over a frame or two
    assert error[steady].mean() < limit
    assert error.max() < 8
    assert np.rad2deg(np.abs(truth)).mean() > 5


def test_closed_eyes_all_the_time_look_straight(builtin_face: Face, rng: np.random.Generator) -> None:
    performance, track, _ = clip(builtin_face, rng, 0.0)
    performance.weights[:, BLENDSHAPE_NAMES.index("eyeBlink_R")] = 1
    assert not clip_gaze(builtin_face, builtin_face.mean_shape, CAMERA, performance, track).any()


def test_whole_face_of_models_of_all_parts_and_of_the_skin(builtin_face: Face) -> None:
    for part in (builtin_face, builtin_face.skin()):
        model = SimpleNamespace(provenance={"face": "builtin"}, topology=part.topology)
        found = whole_face(model, part.mean_shape)  # type: ignore[arg-type]
        assert found is not None and found[0] is builtin_face
        assert np.abs(found[1] - builtin_face.mean_shape).max() < 0.1
    assert whole_face(SimpleNamespace(provenance={"face": "nobody's"}, topology=None), np.zeros((1, 3))) is None
