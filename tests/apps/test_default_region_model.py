import numpy as np
import pytest

from facewright.apps import default_region_model as module
from facewright.apps.dense_character import DenseCharacter
from facewright.apps.pose_session import PoseSession
from facewright.errors import StoreError
from facewright.models.performer_data import PerformerClip, PerformerData
from facewright.models.region_store import region_fingerprint


@pytest.fixture
def short_performance(builtin_face, monkeypatch):
    """In place of a hundred clips: a few expressions on 150 vertices."""
    from facewright.faces.performance_region import performance_region
    from facewright.mesh.uniform_subsample import subsample_mesh

    skin = builtin_face.skin()
    sub = subsample_mesh(
        skin.mean_shape, skin.topology.faces, 150, within=performance_region(builtin_face), mirror=skin.topology.mirror
    )
    rng = np.random.default_rng(2)
    weights = np.clip(rng.normal(0, 0.4, (120, len(skin.blendshape_names))), 0, 1)
    neutral = skin.mean_shape[sub.vertex_ids]
    moves = np.einsum("tb,bnc->tnc", weights, skin.blendshape_deltas[:, sub.vertex_ids])
    times = np.arange(120) / 15.0
    still = np.tile(np.eye(3), (120, 1, 1)), np.zeros((120, 3))
    clip = PerformerClip("clip", times, (neutral + moves).astype(np.float32), *still)
    data = PerformerData("M1", sub.faces, neutral, neutral, (clip,), "builtin", sub.vertex_ids)
    calls = []

    def performed(face, progress):
        calls.append(face.name)
        return data

    monkeypatch.setattr(module, "_performed", performed)
    return calls


def test_built_once_kept_and_built_again_where_damaged(short_performance, monkeypatch, tmp_path, builtin_face):
    monkeypatch.setenv("FACEWRIGHT_HOME", str(tmp_path))
    models = module.default_region_models()
    assert short_performance == ["builtin"] and len(models.region.regions.names) > 1
    assert len(models.holistic.regions.names) == 1
    again = module.default_region_models()
    assert short_performance == ["builtin"]
    assert region_fingerprint(again.region) == region_fingerprint(models.region)
    module.default_region_model_paths()[1].write_bytes(b"damaged")
    module.default_region_models()
    assert len(short_performance) == 2

    # it drives the face: a pulled point comes nearer to where it is pulled, the ears stay
    session = PoseSession(models.region, holistic=models.holistic, gamma=0.001)
    character = DenseCharacter(builtin_face, session.models)
    v = int(np.argmin(np.linalg.norm(models.region.neutral - [28, -36, 100], axis=1)))
    goal = character.neutral[character.handles[v]] + [0, 4, 0]
    session.drag(v, character.to_model(v, goal))
    posed = np.empty_like(character.neutral)
    character.pose("region", session.coefficients(), posed)
    assert np.linalg.norm(posed[character.handles[v]] - goal) < 2.0
    ears = character.topology.masks["ears"]
    assert np.linalg.norm(posed - character.neutral, axis=1)[ears].max() < 0.5
    np.testing.assert_allclose(character.from_model(v, character.to_model(v, goal)), goal, atol=1e-6)


def test_a_folder_that_cannot_be_is_told(short_performance, monkeypatch, tmp_path):
    (tmp_path / "file").write_text("")
    monkeypatch.setenv("FACEWRIGHT_HOME", str(tmp_path / "file"))
    with pytest.raises(StoreError, match="FACEWRIGHT_HOME"):
        module.default_region_models()


@pytest.mark.slow
def test_the_real_performance_gives_compact_regions(monkeypatch, tmp_path):
    monkeypatch.setenv("FACEWRIGHT_HOME", str(tmp_path))
    models = module.default_region_models()
    assert models.region.n_vertices == 397 and 5 <= len(models.region.regions.names) <= 25
    assert models.holistic.n_coefficients < models.region.n_coefficients
