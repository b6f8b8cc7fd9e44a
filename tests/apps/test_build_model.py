"""Building and looking at models: the file holds what was asked for, and modes are ordered by what they move."""

import numpy as np
import pytest

from facewright.apps.build_model import BuildModelRequest, build_model
from facewright.apps.explore_model import ExploreRequest, explore_model, principal_axes
from facewright.apps.paint_person import face_of_model
from facewright.errors import MissingFaceError, StoreError, ValueRangeError
from facewright.io.image import read_image
from facewright.models.bilinear_store import load_bilinear


@pytest.fixture(scope="module")
def built(tmp_path_factory):
    steps = []
    request = BuildModelRequest(
        tmp_path_factory.mktemp("model") / "m.fwbm", n_people=5, n_identity=4, n_expression=8, seed=3, n_unseen=1
    )
    return build_model(request, lambda *step: steps.append(step)), steps


def test_the_file_holds_the_model(built):
    result, steps = built
    model = load_bilinear(result.path)
    assert (model.n_identity, model.n_expression, len(model.identity_weights)) == (4, 8, 5)
    assert model.expression_names == result.model.expression_names and len(model.expression_names) == 47
    assert model.topology.fingerprint == result.model.topology.fingerprint
    assert {k: model.provenance[k] for k in ("face", "seed", "n_people")} == {
        "face": "builtin",
        "seed": 3,
        "n_people": 5,
    }
    assert result.n_bytes == result.path.stat().st_size
    assert 0 < result.unseen_rms_mm < 10
    assert {"simulating people", "checking on unseen people"} <= {stage for stage, _, _ in steps}
    assert [p.name for p in result.path.parent.iterdir()] == ["m.fwbm"]  # nothing else is left behind


def test_the_same_seed_gives_the_same_model(built, tmp_path, monkeypatch):
    """Also where the people lie in a file because memory is short."""
    result, _ = built
    monkeypatch.setattr("facewright.apps.build_model.MEMORY_LIMIT_MB", 0.0)
    request = BuildModelRequest(tmp_path / "m.fwbm", n_people=5, n_identity=4, n_expression=8, seed=3, n_unseen=0)
    again = build_model(request)
    assert again.unseen_rms_mm is None
    np.testing.assert_allclose(again.model.mean_face, result.model.mean_face, atol=5e-3)  # mm, float32 sums
    assert [p.name for p in tmp_path.iterdir()] == ["m.fwbm"]


def test_the_models_own_face_is_found_again(built):
    face = face_of_model(built[0].model)
    assert face is not None and face.topology.fingerprint == built[0].model.topology.fingerprint


@pytest.mark.parametrize(("side", "rows"), [("identity", 2), ("expression", 2), ("both", 4)])
def test_explore_draws_a_row_for_each_mode(built, tmp_path, side, rows):
    request = ExploreRequest(built[0].model, tmp_path / "m.png", n_modes=2, sigmas=(-2, 2), side=side, size=(48, 40))
    explore_model(request)
    sheet = read_image(tmp_path / "m.png")
    assert sheet.shape == (rows * (48 + 6 + 22) + 6, 2 * (40 + 6) + 6, 3)
    left, right = sheet[6:54, 6:46].astype(int), sheet[6:54, 52:92].astype(int)
    assert np.abs(left - right).max() > 20  # the columns differ


def test_principal_axes_span_the_covariance_and_are_ordered(rng):
    root = rng.normal(size=(5, 5))
    directions = rng.normal(size=(5, 30, 3)) * np.array([1, 9, 2, 7, 3])[:, None, None]
    axes = principal_axes(root @ root.T, directions)
    np.testing.assert_allclose(axes.T @ axes, root @ root.T, atol=1e-9)
    moves = np.tensordot(axes, directions, 1).reshape(5, -1)
    gram = moves @ moves.T
    np.testing.assert_allclose(gram, np.diag(np.diag(gram)), atol=1e-6 * gram.max())
    assert (np.diff(np.diag(gram)) <= 0).all()


@pytest.mark.parametrize(
    "wrong",
    [{"n_people": 1}, {"n_identity": 0}, {"n_identity": 151}, {"n_expression": 48}, {"seed": -1}, {"n_unseen": -1}],
)
def test_sizes_out_of_range_are_refused(tmp_path, wrong):
    with pytest.raises(ValueRangeError, match=next(iter(wrong))):
        BuildModelRequest(tmp_path / "m.fwbm", **wrong)


def test_what_cannot_work_is_refused_before_the_work(tmp_path, built):
    with pytest.raises(StoreError, match="does not exist"):
        build_model(BuildModelRequest(tmp_path / "none" / "m.fwbm"))
    with pytest.raises(MissingFaceError):
        build_model(BuildModelRequest(tmp_path / "m.fwbm", face="nobody"))
    for wrong in ({"side": "up"}, {"n_modes": 0}, {"sigmas": ()}, {"sigmas": (np.nan,)}):
        with pytest.raises(ValueRangeError):
            ExploreRequest(built[0].model, tmp_path / "m.png", **wrong)
