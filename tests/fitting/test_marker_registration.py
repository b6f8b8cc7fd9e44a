"""Markers of simulated performers become meshes: true surfaces are met, faults are mended, bad input is refused."""

import numpy as np
import pytest
from scipy.spatial import cKDTree

from facewright.errors import DegenerateError, ValueRangeError
from facewright.faces.marker_faults import MarkerFaults, faulty_markers
from facewright.faces.performers import simulate_performers
from facewright.fitting.marker_placement import find_up, place_markers
from facewright.fitting.marker_registration import RegistrationSettings, _usual_labels, register_performer
from facewright.fitting.marker_template import marker_template
from facewright.io.marker_data import MarkerData
from facewright.mesh.closest_point import ClosestPoints

STEP = 6


@pytest.fixture(scope="module")
def scene(builtin_face):
    """One performer, a clip of two seconds every sixth frame, and what it truly is."""
    performer = simulate_performers(builtin_face, np.random.default_rng(31), names=("F2",))[0]
    clip = performer.clip("rage_05")
    frames = slice(60, 300, STEP)
    truth = clip.meshes(frames)
    centres = clip.marker_truth(frames)
    rest = performer.clip("neutral").marker_truth(slice(0, 8))
    return performer, truth, centres, rest


def _markers(times, labels, centres, rng, seen=None, swaps=()):
    seen = np.ones(centres.shape[:2], bool) if seen is None else seen
    return MarkerData(times, labels, faulty_markers(centres, MarkerFaults(seen, tuple(swaps)), 0.2, rng))


@pytest.fixture(scope="module")
def registered(scene, builtin_face):
    performer, truth, centres, rest = scene
    rng = np.random.default_rng(5)
    seen = rng.random(centres.shape[:2]) > 0.01
    seen[10:16, 7] = False
    swaps = _swaps(rest[0])
    clips = {
        "neutral": _markers(np.arange(8) / 120.0, performer.layout.labels, rest, rng),
        "rage": _markers(truth.times, performer.layout.labels, centres, rng, seen, swaps),
    }
    return register_performer(clips, builtin_face, name="F2"), seen, swaps


def _swaps(rest):
    """Neighbours whose labels are exchanged for ten frames."""
    near = cKDTree(rest).query(rest, k=2)[1][:, 1]
    return [(20, int(near[20]), 5, 15), (100, int(near[100]), 20, 30)]


def _rms(lengths):
    return float(np.sqrt((np.asarray(lengths) ** 2).mean()))


def test_surface_and_correspondence_are_met(scene, registered, builtin_face):
    _, truth, _, _ = scene
    data = registered[0].data
    recorded = data.clip("rage").recorded()
    true = truth.vertices[:, data.vertex_ids].astype(float)
    motion = np.linalg.norm(true - true.mean(axis=0), axis=2)
    assert _rms(motion) > 3.0  # there is something to follow
    assert _rms(np.linalg.norm(recorded - true, axis=2)) < 2.0
    surface = [ClosestPoints(truth.vertices[t], truth.faces).query(recorded[t]).distances for t in range(0, 40, 8)]
    assert _rms(surface) < 0.6


def test_labels_and_gaps_are_mended_and_told(registered):
    found, seen, swaps = registered
    notes = found.data.statistics["clips"]["rage"]
    there = sum(int(seen[s:e, [a, b]].sum()) for a, b, s, e in swaps)
    assert 0.8 * there <= notes["relabelled"] <= there
    assert notes["filled"] + notes["beyond_limit"] >= (~seen).sum()
    assert notes["frames"] == 40 and notes["frames_left_out"] == 0 and notes["residual_mm"] < 0.3
    assert found.data.statistics["neutral"] == "neutral" and found.data.statistics["markers"] == seen.shape[1]


def test_lips_do_not_cross(registered, builtin_face):
    """On the coarse mesh the rims' vertices of upper lip stay above those of the lower lip."""
    data = registered[0].data
    masks = builtin_face.topology.masks
    upper = np.flatnonzero(np.isin(data.vertex_ids, masks["lip_contact_upper"]))
    lower = np.flatnonzero(np.isin(data.vertex_ids, masks["lip_contact_lower"]))
    assert len(upper) >= 3 and len(lower) >= 3
    vertices = data.clip("rage").vertices
    x = data.neutral[:, 0]
    nearest = lower[np.abs(x[upper][:, None] - x[lower]).argmin(axis=1)]
    gap = vertices[:, upper, 1] - vertices[:, nearest, 1] - (data.neutral[upper, 1] - data.neutral[nearest, 1])
    assert gap.min() > -1.5


def test_the_head_is_held_still(scene, registered, builtin_face):
    data = registered[0].data
    clip = data.clip("rage")
    assert np.allclose(np.linalg.det(clip.rotations), 1.0)
    forehead = np.isin(data.vertex_ids, builtin_face.topology.masks["nose"]) & (data.neutral[:, 1] > 20.0)
    assert forehead.sum() >= 3
    assert (
        _rms(np.linalg.norm(clip.vertices[:, forehead] - data.neutral[forehead], axis=2)) < 1.2
    )  # rage wrinkles the nose
    recorded = clip.recorded()[:, forehead]
    assert _rms(np.linalg.norm(recorded - recorded.mean(axis=0), axis=2)) > 2.0


def test_rate_axes_and_unknown_labels(scene, registered, builtin_face):
    performer, truth, centres, rest = scene
    rng = np.random.default_rng(5)
    labels = performer.layout.labels

    def turned(x):  # z up
        return x[..., [2, 0, 1]]

    other = _markers(truth.times, (*labels[:-3], "x", "y", "z"), turned(centres), rng)
    clips = {"calm": _markers(np.arange(8) / 120.0, labels, turned(rest), rng), "rage": other}
    settings = RegistrationSettings(neutral="calm:3", up=None, frames_per_second=5.0)
    found = register_performer(clips, builtin_face, settings=settings).data
    assert found.statistics["up"] == "z" and found.statistics["neutral"] == "calm:3"
    notes = found.statistics["clips"]["rage"]
    assert notes["labels_missing"] == list(labels[-3:]) and notes["labels_unknown"] == ["x", "y", "z"]
    assert 9 <= found.clip("rage").n_frames <= 11
    same = registered[0].data
    assert _rms(np.linalg.norm(found.neutral - same.neutral, axis=1)) < 1.0


def test_a_single_frame_and_frames_without_markers(scene, builtin_face):
    performer, truth, centres, rest = scene
    labels = performer.layout.labels
    rng = np.random.default_rng(6)
    one = register_performer({"only": _markers(np.zeros(1), labels, rest[:1], rng)}, builtin_face).data
    assert one.clip("only").n_frames == 1
    assert np.abs(one.clip("only").vertices[0] - one.neutral).max() < 1.0
    seen = np.ones(centres.shape[:2], bool)
    seen[4:6] = False
    clips = {
        "rest": _markers(np.arange(8.0), labels, rest, rng),
        "a": _markers(truth.times, labels, centres, rng, seen),
    }
    found = register_performer(clips, builtin_face).data
    assert found.statistics["clips"]["a"]["frames_left_out"] == 2 and found.clip("a").n_frames == 38


def test_refusals(scene, builtin_face):
    performer, truth, centres, rest = scene
    labels = performer.layout.labels
    rng = np.random.default_rng(7)
    good = _markers(np.arange(8.0), labels, rest, rng)
    with pytest.raises(ValueRangeError, match="at least one clip"):
        register_performer({}, builtin_face)
    for neutral in ("none:0", "a:99", "a:-1", "none"):
        with pytest.raises(ValueRangeError, match="neutral must"):
            register_performer({"a": good}, builtin_face, settings=RegistrationSettings(neutral=neutral))
    stranger = MarkerData(truth.times, tuple(f"other{k}" for k in range(len(labels))), centres)
    with pytest.raises(ValueRangeError, match=r"clip b must show at least half"):
        register_performer({"rest": good, "b": stranger}, builtin_face)
    with pytest.raises(DegenerateError, match="at least 20 markers"):
        register_performer({"a": MarkerData(good.times, labels[:9], good.positions[:, :9])}, builtin_face)
    with pytest.raises(DegenerateError, match=r"face"):
        register_performer({"a": MarkerData(good.times, labels, 10.0 * good.positions)}, builtin_face)
    cloud = rng.normal(0.0, 60.0, (len(labels), 3))
    with pytest.raises(DegenerateError, match="on a face"):
        place_markers(marker_template(builtin_face), cloud)
    for settings in ({"standoff_mm": -1.0}, {"gap_limit_s": -0.1}, {"frames_per_second": 0.0}):
        with pytest.raises(ValueRangeError):
            RegistrationSettings(**settings)


def _exchanged(positions, share, rng):
    """That share of the markers bear the label of another one, in a ring."""
    M = positions.shape[1]
    chosen, order = rng.permutation(M)[: round(share * M)], np.arange(M)
    order[chosen] = np.roll(chosen, 1)
    return positions[:, order], chosen


@pytest.mark.parametrize("share", [0.1, 0.4, 1.0])
def test_a_clip_under_other_labels_is_refused(scene, builtin_face, share):
    performer, truth, centres, rest = scene
    rng = np.random.default_rng(8)
    labels = performer.layout.labels
    wrong, _ = _exchanged(centres, share, rng)
    clips = {
        "rest": _markers(np.arange(8.0), labels, rest, rng),
        "good": _markers(truth.times, labels, centres, rng),
        "bad": _markers(truth.times, labels, wrong, rng),
    }
    with pytest.raises(ValueRangeError, match=r"clip bad must .* mm, in 40 of 40 frames .* or leave it out\."):
        register_performer(clips, builtin_face)


def test_a_few_wrong_labels_and_a_few_wrong_frames_are_left_out(scene, registered, builtin_face):
    performer, truth, centres, rest = scene
    rng = np.random.default_rng(9)
    labels = performer.layout.labels
    wrong, chosen = _exchanged(centres, 0.04, rng)
    torn = centres.copy()
    torn[7:10], _ = _exchanged(centres[7:10], 0.5, rng)
    clips = {
        "rest": _markers(np.arange(8.0), labels, rest, rng),
        "rage": _markers(truth.times, labels, wrong, rng),
        "torn": _markers(truth.times, labels, torn, rng),
    }
    found = register_performer(clips, builtin_face).data
    notes = found.statistics["clips"]
    names = {labels[k] for k in chosen}
    assert set(notes["rage"]["labels_out_of_place"]) <= names
    assert len(notes["rage"]["labels_out_of_place"]) >= 0.8 * len(names) and notes["rage"]["frames_implausible"] == 0
    good = registered[0].data.clip("rage").vertices
    assert _rms(np.linalg.norm(found.clip("rage").vertices - good, axis=2)) < 0.7
    assert notes["torn"]["frames_implausible"] == 3 and notes["torn"]["labels_out_of_place"] == []
    kept = np.r_[0:7, 10:40]
    assert np.array_equal(found.clip("torn").times, truth.times[kept])
    assert _rms(np.linalg.norm(found.clip("torn").vertices - good[kept], axis=2)) < 0.7
    assert not any(note["frames_implausible"] for note in registered[0].data.statistics["clips"].values())


def test_up_is_found(scene, builtin_face):
    assert find_up(marker_template(builtin_face), scene[3][0]) == "y"  # z above


def test_a_swap_at_rest_is_told_from_swaps_in_clips():
    swapped = np.tile([1, 0, 2, 3], (9, 1))  # all frames against the one at rest
    swapped[2, 2] = -1
    swapped[4:6, 2:] = [3, 2]
    assert _usual_labels([swapped[:4], swapped[4:]]).tolist() == [1, 0, 2, 3]
