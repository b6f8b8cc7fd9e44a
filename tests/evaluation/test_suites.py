"""Running suites by name, and holding metrics against their targets."""

import inspect
from importlib import import_module

import pytest

from facewright.errors import MissingFaceError, ValueRangeError
from facewright.evaluation.suites import SUITES, TARGETS, compare, has_targets, run_suite


@pytest.mark.parametrize("suite", SUITES)
def test_every_suite_has_the_common_signature(suite):
    parameters = inspect.signature(import_module(f"facewright.evaluation.{suite}").run).parameters
    assert list(parameters)[:3] == ["face", "seed", "progress"] and "subjects" in parameters


def test_suites_run_by_name(monkeypatch, builtin_face):
    from facewright.evaluation import transfer

    def run(face, seed, progress=None, *, subjects=3):
        return {"vertices": face.topology.n_vertices, "seed": seed, "subjects": subjects}

    monkeypatch.setattr(transfer, "run", run)
    V = builtin_face.topology.n_vertices
    assert run_suite("transfer", "builtin", 5) == {"vertices": V, "seed": 5.0, "subjects": 3.0}
    assert run_suite("transfer", "builtin", 5, subjects=2)["subjects"] == 2.0
    monkeypatch.setattr(transfer, "run", lambda face, seed, progress=None: {})
    with pytest.raises(ValueRangeError, match="subjects"):
        run_suite("transfer", "builtin", 5, subjects=2)


def test_unknown_suites_and_faces_are_refused():
    with pytest.raises(ValueRangeError, match="transfer, rigging, bilinear, photo"):
        run_suite("suites", "builtin", 0)
    with pytest.raises(MissingFaceError):
        run_suite("transfer", "nobody", 0)


def test_targets():
    assert set(TARGETS) <= set(SUITES)
    rows = compare("photo", {"surface_mm": 1.0, "mean_face_mm": 2.0, "fit_ms": 30.0, "other": 1.0})
    assert rows == [
        ("surface_mm", 1.0, "< mean_face_mm", "yes"),
        ("mean_face_mm", 2.0, "", ""),
        ("fit_ms", 30.0, "<= 20.0", "no"),
        ("other", 1.0, "", ""),
    ]
    assert compare("rigging", {"improvement": 0.3})[0][3] == "yes"
    assert compare("photo", {"surface_mm": 1.0}) == [("surface_mm", 1.0, "", "")]
    assert compare("photo", {"fit_ms": 30.0}, targets=False) == [("fit_ms", 30.0, "", "")]


def test_targets_are_for_one_face_and_number_of_people():
    assert has_targets("bilinear", "ict") and has_targets("bilinear", "ict", 150) and has_targets("transfer", "ict", 3)
    assert not has_targets("bilinear", "builtin") and not has_targets("bilinear", "builtin", 150)
    assert not has_targets("bilinear", "ict", 149) and not has_targets("transfer", "ict", 150)
    with pytest.raises(ValueRangeError, match="suite"):
        has_targets("nonsense", "ict")
