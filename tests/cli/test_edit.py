import json

import numpy as np
import pytest

from facewright.apps.edit_photo import EditResult
from facewright.cli.edit import parse_changes
from facewright.errors import ValueRangeError
from facewright.faces.attribute_editor import AttributeEdit


def test_changes_are_read():
    assert parse_changes(["face length=+1.5", " mouth width = -1 ", "sex: female=0.5"]) == {
        "face length": 1.5,
        "mouth width": -1.0,
        "sex: female": 0.5,
    }


@pytest.mark.parametrize("text", ["face length", "=1", "face length=", "face length=much"])
def test_what_is_no_change_is_refused(text):
    with pytest.raises(ValueRangeError, match=r'such as "face length=\+1.5", got'):
        parse_changes([text])


@pytest.mark.parametrize("value", ["nan", "inf", "-inf"])
def test_numbers_that_are_not_finite_are_refused(value):
    with pytest.raises(ValueRangeError, match=f"finite number of standard deviations, got 'face length={value}'"):
        parse_changes([f"face length={value}"])


def test_a_kind_of_people_is_explained():
    with pytest.raises(ValueRangeError, match=r'write "sex: female=\+1"'):
        parse_changes(["sex=female"])
    with pytest.raises(ValueRangeError, match="given once"):
        parse_changes(["chin=1", "chin=2"])


def test_options_become_a_request(invoke, monkeypatch, tmp_path):
    seen = []
    change = {"face length": 1.5, "nose width": 0.01}
    edit = AttributeEdit(np.zeros(3), {"face length": 100.0, "nose width": 30.0}, dict(change), change, 2.0)

    def edited(request, progress):
        seen.append(request)
        return EditResult(np.zeros((2, 2, 3), np.uint8), edit, 0.5, {"picture": request.out}, ("2 faces were found.",))

    monkeypatch.setattr("facewright.apps.edit_photo.edit_photo", edited)
    photo = tmp_path / "a.png"
    args = ("edit", photo, "--set", "face length=+1.5", "--face", "1", "-o", tmp_path / "b.png")
    result = invoke(*args, "--json")
    assert result.exit_code == 0, result.output
    payload = json.loads(result.stdout)
    assert payload["change_in_deviations"] == change and payload["asked"] == {"face length": 1.5}
    assert seen[0].face_index == 1 and seen[0].sheet is None and seen[0].form == "least change"
    shown = invoke(*args, "--regression")
    assert "face length" in shown.stdout and "+1.50" in shown.stdout and "nose width" not in shown.stdout
    assert "2 faces were found." in shown.stderr
    assert seen[1].form == "regression"
    invoke("edit", photo, "--sheet", tmp_path / "s.png")
    assert seen[2].out is None and seen[2].sheet == tmp_path / "s.png"


def test_attributes_are_listed(invoke, small_model):
    result = invoke("edit", "--list", "--model", small_model)
    assert result.exit_code == 0, result.output
    assert "cheek fullness" in result.stdout and "R2" in result.stdout
    payload = json.loads(invoke("edit", "--list", "--model", small_model, "--json").stdout)
    assert len(payload["attributes"]) == 14
    assert {"name", "mean", "standard_deviation", "r_squared", "also"} <= set(payload["attributes"][0])


def test_mistakes_are_refused(refused, small_model, tmp_path):
    photo = tmp_path / "a.png"
    assert "photo must be given" in refused("edit", "--set", "chin=1")
    assert "--set or --sheet must say what to do" in refused("edit", photo)
    assert "such as" in refused("edit", photo, "--set", "wider")
    assert "did you mean 'nose width'" in refused("edit", photo, "--set", "nose widht=1", "--model", small_model)
    assert "got 5" in refused("edit", photo, "--set", "chin=5", "--model", small_model)
    assert "a.png" in refused("edit", photo, "--set", "chin=1", "--model", small_model)
    assert not (tmp_path / "edited.png").exists()
