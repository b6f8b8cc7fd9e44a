import numpy as np
import pytest

from facewright.errors import MissingExtraError, ValueRangeError
from facewright.evaluation import edit as suite
from facewright.evaluation import edit_attributes
from facewright.evaluation.edit import IDENTITIES, run
from facewright.evaluation.edit_attributes import attribute_metrics
from facewright.faces.attribute_editor import AttributeEditor
from facewright.faces.simulate import simulate_neutrals
from facewright.models.bilinear import fit_bilinear


def models_of(face, counts, people=60):
    """Models of some people who share the generic face's expressions: the identities are what matters here."""
    skin = face.skin()
    neutrals = simulate_neutrals(skin, people, np.random.default_rng(9))
    shapes = np.concatenate([np.zeros_like(skin.blendshape_deltas[:1]), skin.blendshape_deltas])
    return [
        fit_bilinear(
            neutrals[:n, None] + shapes,
            min(40, n),
            12,
            topology=skin.topology,
            expression_names=("neutral", *skin.blendshape_names),
            provenance={"face": "builtin"},
        )
        for n in counts
    ]


def test_attributes_of_unseen_people(builtin_face, monkeypatch):
    monkeypatch.setattr(edit_attributes, "N_UNSEEN", 8)
    (model,) = models_of(builtin_face, [60])
    editor = AttributeEditor.of_model(model)
    metrics = attribute_metrics(builtin_face, model, editor, seed=3)
    assert {f"r2_{name.replace(' ', '_')}" for name in editor.names} <= set(metrics)
    assert metrics["r2_worst"] == min(metrics[f"r2_{name.replace(' ', '_')}"] for name in editor.names) > 0.4
    assert metrics["r2_face_length"] > 0.8
    assert metrics["obtained"] > 0.97 > metrics["eq12_obtained"]  # asked for is obtained; eq. (12) misses some
    assert metrics["leakage"] < 0.12 and metrics["leakage_worst"] < 0.6


@pytest.mark.slow
def test_the_suite_runs_without_a_detector(builtin_face, monkeypatch):
    def absent():
        raise MissingExtraError("no detector")

    monkeypatch.setattr(suite, "open_detector", absent)
    models = models_of(builtin_face, [15, 20, 30, 40, 60])
    stages = []
    metrics = run(builtin_face, 1, lambda *args: stages.append(args), subjects=1, models=models)
    assert ("editing photos", 1, 1) in stages
    assert metrics["psnr_db"] > metrics["unchanged_psnr_db"]
    assert metrics["ssim"] > metrics["unchanged_ssim"]
    assert metrics["tps_psnr_db"] > metrics["unchanged_psnr_db"]
    assert metrics["smallest_jacobian"] > 0
    assert {f"psnr_db_{n}_identities" for n in IDENTITIES} <= set(metrics)
    assert "landmarks_iod" not in metrics
    assert all(np.isfinite(value) for value in metrics.values())


def test_every_attribute_but_two_has_its_turn():
    requests = {name for k in range(4) for name, _ in suite._requests(k)}
    assert len(requests) == 2 + len(suite._IN_TURN)


def test_refuses(builtin_face):
    with pytest.raises(ValueRangeError, match="subjects must be at least 1, got 0"):
        run(builtin_face, 0, subjects=0)
    with pytest.raises(ValueRangeError, match="models must be 5"):
        run(builtin_face, 0, subjects=1, models=models_of(builtin_face, [15]))
