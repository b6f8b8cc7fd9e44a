import numpy as np
import pytest

from facewright.errors import ValueRangeError
from facewright.evaluation import bilinear
from facewright.evaluation.bilinear import TEN_EXPRESSIONS, run
from facewright.faces.blendshape_names import BLENDSHAPE_NAMES


def test_ten_expressions_are_known():
    assert len(set(TEN_EXPRESSIONS)) == 10
    assert set(TEN_EXPRESSIONS) <= {"neutral", *BLENDSHAPE_NAMES}


class CheapPerson:
    """Like a simulated person, without deformation transfer: for testing the suite, not the model."""

    def __init__(self, face, rng):
        modes = rng.standard_normal(len(face.identity_basis))
        self.neutral = (face.mean_shape + np.tensordot(modes, face.identity_basis, 1)).astype(np.float32)
        amplitudes = rng.uniform(0.7, 1.2, size=(len(face.blendshape_deltas), 1, 1))
        self.deltas = (amplitudes * face.blendshape_deltas).astype(np.float32)

    def pose(self, weights):
        return self.neutral + np.tensordot(weights, self.deltas, 1).astype(np.float32)


def cheap_population(face, n, rng, progress=None):
    people = [CheapPerson(face, rng) for _ in range(n)]
    return np.array([np.r_[p.neutral[None], p.neutral + p.deltas] for p in people])


@pytest.fixture(scope="module")
def metrics(builtin_face, tmp_path_factory):
    cache = tmp_path_factory.mktemp("cache")
    stages = []
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(bilinear, "simulate_population", cheap_population)
        patch.setattr(bilinear, "simulate_person", CheapPerson)
        result = run(
            builtin_face,
            3,
            lambda *call: stages.append(call),
            subjects=16,
            unseen_people=2,
            expressions_each=2,
            components=((4, 3), (12, 20), (999, 3)),
            with_tensorly=False,
            repeats=1,
            cache=cache,
        )
    assert all(0 <= done <= total for _, done, total in stages)
    assert len(list(cache.iterdir())) == 1
    return result


@pytest.mark.slow
def test_suite_on_simulated_people(builtin_face):
    metrics = run(builtin_face, 0, subjects=20, unseen_people=3, components=(), with_tensorly=False, repeats=1)
    assert metrics["fit_rms_mm_20x47"] < 0.6 * metrics["mean_face_rms_mm"]
    assert metrics["fit_rms_mm_20x47"] < metrics["fit_rms_mm_15x10"]


def test_suite_reports_what_the_issue_asks_for(metrics):
    expected = {
        "nmode_seconds",
        "gram_seconds",
        "ratio_to_limit",
        "extra_peak_mb",
        "peak_mb",
        "mean_face_rms_mm",
        "neutral_pca_rms_mm",
        "fit_rms_mm_c4x3",
        "fit_rms_mm_c12x20",
        "fit_rms_mm_15x10",
        "fit_rms_mm_15x47",
        "fit_rms_mm_16x10",
        "fit_rms_mm_16x47",
        "stored_max_error_mm",
        "load_ms",
    }
    assert expected <= metrics.keys()
    assert "fit_rms_mm_c999x3" not in metrics
    assert not {"fit_rms_mm", "fit_rms_mm_per_coordinate"} & metrics.keys()  # these are of 150 people
    assert "tensorly_seconds" not in metrics
    assert all(isinstance(value, float) and np.isfinite(value) for value in metrics.values())


def test_more_data_and_components_fit_better(metrics):
    assert metrics["fit_rms_mm_16x47"] < metrics["fit_rms_mm_c12x20"] < metrics["fit_rms_mm_c4x3"]
    assert metrics["fit_rms_mm_16x47"] < metrics["fit_rms_mm_16x10"]
    assert metrics["fit_rms_mm_16x47"] < 0.7 * metrics["mean_face_rms_mm"]
    assert metrics["stored_max_error_mm"] <= 0.05


def test_the_headline_has_its_name_where_the_run_is_the_one(builtin_face, monkeypatch):
    monkeypatch.setattr(bilinear, "simulate_population", cheap_population)
    monkeypatch.setattr(bilinear, "simulate_person", CheapPerson)
    monkeypatch.setattr(bilinear, "HEADLINE", (16, 25, 16, 47))
    monkeypatch.setattr(bilinear, "IDENTITIES", ())
    few = {"unseen_people": 1, "expressions_each": 1, "components": (), "with_tensorly": False, "repeats": 1}
    found = run(builtin_face, 3, subjects=16, **few)
    assert found["fit_rms_mm"] == found["fit_rms_mm_16x47"]
    assert found["fit_rms_mm_per_coordinate"] == pytest.approx(found["fit_rms_mm"] / 3**0.5)


def test_training_and_unseen_people_differ(builtin_face):
    face = builtin_face.skin()
    tensor = bilinear._training_tensor(face, 0, 2, None, None)
    neutrals, meshes = bilinear._unseen(face, 0, 1, 2, None)
    assert meshes.shape == (2, face.topology.n_vertices, 3)
    for neutral in neutrals:
        assert min(np.abs(neutral - other).max() for other in tensor[:, 0]) > 0.5


def test_guards(builtin_face):
    for bad in ({"subjects": 2}, {"unseen_people": 0}, {"expressions_each": 0}, {"repeats": 0}):
        with pytest.raises(ValueRangeError, match="at least"):
            run(builtin_face, 0, **bad)
