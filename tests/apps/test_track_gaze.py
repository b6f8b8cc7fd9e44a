"""Gaze from the irises of a tracked clip."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from facewright.apps.track_gaze import track_gaze
from facewright.camera.pinhole import Intrinsics, RigidMotion
from facewright.camera.rotation import rotation_from_head_angles
from facewright.faces import Face
from facewright.faces.blendshape_names import BLENDSHAPE_NAMES
from facewright.fitting.gaze import SIDES, Eyeballs
from facewright.landmarks.scheme import load_scheme
from facewright.landmarks.track import LandmarkTrack
from facewright.models.performance import Performance

T = 60


def clip(face: Face, rng: np.random.Generator, noise: float) -> tuple[Any, LandmarkTrack, np.ndarray]:
    """Make irises of a person who looks around, turns the head and blinks in frames 20 to 25."""
    t = np.arange(T) / 25
    both = np.deg2rad(np.stack([12 * np.sin(2 * t), 6 * np.sin(3 * t + 1)], axis=1))
    both[40:] += np.deg2rad([8.0, 0])  # a glance aside
    gaze = np.repeat(both[:, None], 2, axis=1)
    intrinsics = Intrinsics.for_image((480, 640))
    rotations = np.array([rotation_from_head_angles(10 * np.sin(x), 4 * np.cos(x), 2) for x in t])
    translations = np.tile([5.0, 0.0, 600.0], (T, 1))
    groups = load_scheme("mediapipe478").groups
    points = np.full((T, 478, 2), 300.0, np.float32)
    eyes = Eyeballs(face, face.mean_shape)
    for k in range(T):
        vertices = face.mean_shape.astype(np.float64)
        eyes.turn(vertices, gaze[k])
        seen = intrinsics.project(RigidMotion(rotations[k], translations[k]).apply(vertices))
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
    model = SimpleNamespace(provenance={"face": "builtin"}, n_vertices=face.topology.n_vertices, topology=face.topology)
    who = SimpleNamespace(model=model, intrinsics=intrinsics, rig=SimpleNamespace(neutral=face.mean_shape))
    return SimpleNamespace(identity=who, performance=performance), LandmarkTrack(t, points, tracked, (480, 640)), gaze


@pytest.mark.parametrize("noise, limit", [(0.0, 0.8), (0.15, 1.6)])
def test_gaze_is_found_and_held_through_blinks(
    builtin_face: Face, rng: np.random.Generator, noise: float, limit: float
) -> None:
    fit, track, truth = clip(builtin_face, rng, noise)
    found = track_gaze(fit, track)
    error = np.rad2deg(np.abs(found - truth))
    steady = np.abs(np.arange(T) - 39.5) > 3  # the glance is smoothed over a frame or two
    assert error[steady].mean() < limit
    assert error.max() < 8
    assert np.rad2deg(np.abs(truth)).mean() > 5


def test_closed_eyes_all_the_time_look_straight(builtin_face: Face, rng: np.random.Generator) -> None:
    fit, track, _ = clip(builtin_face, rng, 0.0)
    fit.performance.weights[:, BLENDSHAPE_NAMES.index("eyeBlink_R")] = 1
    assert not track_gaze(fit, track).any()


def test_gaze_is_zero_where_the_face_is_not_installed(builtin_face: Face, rng: np.random.Generator) -> None:
    fit, track, _ = clip(builtin_face, rng, 0.0)
    fit.identity.model.provenance = {"face": "nobody's"}
    assert not track_gaze(fit, track).any()
