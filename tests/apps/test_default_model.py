import numpy as np
import pytest

from facewright.apps import default_model as module
from facewright.apps.default_model import default_model, default_model_path, model_or_default
from facewright.errors import FileFormatError, MissingFaceError, StoreError


@pytest.fixture
def home(tmp_path, monkeypatch):
    """An empty home, and a recipe of three people, which is quick."""
    monkeypatch.setenv("FACEWRIGHT_HOME", str(tmp_path / "home"))
    for name, value in (("_N_PEOPLE", 3), ("_N_IDENTITY", 2), ("_N_EXPRESSION", 5)):
        monkeypatch.setattr(module, name, value)
    return tmp_path / "home"


def test_is_built_once_and_kept(home):
    stages = []
    model = default_model(lambda *a: stages.append(a))
    assert stages and model.n_identity == 2 and model.provenance["face"] == "builtin"
    (path,) = (home / "models").iterdir()
    assert path == default_model_path()
    stages.clear()
    again = default_model(lambda *a: stages.append(a))
    assert not stages and again is model
    module._loaded.cache_clear()
    np.testing.assert_array_equal(default_model().core_rows, model.core_rows)


def test_is_built_again_where_it_is_damaged_or_of_another_version(home, monkeypatch):
    default_model()
    path = default_model_path()
    whole = path.read_bytes()
    path.write_bytes(whole[: len(whole) // 2])
    stages = []
    assert default_model(lambda *a: stages.append(a)).n_identity == 2 and stages
    monkeypatch.setattr("facewright.__version__", "99.0")
    assert default_model_path() != path and not default_model_path().exists()
    default_model()
    assert default_model_path().is_file()


def test_name_tells_the_face_apart(builtin_face, ict_face):
    from dataclasses import replace

    moved = replace(builtin_face, mean_shape=builtin_face.mean_shape + np.float32(0.01))
    hashes = {module.face_hash(face) for face in (builtin_face, moved, ict_face)}
    assert len(hashes) == 3


def test_a_place_that_cannot_be_written(tmp_path, monkeypatch):
    (tmp_path / "file").write_text("")
    monkeypatch.setenv("FACEWRIGHT_HOME", str(tmp_path / "file"))
    with pytest.raises(StoreError, match="FACEWRIGHT_HOME"):
        default_model()


def test_an_absent_face(tmp_path, monkeypatch):
    monkeypatch.setenv("FACEWRIGHT_HOME", str(tmp_path))
    with pytest.raises(MissingFaceError):
        default_model(face="ict")


def test_a_model_is_read_or_the_default_one_is_taken(tmp_path, monkeypatch):
    calls = []
    monkeypatch.setattr(module, "default_model", lambda progress: calls.append(progress) or "it")
    assert model_or_default(None) == "it" and calls == [None]
    with pytest.raises(StoreError):
        model_or_default(tmp_path / "absent.fwbm")
    (tmp_path / "bad.fwbm").write_bytes(b"no model")
    with pytest.raises(FileFormatError):
        model_or_default(tmp_path / "bad.fwbm")
