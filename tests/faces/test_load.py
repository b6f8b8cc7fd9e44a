import pytest

from facewright.errors import FileFormatError, MissingFaceError
from facewright.faces import list_faces, load_face


def test_both_faces_are_listed_installed_or_not(tmp_path, monkeypatch):
    monkeypatch.setenv("FACEWRIGHT_HOME", str(tmp_path))
    faces = {face.name: face for face in list_faces()}
    assert set(faces) == {"builtin", "ict"}
    assert faces["builtin"].installed
    assert not faces["ict"].installed
    assert "MIT" in faces["ict"].licence


def test_a_face_that_is_not_installed_says_how_to_install_it(tmp_path, monkeypatch):
    monkeypatch.setenv("FACEWRIGHT_HOME", str(tmp_path))
    with pytest.raises(MissingFaceError, match="facewright faces install ict"):
        load_face("ict")


@pytest.mark.parametrize("name", ["", "nobody", "face.obj"])
def test_an_unknown_face_is_refused(name):
    with pytest.raises(MissingFaceError, match="builtin"):
        load_face(name)


def test_a_missing_or_foreign_file_is_refused(tmp_path):
    with pytest.raises(MissingFaceError, match="absent"):
        load_face(tmp_path / "absent.npz")
    (tmp_path / "empty.npz").write_bytes(b"")
    with pytest.raises(FileFormatError, match="empty"):
        load_face(tmp_path / "empty.npz")


def test_a_face_is_loaded_once(ict_face, test_data):
    assert load_face(test_data / "ict_facekit.npz") is load_face(test_data / "ict_facekit.npz")
