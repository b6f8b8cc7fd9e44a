from dataclasses import replace

import numpy as np
import pytest

from facewright.evaluation import regions_generalisation
from facewright.evaluation.regions_behaviour import measure_boundaries, measure_dragged_boundaries, measure_locality
from facewright.evaluation.regions_clusters import measure_segmentation
from facewright.evaluation.regions_generalisation import (
    first_components,
    measure_generalisation,
    measure_unseen_segmentation,
    unseen_rms,
)
from facewright.evaluation.regions_session import RegisteredSession, RegistrationErrors
from facewright.evaluation.regions_speed import DenseSystem, measure_speed
from facewright.faces.coarse_face import coarse_face
from facewright.models.performer_data import PerformerClip, PerformerData
from facewright.models.region_boundaries import share_boundaries
from facewright.models.region_pca import fit_region_pca
from facewright.models.region_poser import RegionPoser
from facewright.models.regions import Regions


@pytest.fixture(scope="module")
def coarse(builtin_face):
    return coarse_face(builtin_face, 397)


@pytest.fixture(scope="module")
def quarters(coarse):
    """Left and right, upper and lower face, with shared boundaries."""
    x, y = coarse.positions[:, 0], coarse.positions[:, 1]
    return share_boundaries(2 * (y < 0) + (x < 0), coarse.faces)


def acted(builtin_face, coarse, rng, n, *, together=False, amplitude=1.0):
    """Frames (n, N, 3) of random blendshape weights; `together` moves both sides alike."""
    weights = np.clip(rng.normal(0, 0.4, (n, 46)), 0, 1) * amplitude
    if together:
        from facewright.faces.blendshape_names import mirror_order

        weights = np.maximum(weights, weights[:, mirror_order()])
    deltas = builtin_face.blendshape_deltas[:, coarse.vertex_ids].astype(float)
    return np.einsum("tk,knc->tnc", weights, deltas) + 0.02 * rng.normal(size=(n, len(coarse.vertex_ids), 3))


@pytest.fixture(scope="module")
def model(builtin_face, coarse, quarters):
    moves = acted(builtin_face, coarse, np.random.default_rng(0), 150)
    provenance = {"template": "builtin", "vertex_ids": coarse.vertex_ids.tolist()}
    return fit_region_pca(moves, coarse.faces, coarse.positions.astype(float), quarters, 8, provenance=provenance)


@pytest.fixture(scope="module")
def session(builtin_face, coarse):
    """Four performers of one clip to train with and one to test with."""
    performers = []
    for k, name in enumerate(("M1", "F1", "M2", "F2")):
        rng = np.random.default_rng(k)
        shift = acted(builtin_face, coarse, rng, 1)[0]
        neutral = (coarse.positions + 0.3 * shift).astype(np.float32)
        clips = []
        for clip, n in (("pride_01", 60), ("pride_05", 25)):
            # one's own amplitudes, so that a performer is not another
            own = rng.uniform(0.6, 1.3, 46)
            moves = acted(builtin_face, coarse, rng, n, amplitude=own)
            still = np.repeat(np.eye(3)[None], n, axis=0)
            clips.append(
                PerformerClip(clip, np.arange(n) / 15, (neutral + moves).astype(np.float32), still, np.zeros((n, 3)))
            )
        performers.append(
            PerformerData(name, coarse.faces, neutral, coarse.positions, tuple(clips), "builtin", coarse.vertex_ids)
        )
    return RegisteredSession(tuple(performers), ("pride_01",), ("pride_05",), RegistrationErrors(), 1.0, 340, False)


def test_the_dense_twin_and_the_fast_way_agree(model, rng):
    poser, twin = RegionPoser(model, 0.5, 0.025), DenseSystem(model)
    for count in (1, 3, 6):
        ids = rng.permutation(model.n_vertices)[:count]
        rest = rng.normal(size=model.n_coefficients)
        targets = model.neutral[ids] + rng.normal(0, 3, (count, 3))
        poser.set_constraints(ids)
        fast = poser.positions(poser.solve(targets, rest))
        assert np.abs(fast - twin.solve(ids, targets, rest)).max() < 1e-6


def test_speed_is_measured_beside_the_dense_system(model, builtin_face):
    speed = measure_speed(model, builtin_face, np.array([10, 100, 200, 300]))
    names = {"drag_us_397", "grab_us_397", "dense_solve_us_397", "dense_us_397", "drag_us_6216", "dense_us_6216"}
    assert set(speed) == names | {"weights_ms"}
    assert all(value > 0 for value in speed.values())
    assert speed["drag_us_397"] < speed["grab_us_397"] and speed["dense_solve_us_397"] < speed["dense_us_6216"]
    assert speed["drag_us_397"] < speed["dense_us_397"] and speed["drag_us_6216"] < speed["dense_us_6216"]


def test_fewer_components_are_the_model_trained_with_fewer(model, builtin_face, coarse, quarters):
    moves = acted(builtin_face, coarse, np.random.default_rng(0), 150)
    fewer = fit_region_pca(moves, coarse.faces, coarse.positions.astype(float), quarters, 3)
    cut = first_components(model, 3)
    assert all(np.allclose(a, b) for a, b in zip(fewer.bases, cut.bases))
    assert cut.coefficient_names == fewer.coefficient_names and cut.n_coefficients == 12


def test_the_error_of_a_holistic_model_is_that_of_projection(builtin_face, coarse, rng):
    train, test = (acted(builtin_face, coarse, rng, n) for n in (100, 30))
    whole = fit_region_pca(train, coarse.faces, coarse.positions.astype(float), Regions.holistic(397), 12)
    basis = whole.bases[0].reshape(12, -1)
    flat = test.reshape(30, -1)
    missing = flat - flat @ basis.T @ basis
    assert unseen_rms(whole, test) == pytest.approx(np.sqrt((missing**2).sum() / (30 * 397)), rel=1e-6)


def test_generalisation_has_every_cell(session, quarters, monkeypatch):
    steps = []
    monkeypatch.setattr(regions_generalisation, "_sparse", lambda moves, tests, total, suffix: {suffix: len(tests)})
    metrics = measure_generalisation(session, quarters, lambda *step: steps.append(step))
    assert 0 <= metrics["region_below"] <= 1
    assert metrics["region_rms_mm"] == metrics["region_rms_mm_all_10"] < metrics["holistic_rms_mm"]
    for kind in ("region", "holistic"):
        for label in ("m1", "m1_f1", "m1_f1_m2", "all"):
            falling = [metrics[f"{kind}_rms_mm_{label}_{p}"] for p in (1, 5, 10, 15)]
            assert falling == sorted(falling, reverse=True)
        assert metrics[f"{kind}_rms_mm_unseen_m1"] > 0
    # as many in all: 4 regions of 3 against 12
    assert {"region_rms_mm_all_total_12", "holistic_rms_mm_all_total_12", "all_total_12", "m1_total_12"} <= set(metrics)
    assert {"holistic_rms_mm_all_thinned_total_12", "holistic_rms_mm_m1_thinned_total_12"} <= set(metrics)
    assert len(steps) == 4 * 2 * 15


def test_sparse_components_are_sparse_and_no_better_than_as_many_of_pca(session):
    data = session.performers[0]
    train, test = data.displacements("pride_01"), data.displacements("pride_05")
    found = regions_generalisation._sparse(train, [test], 8, "here")
    whole = fit_region_pca(train, data.faces, data.neutral, Regions.holistic(397), 8, centred=True)
    assert 0.2 < found["sparse_zeros_here"] < 1.0
    still = np.sqrt((test.astype(float) ** 2).sum(axis=2).mean())
    assert 0.9 * unseen_rms(whole, test) < found["sparse_rms_mm_here"] < still


def test_sparse_components_reconstruct_about_the_mean_of_what_they_saw(session):
    data = session.performers[0]
    train, test = data.displacements("pride_01"), data.displacements("pride_05")
    away = np.array([0.0, 40.0, 0.0], np.float32)  # a mean far from the neutral changes nothing
    here, there = (
        regions_generalisation._sparse(train + offset, [test + offset], 8, "here")["sparse_rms_mm_here"]
        for offset in (0.0 * away, away)
    )
    assert there == pytest.approx(here, rel=0.02)


def test_regions_of_a_segmentation_without_the_test_sentences_do_not_depend_on_them(session):
    first = session.performers[0]
    wild = replace(first.clip("pride_05"), vertices=first.clip("pride_05").vertices[::-1] * np.float32(1.3))
    other = replace(first, clips=(first.clip("pride_01"), wild))
    changed = replace(session, performers=(other, *session.performers[1:]))
    found, again = (measure_unseen_segmentation(each, 0, 5) for each in (session, changed))
    assert found["regions_k_unseen"] == again["regions_k_unseen"] >= 2
    for name in ("region_rms_mm_m1_10_unseen_segmentation", "region_rms_mm_m1_10_unseen_segmentation_at_k"):
        assert 0 < found[name] < again[name]


def test_regions_keep_a_drag_on_its_side_where_the_data_move_both(builtin_face, coarse, quarters, rng):
    moves = acted(builtin_face, coarse, rng, 200, together=True)
    neutral = coarse.positions.astype(float)
    by_region = fit_region_pca(moves, coarse.faces, neutral, quarters, 8)
    whole = fit_region_pca(moves, coarse.faces, neutral, Regions.holistic(397), 8)
    corners = tuple(
        int(
            np.linalg.norm(
                neutral - builtin_face.mean_shape[builtin_face.topology.landmarks["ibug68"][k]], axis=1
            ).argmin()
        )
        for k in (54, 48)
    )
    metrics = measure_locality({"region": by_region, "holistic": whole}, coarse.positions, np.array(corners))
    assert 0.3 < metrics["holistic_leak"] < 0.7 and metrics["region_leak"] < 0.75 * metrics["holistic_leak"]
    assert metrics["region_elsewhere"] < metrics["holistic_elsewhere"]
    assert 0 < metrics["region_missed_mm"] < 5 and 0 < metrics["holistic_missed_mm"] < 5


def test_gaps_shrink_with_beta_and_creases_are_those_of_the_error(model, builtin_face, coarse, rng):
    train = acted(builtin_face, coarse, np.random.default_rng(0), 150)
    whole = fit_region_pca(train, coarse.faces, coarse.positions.astype(float), Regions.holistic(397), 100)
    test = acted(builtin_face, coarse, rng, 20)
    metrics = measure_boundaries(model, whole, test)
    gaps = [metrics[f"gap_mean_mm_beta_{beta}"] for beta in ("0", "0.1", "0.5", "1", "2", "5", "10")]
    assert gaps == sorted(gaps, reverse=True) and gaps[-1] < 0.6 * gaps[0]
    assert all(metrics[f"gap_max_mm_beta_{b}"] >= metrics[f"gap_mean_mm_beta_{b}"] for b in ("0", "0.5", "10"))
    assert metrics["crease_ratio"] == pytest.approx(metrics["crease_deg"] / metrics["crease_deg_holistic"])
    assert 0 < metrics["crease_deg"] < metrics["crease_deg_still"]
    count = int(metrics["crease_components"])  # the fewest that are as good
    error, goal = unseen_rms(first_components(whole, count), test), unseen_rms(model, test)
    assert error <= goal + 1e-9 < unseen_rms(first_components(whole, count - 1), test)


def test_drags_bend_boundaries_and_the_holistic_model_is_held_against_the_same_edges(model, builtin_face, coarse):
    train = acted(builtin_face, coarse, np.random.default_rng(0), 150)
    whole = fit_region_pca(train, coarse.faces, coarse.positions.astype(float), Regions.holistic(397), 30)
    dragged = np.array([10, 100]), np.array([200, 300])
    metrics = measure_dragged_boundaries(model, whole, coarse.positions, *dragged)
    assert 0 < metrics["gap_mean_mm_dragged"] < metrics["gap_max_mm_dragged"] < 5
    for suffix in ("", "_gradient", "_holistic"):
        assert 0 < metrics[f"crease_deg_dragged{suffix}"] < metrics[f"crease_max_deg_dragged{suffix}"] < 180
    contrast = metrics["crease_contrast_dragged"] / metrics["crease_contrast_dragged_holistic"]
    assert metrics["crease_ratio_dragged"] == pytest.approx(contrast)
    # spreading the gap bends the boundary less than leaving the step one triangle wide
    assert metrics["crease_contrast_dragged_gradient"] < metrics["crease_contrast_dragged"]
    same = measure_dragged_boundaries(model, model, coarse.positions, *dragged)
    assert same["crease_ratio_dragged"] == pytest.approx(1)


def test_a_model_that_explains_everything_has_neither_gaps_nor_creases(builtin_face, coarse, quarters, rng):
    deltas = builtin_face.blendshape_deltas[:3, coarse.vertex_ids].astype(float)
    moves = np.einsum("tk,knc->tnc", rng.uniform(0, 1, (40, 3)), deltas)
    exact, whole = (
        fit_region_pca(moves, coarse.faces, coarse.positions.astype(float), parts, 3)
        for parts in (quarters, Regions.holistic(397))
    )
    metrics = measure_boundaries(exact, whole, moves[:5])
    assert metrics["gap_max_mm_beta_0.5"] < 1e-6 and metrics["crease_deg"] < 1e-4 < metrics["crease_deg_still"]


def test_errors_are_root_mean_squares():
    errors = RegistrationErrors([np.array([1.0, 9.0])], [np.array([4.0])], [np.zeros(3), np.full(1, 4.0)], [np.ones(2)])
    metrics = errors.metrics()
    assert metrics["registration_surface_rms_mm"] == pytest.approx(np.sqrt(5))
    assert metrics["registration_place_rms_mm"] == 2 and metrics["registration_motion_rms_mm"] == 1


def grid_performer(rng, *, noisy=()):
    """A flat grid of four blocks that move on their own; `noisy` vertices move with nobody."""
    n = 12
    xy = np.stack(np.meshgrid(np.arange(n), np.arange(n)), axis=-1).reshape(-1, 2).astype(float)
    a = np.arange(n * n).reshape(n, n)
    quads = np.stack([a[:-1, :-1], a[:-1, 1:], a[1:, 1:], a[1:, :-1]], axis=-1).reshape(-1, 4)
    faces = np.concatenate([quads[:, [0, 1, 2]], quads[:, [0, 2, 3]]]).astype(np.int32)
    rest = np.concatenate([8.0 * (xy - 5.5), np.zeros((n * n, 1))], axis=1).astype(np.float32)
    block = (xy[:, 0] > 5.5) * 2 + (xy[:, 1] > 5.5)
    moves = rng.normal(size=(200, 4, 3))[:, block.astype(int)] + 0.05 * rng.normal(size=(200, n * n, 3))
    moves[:, list(noisy)] = rng.normal(size=(200, len(noisy), 3))
    still = np.repeat(np.eye(3)[None], 200, axis=0)
    clip = PerformerClip("a", np.arange(200) / 15, (rest + moves).astype(np.float32), still, np.zeros((200, 3)))
    return PerformerData("M1", faces, rest, rest, (clip,), "grid", np.arange(n * n, dtype=np.int32))


def test_segmentation_by_both_and_by_each_alone(rng):
    found = measure_segmentation(grid_performer(rng), 0)
    assert found.metrics["regions_k"] >= 4 and len(found.result.regions.members) == found.metrics["regions_k"]
    assert found.metrics["in_one_piece"] == 1 and found.metrics["threshold_correlation"] == 0.7
    assert found.metrics["segmentation_s"] > 0
    for name in ("correlation", "distance"):
        assert {f"regions_k_{name}", f"symmetry_{name}", f"in_one_piece_{name}_at_k", f"loose_{name}_at_k"} <= set(
            found.metrics
        )


def test_correlation_alone_takes_a_lower_threshold_where_a_vertex_is_left_over(rng):
    found = measure_segmentation(grid_performer(rng, noisy=(70,)), 0)
    assert found.metrics["threshold_correlation"] < 0.7
