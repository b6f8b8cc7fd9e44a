"""Write a folder with folders in it completely or not at all: temporary place beside it, then one rename."""

from __future__ import annotations

import errno
import os
import secrets
import shutil
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from facewright.errors import StoreError


@contextmanager
def write_folder_atomically(folder: str | os.PathLike[str], *, overwrite: bool = False) -> Iterator[Path]:
    """Yield an empty temporary folder beside `folder`; on success it becomes `folder`, on any failure it is removed.

    Parameters
    ----------
    folder : str or path
        The folder to make; its parents are made where they do not exist.
    overwrite : bool
        Replace a folder that holds something; else that is an error.

    Yields
    ------
    pathlib.Path
        Where the body writes files and folders.

    Raises
    ------
    StoreError
        If `folder` is a file, holds something and must not be replaced, cannot be made, or the disk is full.

    Examples
    --------
    >>> import tempfile
    >>> with tempfile.TemporaryDirectory() as parent:
    ...     with write_folder_atomically(Path(parent) / "new") as temporary:
    ...         (temporary / "rgb").mkdir()
    ...     (Path(parent) / "new" / "rgb").is_dir()
    True
    """
    target = Path(os.path.realpath(folder))
    _check(target, folder, overwrite)
    made = [path for path in target.parents if not path.exists()]
    temporary = target.with_name(f".{target.name[:40]}.{secrets.token_hex(6)}.part")
    old = temporary.with_suffix(".old")
    done = False
    try:
        temporary.mkdir(parents=True)
        yield temporary
        for file in temporary.rglob("*"):
            if file.is_file():
                _flush_to_disk(file)
        _check(target, folder, overwrite)
        if target.exists():
            target.rename(old)
        temporary.rename(target)
        done = True
    except OSError as error:
        if isinstance(error, StoreError):
            raise
        full = error.errno in (errno.ENOSPC, errno.EDQUOT)
        reason = "no space left on the disk; nothing was changed" if full else error.strerror or error
        raise StoreError(f"{folder} cannot be written: {reason}.") from error
    finally:
        if not done and old.exists():
            with suppress(OSError):
                old.rename(target)
        shutil.rmtree(temporary, ignore_errors=True)
        shutil.rmtree(old, ignore_errors=True)
        if not done:
            for path in made:
                with suppress(OSError):
                    path.rmdir()


def _check(target: Path, folder: str | os.PathLike[str], overwrite: bool) -> None:
    try:
        if target.exists() and not target.is_dir():
            raise StoreError(f"{folder} must be a folder to write, got a file.")
        if target.is_dir() and not overwrite and any(target.iterdir()):
            raise StoreError(f"{folder} must be a new or empty folder, got one that holds something.")
    except OSError as error:
        if isinstance(error, StoreError):
            raise
        raise StoreError(f"{folder} cannot be written: {error.strerror or error}.") from error


def _flush_to_disk(file: Path) -> None:
    descriptor = os.open(file, os.O_RDONLY)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)
