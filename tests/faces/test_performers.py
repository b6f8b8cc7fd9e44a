from dataclasses import replace

import numpy as np
import pytest

from facewright.errors import ValueRangeError
from facewright.faces.performers import (
    FACS_NAMES,
    PERFORMER_NAMES,
    RANGE_OF_MOTION_NAME,
    TEST_NAMES,
    TRAIN_NAMES,
    simulate_performers,
)
from facewright.numeric.similarity import estimate_similarity


@pytest.fixture(scope="module")
def performers(builtin_face):
    return simulate_performers(builtin_face, np.random.default_rng(2), names=("M1", "F2"))


def test_clips_are_those_of_the_paper(performers):
    assert (len(TRAIN_NAMES), len(TEST_NAMES), len(FACS_NAMES)) == (12, 6, 86)
    assert not set(TRAIN_NAMES) & set(TEST_NAMES)
    for emotion in ("pride", "rage", "contempt"):
        assert sum(name.startswith(emotion) for name in TRAIN_NAMES) == 4
    first, other = performers
    assert len(first.clips) == 1 + 18 + 1 + 86 and len(other.clips) == 19
    assert PERFORMER_NAMES == ("M1", "F1", "M2", "F2")


def test_a_performer_is_the_same_alone(builtin_face, performers):
    (again,) = simulate_performers(builtin_face, np.random.default_rng(2), names=("F2",))
    other = performers[1]
    assert np.array_equal(again.person.neutral, other.person.neutral)
    assert np.array_equal(again.layout.corners, other.layout.corners)
    clips = [performer.clip("rage_05") for performer in (again, other)]
    assert np.array_equal(clips[0].performance.weights, clips[1].performance.weights)
    marks = [clip.markers(np.random.default_rng(0)).positions for clip in clips]
    assert np.array_equal(*marks, equal_nan=True)


def test_performers_differ_in_size_layout_and_acting(performers):
    first, other = performers
    eyes = [np.ptp(p.person.neutral[p.face.topology.landmarks["ibug68"][[36, 45]], 0]) for p in performers]
    assert eyes[0] > eyes[1]
    assert len(first.layout.labels) != len(other.layout.labels)
    a, b = first.clip("pride_01").performance, other.clip("pride_01").performance
    n = min(a.n_frames, b.n_frames)
    assert np.abs(a.weights[:n] - b.weights[:n]).mean() > 0.02
    # proportions too, not only sizes
    fit = estimate_similarity(other.person.neutral.astype(float), first.person.neutral.astype(float))
    moved = fit.scale * other.person.neutral @ fit.rotation.T + fit.translation
    assert np.linalg.norm(moved - first.person.neutral, axis=1).mean() > 1.0


def test_the_neutral_is_a_clip(performers):
    clip = performers[0].clip("neutral")
    meshes = clip.meshes(rigid=False)
    assert np.abs(meshes.vertices - performers[0].person.neutral[: performers[0].face.n_skin]).max() < 0.02
    assert all(clip.record(np.random.default_rng(seed))[1].swaps == () for seed in range(20))
    truth = clip.marker_truth(rigid=False)
    assert np.abs(truth - performers[0].layout.centres(performers[0].person.neutral)).max() < 0.02


def test_markers_are_the_truth_with_noise_and_faults(performers):
    clip = performers[0].clip("rage_02")
    data, faults = clip.record(np.random.default_rng(7))
    assert np.array_equal(data.positions, clip.markers(np.random.default_rng(7)).positions, equal_nan=True)
    assert 0.9 < data.seen.mean() < 1.0
    good = data.seen & faults.seen
    for a, b, start, stop in faults.swaps:
        good[start:stop, [a, b]] = False
    error = (data.positions - clip.marker_truth())[good]
    assert error.std() == pytest.approx(0.2, rel=0.03)


def test_truth_sits_on_the_mesh_in_every_frame(performers):
    clip = performers[1].clip("contempt_05")
    frames = slice(40, None, 60)
    meshes, truth = clip.meshes(frames), clip.marker_truth(frames)
    assert np.allclose(performers[1].layout.centres(meshes.vertices), truth, atol=0.02)
    still = clip.meshes(frames, rigid=False)
    rotations, translations = clip.world_from_head
    moved = np.einsum("tij,tnj->tni", rotations[frames], still.vertices) + translations[frames, None]
    assert np.allclose(moved, meshes.vertices, atol=1e-3)
    assert 1100 < meshes.vertices[..., 1].mean() < 1300  # a sitting head, the floor at 0
    assert clip.meshes(slice(0, 1), skin=False).vertices.shape[1] == performers[1].face.topology.n_vertices


def test_faces_move_as_fast_as_faces_do(performers):
    for name, fastest, fast in (("pride_02", 330, 180), ("rage_05", 450, 250), ("contempt_01", 330, 180)):
        truth = performers[0].clip(name).marker_truth(rigid=False)
        speeds = np.linalg.norm(np.diff(truth, axis=0), axis=2) * 120.0
        assert speeds.max() < fastest, name
        rest = performers[0].layout.centres(performers[0].person.neutral)
        ids = performers[0].face.topology.landmarks["ibug68"]
        brows = rest[:, 1] > performers[0].person.neutral[ids[17:27], 1].max()
        chin = rest[:, 1] < performers[0].person.neutral[ids[57], 1] - 8
        assert np.quantile(speeds[:, brows].max(axis=1), 0.99) < 150 and np.quantile(speeds[:, chin], 0.999) < fast
        assert speeds[:, chin].max() > 60


def test_motion_is_not_in_the_span_of_46_shapes(performers):
    performer = performers[0]
    moved = (
        performer.clip("rage_01").meshes(slice(None, None, 8), rigid=False).vertices
        - performer.person.neutral[: performer.face.n_skin]
    )
    basis = performer.person.deltas[:, : performer.face.n_skin].reshape(46, -1).astype(float)
    flat = moved.reshape(len(moved), -1).astype(float)
    coefficients = np.linalg.lstsq(basis.T, flat.T, rcond=None)[0]
    share = np.linalg.norm(flat - coefficients.T @ basis) / np.linalg.norm(flat)
    assert 0.03 < share < 0.4


def test_recorded_curves_become_the_range_of_motion(performers):
    recorded = performers[1].clip("pride_04").performance
    first = replace(performers[0], recorded=recorded)
    acted = first.clip(RANGE_OF_MOTION_NAME).performance
    assert np.array_equal(acted.weights, recorded.weights)
    assert not np.array_equal(acted.translations, recorded.translations)
    made_up = performers[0].clip(RANGE_OF_MOTION_NAME).performance
    assert made_up.n_frames == 8400


def test_mistakes_are_refused(builtin_face, performers):
    with pytest.raises(ValueRangeError, match="pride_09"):
        performers[0].clip("pride_09")
    with pytest.raises(ValueRangeError, match="facs_01"):
        performers[1].clip("facs_01")
    for names in ((), ("M1", "M1"), ("M3",)):
        with pytest.raises(ValueRangeError, match="once each"):
            simulate_performers(builtin_face, np.random.default_rng(0), names=names)
