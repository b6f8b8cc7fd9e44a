import errno
import os
import stat
from pathlib import Path

import numpy as np
import pytest

from facewright.errors import StoreError
from facewright.io.atomic import write_atomically, write_set_atomically


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


# ---- sets of files ----


def write_two(folder):
    (folder / "a.txt").write_text("new a")
    (folder / "b.txt").write_text("new b")


def test_a_set_arrives_at_once_and_other_files_stay(tmp_path):
    out = tmp_path / "deep" / "set"
    with write_set_atomically(out) as temporary:
        write_two(temporary)
        assert not (tmp_path / "deep").exists()
    assert listing(out) == ["a.txt", "b.txt"] and listing(tmp_path) == ["deep"]
    (out / "mine.txt").write_text("stays")
    (out / "a.txt").write_text("old a")
    with write_set_atomically(out) as temporary:
        write_two(temporary)
    assert listing(out) == ["a.txt", "b.txt", "mine.txt"]
    assert (out / "a.txt").read_text() == "new a"


@pytest.mark.parametrize("error", [RuntimeError, KeyboardInterrupt, StoreError, OSError(errno.ENOSPC, "full")])
@pytest.mark.parametrize("where", ["body", "first move", "second move"])
def test_a_failing_set_leaves_everything_as_it_was(tmp_path, monkeypatch, error, where):
    old = tmp_path / "old"
    old.mkdir()
    (old / "a.txt").write_text("old a")
    (old / "mine.txt").write_text("stays")
    calls, replace = [], os.replace

    def failing(source, target):
        calls.append(target)
        if where != "body" and Path(target).name == ("a.txt" if where == "first move" else "b.txt"):
            if not armed:
                return replace(source, target)
            armed.clear()
            raise error
        return replace(source, target)

    monkeypatch.setattr("os.replace", failing)
    for out in (old, tmp_path / "new" / "set"):
        armed = [True]
        expected = StoreError if isinstance(error, OSError) else error
        with pytest.raises(expected), write_set_atomically(out) as temporary:
            write_two(temporary)
            if where == "body":
                raise error
        assert listing(tmp_path) == ["old"] and listing(old) == ["a.txt", "mine.txt"]
        assert (old / "a.txt").read_text() == "old a"


def test_a_set_that_cannot_be_written(tmp_path):
    (tmp_path / "file").write_text("x")
    for out in (tmp_path / "file", tmp_path / "file" / "out"):
        with pytest.raises(StoreError, match="must be a folder that can be made"), write_set_atomically(out):
            pytest.fail("the body must not run")
    (tmp_path / "set" / "b.txt").mkdir(parents=True)
    with pytest.raises(StoreError, match=r"b\.txt must be a file"), write_set_atomically(tmp_path / "set") as temporary:
        write_two(temporary)
    assert listing(tmp_path / "set") == ["b.txt"]


def test_errors_of_a_set_name_the_final_place(tmp_path):
    with (
        pytest.raises(StoreError) as caught,
        write_set_atomically(tmp_path / "out") as temporary,
        write_atomically(temporary / "a.txt"),
    ):
        raise OSError(errno.ENOSPC, "full")
    assert str(tmp_path / "out" / "a.txt") in str(caught.value) and ".part" not in str(caught.value)


def write_folder(folder, text):
    (folder / "sub" / "deep").mkdir(parents=True)
    (folder / "sub" / "deep" / "a.txt").write_text(text)
    (folder / "z.txt").write_text(text)


def test_a_set_may_hold_folders_which_are_replaced_as_a_whole(tmp_path):
    out = tmp_path / "out"
    with write_set_atomically(out) as temporary:
        write_folder(temporary, "old")
        (temporary / "sub" / "stale.txt").write_text("old")
    with write_set_atomically(out) as temporary:
        write_folder(temporary, "new")
    assert (out / "sub" / "deep" / "a.txt").read_text() == "new"
    assert listing(out / "sub") == ["deep"]
    assert listing(tmp_path) == ["out"]


def test_folders_and_files_do_not_replace_each_other(tmp_path):
    out = tmp_path / "out"
    out.mkdir()
    (out / "sub").write_text("a file")
    with pytest.raises(StoreError, match="must be a folder to write"), write_set_atomically(out) as temporary:
        write_folder(temporary, "new")
    assert (out / "sub").read_text() == "a file"
    (out / "sub").unlink()
    (out / "z.txt").mkdir()
    with pytest.raises(StoreError, match="must be a file to write"), write_set_atomically(out) as temporary:
        write_folder(temporary, "new")
    assert listing(out) == ["z.txt"]


def test_a_set_with_folders_that_fails_half_way_leaves_all_as_it_was(tmp_path, monkeypatch):
    out = tmp_path / "out"
    with write_set_atomically(out) as temporary:
        write_folder(temporary, "old")
    real = os.replace

    def replace(source, target):
        if str(target).endswith("out/z.txt") and not str(source).endswith(".old/z.txt"):
            raise OSError(5, "Input/output error")
        real(source, target)

    monkeypatch.setattr("facewright.io.atomic.os.replace", replace)
    with pytest.raises(StoreError, match="Input/output error"), write_set_atomically(out) as temporary:
        write_folder(temporary, "new")
    assert (out / "sub" / "deep" / "a.txt").read_text() == "old"
    assert (out / "z.txt").read_text() == "old"
