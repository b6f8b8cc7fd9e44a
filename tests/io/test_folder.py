"""Folders appear whole or not at all."""

import errno

import pytest

from facewright.errors import StoreError, ValueRangeError
from facewright.io.folder import write_folder_atomically


def _names(folder):
    return sorted(str(p.relative_to(folder)) for p in folder.rglob("*"))


def _fill(folder):
    (folder / "rgb").mkdir()
    (folder / "rgb" / "a.txt").write_text("new")


def test_folder_with_folders_appears(tmp_path):
    target = tmp_path / "deep" / "er" / "set"
    with write_folder_atomically(target) as temporary:
        _fill(temporary)
        assert not target.exists()
    assert _names(tmp_path) == ["deep", "deep/er", "deep/er/set", "deep/er/set/rgb", "deep/er/set/rgb/a.txt"]


@pytest.mark.parametrize("error", [RuntimeError, KeyboardInterrupt, ValueRangeError, OSError(errno.EIO, "bad disk")])
def test_nothing_stays_after_a_failure(tmp_path, error):
    refused = pytest.raises((StoreError, RuntimeError, KeyboardInterrupt, ValueRangeError))
    with refused, write_folder_atomically(tmp_path / "deep" / "set") as temporary:
        _fill(temporary)
        raise error
    assert _names(tmp_path) == []


def test_full_disk_is_one_sentence(tmp_path):
    refused = pytest.raises(
        StoreError, match=r"set cannot be written: no space left on the disk; nothing was changed\."
    )
    with refused, write_folder_atomically(tmp_path / "set") as temporary:
        _fill(temporary)
        raise OSError(errno.ENOSPC, "No space left on device")
    assert _names(tmp_path) == []


def test_what_is_there_stays_unless_it_is_to_be_replaced(tmp_path):
    (tmp_path / "set").mkdir()
    (tmp_path / "set" / "old.txt").write_text("old")
    with pytest.raises(StoreError, match="holds something"), write_folder_atomically(tmp_path / "set"):
        pytest.fail("the body must not run")
    with pytest.raises(RuntimeError), write_folder_atomically(tmp_path / "set", overwrite=True) as temporary:
        _fill(temporary)
        raise RuntimeError
    assert _names(tmp_path) == ["set", "set/old.txt"]
    with write_folder_atomically(tmp_path / "set", overwrite=True) as temporary:
        _fill(temporary)
    assert _names(tmp_path) == ["set", "set/rgb", "set/rgb/a.txt"]


def test_old_folder_comes_back_where_the_rename_fails(tmp_path, monkeypatch):
    (tmp_path / "set").mkdir()
    (tmp_path / "set" / "old.txt").write_text("old")
    rename = type(tmp_path).rename

    def refuse(self, target):
        if self.name.endswith(".part"):
            raise OSError(errno.EIO, "bad disk")
        return rename(self, target)

    monkeypatch.setattr(type(tmp_path), "rename", refuse)
    with pytest.raises(StoreError, match="bad disk"), write_folder_atomically(tmp_path / "set", overwrite=True) as new:
        _fill(new)
    assert _names(tmp_path) == ["set", "set/old.txt"]


def test_empty_folder_is_taken(tmp_path):
    (tmp_path / "set").mkdir()
    with write_folder_atomically(tmp_path / "set") as temporary:
        _fill(temporary)
    assert (tmp_path / "set" / "rgb" / "a.txt").is_file()


def test_file_in_the_way(tmp_path):
    (tmp_path / "set").write_text("a file")
    with pytest.raises(StoreError, match="must be a folder"), write_folder_atomically(tmp_path / "set"):
        pytest.fail("the body must not run")
    with pytest.raises(StoreError, match="cannot be written"), write_folder_atomically(tmp_path / "set" / "below"):
        pytest.fail("the body must not run")
