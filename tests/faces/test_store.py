from pathlib import Path

from facewright.faces.store import face_store, facewright_home, stored_face_path


def test_the_store_follows_the_environment(tmp_path, monkeypatch):
    monkeypatch.setenv("FACEWRIGHT_HOME", str(tmp_path / "here"))
    assert facewright_home() == tmp_path / "here"
    assert stored_face_path("ict") == tmp_path / "here" / "faces" / "ict.npz"
    assert not face_store().exists()  # asking makes nothing


def test_without_the_environment_it_is_the_users_data_folder(monkeypatch):
    monkeypatch.delenv("FACEWRIGHT_HOME", raising=False)
    assert facewright_home().name == "facewright"
    assert facewright_home().is_absolute()
    monkeypatch.setenv("FACEWRIGHT_HOME", "~/faces")
    assert facewright_home() == Path.home() / "faces"
