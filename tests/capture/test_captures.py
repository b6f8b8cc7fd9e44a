"""The layout of captures: subjects, expressions, attributes, sidecars, and what a user gets wrong there."""

import json

import pytest

from facewright.capture.captures import find_sidecar, list_captures, sidecar_path
from facewright.errors import FileFormatError, StoreError
from facewright.faces.expressions import EXPRESSION_NAMES


def _tum(path):
    (path / "depth").mkdir(parents=True)
    return path


@pytest.fixture
def root(tmp_path):
    """Two subjects, one with all expressions as folders, one with a file among few."""
    root = tmp_path / "captures"
    for name in EXPRESSION_NAMES:
        _tum(root / "berta" / name)
    _tum(root / "anna" / "neutral")
    (root / "anna" / "smile.r3d").touch()
    (root / "anna" / "subject.json").write_text(
        json.dumps({"age": 31, "sex": "female", "glasses": True, "height": 1.7})
    )
    return root


def test_subjects_in_order(root):
    anna, berta = list_captures(root)
    assert (anna.name, berta.name) == ("anna", "berta")
    assert anna.attributes == {"age": 31, "sex": "female", "glasses": True, "height": 1.7}
    assert dict(anna.recordings) == {
        "neutral": root / "anna" / "neutral",
        "smile": root / "anna" / "smile.r3d",
    }
    assert anna.problems == () and "lacks 18 of 20 expressions" in anna.warnings[0]
    assert tuple(berta.recordings) == EXPRESSION_NAMES
    assert berta.attributes == {} and berta.problems == () and berta.warnings == ()


def test_nineteen_of_twenty(root):
    (root / "berta" / "grin" / "depth").rmdir()
    (root / "berta" / "grin").rmdir()
    berta = list_captures(root)[1]
    assert len(berta.recordings) == 19 and berta.problems == ()
    assert berta.warnings == (f"{root / 'berta'} lacks 1 of 20 expressions: grin.",)


def test_spelling_is_taken_kindly(root):
    _tum(root / "anna" / "Jaw-Left")
    _tum(root / "anna" / "eyes closed")
    assert list(list_captures(root)[0].recordings) == ["neutral", "smile", "jaw_left", "eyes_closed"]


def test_other_files_and_hidden_folders_are_ignored(root):
    (root / "notes.txt").touch()
    (root / ".trash").mkdir()
    (root / "anna" / "truth.npz").touch()
    (root / "anna" / ".smile.1234.part").mkdir()
    (root / "anna" / "notes").mkdir()
    anna = list_captures(root)[0]
    assert anna.problems == () and len(list_captures(root)) == 2
    assert any("notes is no recording and is ignored" in w for w in anna.warnings)


def test_subject_without_neutral(root):
    (root / "anna" / "neutral" / "depth").rmdir()
    (root / "anna" / "neutral").rmdir()
    anna, berta = list_captures(root)
    assert anna.problems == (f"{root / 'anna'} must have a recording of the neutral expression, got smile.",)
    assert berta.problems == ()


def test_unknown_expression(root):
    _tum(root / "anna" / "wink")
    (root / "anna" / "sneer.bag").touch()
    problems = list_captures(root)[0].problems
    assert len(problems) == 2 and all("must be named after an expression" in p for p in problems)


def test_expression_that_is_no_recording(root):
    (root / "anna" / "grin").mkdir()
    assert "must be a recording, got a folder without pictures" in list_captures(root)[0].problems[0]


def test_two_recordings_of_one_expression(root):
    _tum(root / "anna" / "smile")
    (problem,) = list_captures(root)[0].problems
    assert "must have one recording of smile, got smile, smile.r3d" in problem


def test_subjects_that_differ_in_letter_case_only(root):
    _tum(root / "Anna" / "neutral")
    if len(list((root).iterdir())) < 3:
        pytest.skip("this disk does not tell letter case apart")
    one, other, berta = list_captures(root)
    assert "must have a name of its own, got one like anna" in one.problems[0]
    assert "must have a name of its own, got one like Anna" in other.problems[0]
    assert berta.problems == ()


@pytest.mark.parametrize("text", ["{broken", "[]", '{"age": [1]}', '{"age": null}', "\x00", "[" * 100_000])
def test_damaged_attributes_stop_only_this_subject(root, text):
    (root / "anna" / "subject.json").write_text(text)
    anna, berta = list_captures(root)
    assert len(anna.problems) == 1 and "subject.json must be" in anna.problems[0]
    assert berta.problems == ()


def test_attributes_that_are_no_text(root):
    (root / "anna" / "subject.json").write_bytes(b"\xff\xfe\x80")
    assert "subject.json must be" in list_captures(root)[0].problems[0]


def test_empty_subject_beside_another(root):
    (root / "carl").mkdir()
    assert "must hold recordings of expressions, got none" in list_captures(root)[2].problems[0]


def test_no_subjects(tmp_path, root):
    with pytest.raises(StoreError, match="must be a folder of captures, got nothing"):
        list_captures(tmp_path / "missing")
    with pytest.raises(StoreError, match="got a file"):
        list_captures(root / "anna" / "subject.json")
    (tmp_path / "empty").mkdir()
    with pytest.raises(FileFormatError, match=r"must hold one folder for each subject.*got none\."):
        list_captures(tmp_path / "empty")
    (tmp_path / "empty" / "anna").mkdir()
    with pytest.raises(FileFormatError, match=r"got none \(.*anna must hold recordings of expressions, got none\)"):
        list_captures(tmp_path / "empty")


def test_one_level_too_deep_is_told(root):
    with pytest.raises(FileFormatError, match=r"got one subject's recordings: give .*captures"):
        list_captures(root / "anna")


@pytest.mark.parametrize("name", ["landmarks-7.json", "landmarks-007.pts", "Landmarks-7.LJSON"])
def test_sidecar_in_a_folder(root, name):
    folder = root / "anna" / "neutral"
    assert find_sidecar(folder) is None
    (folder / name).touch()
    (folder / "landmarks-x.json").touch()
    (folder / "landmarks.json").touch()
    assert find_sidecar(folder) == (7, folder / name)


def test_sidecar_beside_a_file(root):
    recording = root / "anna" / "smile.r3d"
    (root / "anna" / "landmarks-3.json").touch()  # whose it is cannot be told
    (root / "anna" / "grin.landmarks-3.json").touch()
    assert find_sidecar(recording) is None
    assert sidecar_path(recording, 12) == root / "anna" / "smile.landmarks-12.json"
    sidecar_path(recording, 12).touch()
    assert find_sidecar(recording) == (12, sidecar_path(recording, 12))


def test_several_sidecars(root):
    folder = root / "anna" / "neutral"
    sidecar_path(folder, 1).touch()
    sidecar_path(folder, 2).touch()
    with pytest.raises(FileFormatError, match=r"one file of landmarks, got landmarks-1\.json, landmarks-2\.json"):
        find_sidecar(folder)


def test_sidecar_of_what_does_not_exist(tmp_path):
    with pytest.raises(StoreError):
        find_sidecar(tmp_path / "no" / "smile.r3d")
