from dataclasses import replace

import numpy as np
import pytest

from facewright.errors import DegenerateError, ShapeError, ValueRangeError
from facewright.faces.attribute_editor import AttributeEditor, check_deviations
from facewright.faces.attributes import ATTRIBUTE_NAMES, measure_attributes
from facewright.faces.simulate import simulate_neutrals
from facewright.models.bilinear import fit_bilinear

PEOPLE = 60


@pytest.fixture(scope="module")
def skin(builtin_face):
    return builtin_face.skin()


@pytest.fixture(scope="module")
def model(skin):
    """Neutrals of 60 people and one more shape; labelled with an age that lengthens the nose."""
    rng = np.random.default_rng(3)
    neutrals = simulate_neutrals(skin, PEOPLE, rng)
    smile = skin.blendshape_deltas[skin.blendshape_names.index("mouthSmile_L")]
    tensor = np.stack([neutrals, neutrals + smile], axis=1)
    nose = measure_attributes(neutrals, skin.topology)[:, ATTRIBUTE_NAMES.index("nose length")]
    age = 40 + 10 * (nose - nose.mean()) / nose.std() + rng.normal(0, 3, PEOPLE)
    model = fit_bilinear(tensor, 40, 2, topology=skin.topology, expression_names=("neutral", "mouthSmile_L"))
    return replace(model, labels={"age": tuple(age.tolist())})


@pytest.fixture(scope="module")
def editor(model):
    return AttributeEditor.of_model(model)


def neutral(model, weights):
    return model.synthesise(weights, model.expression_weights[0])


@pytest.mark.parametrize("name", ATTRIBUTE_NAMES)
def test_what_is_asked_for_is_obtained_on_the_mesh(model, editor, name):
    w = model.identity_weights[4]
    edit = editor.change(w, {name: 1.5})
    row = ATTRIBUTE_NAMES.index(name)
    meshes = np.stack([neutral(model, w), neutral(model, edit.weights)])
    before, after = measure_attributes(meshes, model.topology)
    change = (after - before) / editor.standard_deviation
    assert change[row] == pytest.approx(1.5, abs=0.02)
    np.testing.assert_allclose(list(edit.change.values()), change, atol=0.01)
    others = np.abs(np.delete(change, row)) / 1.5
    # people correlate up to 0.83, and a face's length holds the nose's and the chin's
    assert others.max() < (0.6 if name == "face length" else 0.3) and others.mean() < 0.15
    assert edit.likelihood_distance < 7.0


def test_several_at_once_and_nothing(model, editor):
    w = model.identity_weights[0]
    edit = editor.change(w, {"face length": 1.0, "chin": 0.5, "mouth width": -1.0})
    assert edit.change["face length"] == pytest.approx(1.0, abs=0.02)
    assert edit.change["chin height"] == pytest.approx(0.5, abs=0.02)
    assert edit.change["mouth width"] == pytest.approx(-1.0, abs=0.02)
    np.testing.assert_array_equal(editor.change(w, {}).weights, w)
    assert np.abs(editor.change(w, {"jaw width": 0.0}).weights - w).max() < 1e-9


def test_equation_12_is_there_and_misses_more(model, editor):
    w = model.identity_weights[7]
    missed = {"least change": [], "regression": []}
    for form, misses in missed.items():
        for name in ATTRIBUTE_NAMES:
            misses.append(abs(editor.change(w, {name: 2.0}, form=form).change[name] - 2.0))
    assert max(missed["least change"]) < 0.02
    assert max(missed["regression"]) > 0.05
    np.testing.assert_allclose(
        editor.change(w, {"jaw width": 1.0}, form="regression").weights,
        w + editor.regression.change({"jaw width": 1.0}),
    )


def test_a_label_moves_what_goes_with_it(model, editor):
    w = model.identity_weights[2]
    assert editor.all_names[-1] == "age"
    assert editor.label_attributes[0].r_squared > 0.5
    edit = editor.change(w, {"age": 1.0})
    assert edit.change["nose length"] > 0.5
    both = editor.change(w, {"age": 1.0, "nose length": 0.0})
    assert both.change["nose length"] == pytest.approx(0.0, abs=0.02)


def test_a_model_without_people_draws_them(model, editor):
    private = AttributeEditor.of_model(replace(model, identity_weights=np.zeros((0, 40)), labels={}))
    assert private.n_people == 1000 and private.label_attributes == ()
    np.testing.assert_allclose(private.mean, editor.mean, atol=0.8)
    np.testing.assert_allclose(private.standard_deviation, editor.standard_deviation, rtol=0.15)


def test_a_face_s_own_basis(skin):
    editor = AttributeEditor.of_face(skin)
    edit = editor.change(np.zeros(len(skin.identity_basis)), {"nose width": 2.0})
    moved = skin.mean_shape + np.tensordot(edit.weights, skin.identity_basis, 1)
    row = ATTRIBUTE_NAMES.index("nose width")
    measured = measure_attributes(np.stack([skin.mean_shape, moved]), skin.topology)[:, row]
    assert (measured[1] - measured[0]) / editor.standard_deviation[row] == pytest.approx(2.0, abs=0.02)


def test_names_may_be_short():
    names = ("face length", "chin height", "nose length", "nose width", "age", "sex: female")
    assert check_deviations({"chin": 1, "Nose_Width": -2, "AGE": 0.5, "female": 1}, names) == {
        "chin height": 1.0,
        "nose width": -2.0,
        "age": 0.5,
        "sex: female": 1.0,
    }


@pytest.mark.parametrize(
    ("request_", "message"),
    [
        ({"mouth widht": 1}, "did you mean 'mouth width'"),
        ({"length": 1}, "did you mean '(face|nose) length' or '(face|nose) length'"),
        ({"smile": 1}, "attribute 'smile' is unknown: there are face length"),
        ({"nose": 1}, "named in full: nose length, nose width, nose height"),
        ({"jaw width": 4.5}, "'jaw width' must be changed by -4 to 4 standard deviations, got 4.5"),
        ({"jaw width": float("nan")}, "got nan"),
        ({"chin": 1, "chin height": 1}, "given once"),
    ],
)
def test_refuses_requests(model, editor, request_, message):
    with pytest.raises(ValueRangeError, match=message):
        editor.change(model.identity_weights[0], request_)


def test_refuses(model, editor):
    with pytest.raises(ShapeError):
        editor.change(np.zeros(3), {})
    with pytest.raises(ValueRangeError, match="form must be one of"):
        editor.change(model.identity_weights[0], {"jaw width": 1}, form="magic")
    few = AttributeEditor(
        model.topology, None, model.expression(model.expression_weights[0]), model.identity_weights[:9]
    )
    with pytest.raises(DegenerateError, match="got 9 people"):
        few.change(model.identity_weights[0], {"jaw width": 1}, form="regression")
    assert few.change(model.identity_weights[0], {"jaw width": 1}).change["jaw width"] == pytest.approx(1, abs=0.05)
