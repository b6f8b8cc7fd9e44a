import errno
import os
import stat
from pathlib import Path

import numpy as np
import pytest

from facewright.errors import StoreError
from facewright.io.atomic import write_atomically


def listing(folder: Path) -> list[str]:
    return sorted(p.name for p in folder.iterdir())


def test_success_leaves_only_the_file(tmp_path):
    with write_atomically(tmp_path / "face.obj") as temporary:
        assert temporary.parent == tmp_path
        assert temporary.suffix == ".obj"
        temporary.write_bytes(b"new")
        assert not (tmp_path / "face.obj").exists()
    assert listing(tmp_path) == ["face.obj"]
    assert (tmp_path / "face.obj").read_bytes() == b"new"


@pytest.mark.parametrize("error", [RuntimeError, KeyboardInterrupt, SystemExit, ValueError])
def test_failure_keeps_the_old_file(tmp_path, error):
    path = tmp_path / "a.bin"
    path.write_bytes(b"old")
    with pytest.raises(error), write_atomically(path) as temporary:
        temporary.write_bytes(b"half")
        raise error
    assert listing(tmp_path) == ["a.bin"]
    assert path.read_bytes() == b"old"


def test_no_space_is_one_sentence(tmp_path):
    path = tmp_path / "a.bin"
    with pytest.raises(StoreError, match=r"a\.bin cannot be written: no space left"), write_atomically(path):
        raise OSError(errno.ENOSPC, "No space left on device")
    assert listing(tmp_path) == []


def test_really_full_device_by_tofile(tmp_path, monkeypatch):
    """ndarray.tofile raises an OSError without a number when the disk is full."""
    monkeypatch.setattr("facewright.io.atomic._is_full", lambda folder: True)
    with pytest.raises(StoreError, match="no space"), write_atomically(tmp_path / "a.bin"):
        np.zeros(100_000).tofile("/dev/full")
    assert listing(tmp_path) == []


def test_error_about_another_file_passes_through(tmp_path):
    with pytest.raises(FileNotFoundError), write_atomically(tmp_path / "a.bin"):
        Path(tmp_path / "missing.txt").read_text()
    assert listing(tmp_path) == []


def test_store_error_of_the_body_passes_through(tmp_path):
    with pytest.raises(StoreError, match="mine"), write_atomically(tmp_path / "a.bin"):
        raise StoreError("mine")


def test_missing_folder(tmp_path):
    with pytest.raises(StoreError, match="does not exist"), write_atomically(tmp_path / "no" / "a.bin"):
        pytest.fail("the body must not run")


def test_folder_and_device_are_refused(tmp_path):
    with pytest.raises(StoreError, match="got a folder"), write_atomically(tmp_path):
        pytest.fail("the body must not run")
    with pytest.raises(StoreError, match="device"), write_atomically("/dev/null"):
        pytest.fail("the body must not run")
    assert stat.S_ISCHR(Path("/dev/null").stat().st_mode)


def test_read_only_folder(tmp_path):
    if os.geteuid() == 0:
        pytest.skip("root may write anywhere")
    tmp_path.chmod(0o500)
    with pytest.raises(StoreError, match="cannot be written"), write_atomically(tmp_path / "a.bin"):
        pytest.fail("the body must not run")


def test_symbolic_link_stays_a_link(tmp_path):
    real = tmp_path / "real.txt"
    real.write_text("old")
    link = tmp_path / "link.txt"
    link.symlink_to(real)
    with write_atomically(link) as temporary:
        temporary.write_text("new")
    assert link.is_symlink()
    assert real.read_text() == "new"


def test_permissions_follow_umask_and_old_file(tmp_path):
    umask = os.umask(0)
    os.umask(umask)
    with write_atomically(tmp_path / "a") as temporary:
        temporary.write_text("x")
    assert stat.S_IMODE((tmp_path / "a").stat().st_mode) == 0o666 & ~umask
    (tmp_path / "a").chmod(0o640)
    with write_atomically(tmp_path / "a") as temporary:
        temporary.write_text("y")
    assert stat.S_IMODE((tmp_path / "a").stat().st_mode) == 0o640


def test_long_name(tmp_path):
    path = tmp_path / ("n" * 240 + ".obj")
    with write_atomically(path) as temporary:
        temporary.write_text("x")
    assert path.read_text() == "x"


def test_body_that_removes_its_file_is_reported(tmp_path):
    with pytest.raises(StoreError, match="cannot be written"), write_atomically(tmp_path / "a") as temporary:
        temporary.unlink()
    assert listing(tmp_path) == []
