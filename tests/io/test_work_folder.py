"""What a killed run leaves: found again by the same request, thrown away for another, locked while a run goes on."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest

from facewright.errors import NoFaceError, StoreError
from facewright.io.work_folder import WorkFolder, file_identity


def test_stage_keeps_what_belongs_to_it(tmp_path: Path) -> None:
    with WorkFolder(tmp_path / "a.mp4") as work:
        (work.stage("draw", {"k": 1}) / "piece").touch()
        (work.stage("track", {"k": 1}) / "piece").touch()
    with WorkFolder(tmp_path / "a.mp4") as work:
        assert (work.stage("draw", {"k": 1}) / "piece").exists()
        assert not (work.stage("draw", {"k": 2}) / "piece").exists()
        assert not (work.stage("draw", {"k": 1}) / "piece").exists()
        assert (work.stage("track", {"k": 1}) / "piece").exists()
        work.remove()
    assert list(tmp_path.iterdir()) == []


def test_parts_of_killed_writes_go_away(tmp_path: Path) -> None:
    with WorkFolder(tmp_path / "a.mp4") as work:
        (work.stage("draw", {}) / ".0000.abc.part.mp4").touch()
        assert list(work.stage("draw", {}).iterdir()) == []


def test_nothing_is_left_where_nothing_was_done(tmp_path: Path) -> None:
    with WorkFolder(tmp_path / "a.mp4"):
        pass
    assert list(tmp_path.iterdir()) == []


def test_nothing_is_left_where_no_face_was_found(tmp_path: Path) -> None:
    with pytest.raises(NoFaceError), WorkFolder(tmp_path / "a.csv") as work:
        (work.stage("landmarks", {"video": 1}) / "points.npy").write_bytes(b"1")
        raise NoFaceError("none")
    assert list(tmp_path.iterdir()) == []
    with pytest.raises(StoreError), WorkFolder(tmp_path / "a.csv") as work:  # a full disk may be emptied
        (work.stage("landmarks", {"video": 1}) / "points.npy").write_bytes(b"1")
        raise StoreError("full")
    assert [p.name for p in tmp_path.iterdir()] == [".a.csv.work"]


_HOLDS = """
import sys
from facewright.io.work_folder import WorkFolder
with WorkFolder(sys.argv[1]):
    print("in", flush=True)
    input()
"""


@pytest.mark.skipif(not hasattr(os, "fork"), reason="locks are POSIX")
def test_one_run_at_a_time(tmp_path: Path) -> None:
    out = tmp_path / "a.mp4"
    holder = subprocess.Popen(
        [sys.executable, "-c", _HOLDS, str(out)], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
    )
    assert holder.stdout is not None and holder.stdout.readline() == "in\n"
    with pytest.raises(StoreError, match="another run"), WorkFolder(out):
        pass
    holder.kill()  # the lock goes with the process
    holder.wait()
    with WorkFolder(out):
        pass


def test_wrong_places_are_refused(tmp_path: Path) -> None:
    with pytest.raises(StoreError, match="does not exist"), WorkFolder(tmp_path / "none" / "a.mp4"):
        pass
    (tmp_path / "folder.mp4").mkdir()
    with pytest.raises(StoreError, match="got a folder"), WorkFolder(tmp_path / "folder.mp4"):
        pass


def test_files_are_told_apart(tmp_path: Path) -> None:
    path = tmp_path / "a"
    path.write_bytes(b"x" * 10)
    first = file_identity(path)
    assert file_identity(path) == first
    path.write_bytes(b"x" * 9 + b"y")
    assert file_identity(path) != first
    for wrong in (tmp_path / "none", tmp_path):
        with pytest.raises(StoreError):
            file_identity(wrong)
