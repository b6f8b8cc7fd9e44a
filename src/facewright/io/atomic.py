"""Write a file, or a set of files, completely or not at all: temporary place on the same disk, fsync, rename."""

from __future__ import annotations

import errno
import os
import secrets
import shutil
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from facewright.errors import StoreError

_NO_SPACE = {errno.ENOSPC, errno.EDQUOT, errno.EFBIG}
_MIN_FREE_BYTES = 64 * 1024


@contextmanager
def write_atomically(path: str | os.PathLike[str]) -> Iterator[Path]:
    """Yield a temporary path beside `path`; on success it becomes `path`, on any failure it is removed.

    The temporary file lies in the same folder, exists and is empty when it is yielded, and keeps the suffix of
    `path`, so that writers that choose a format by suffix work. A reader of `path` sees the old file or the whole
    new one, never a part; Ctrl-C, a full disk and errors of the body leave the old file as it was.

    Parameters
    ----------
    path : str or path
        The file to write. A symbolic link is followed; its target is replaced.

    Yields
    ------
    pathlib.Path
        Where the body writes. The body must have closed the file when it ends.

    Raises
    ------
    StoreError
        If the folder does not exist, `path` is a folder or a device, permission is missing, or the disk is full. Other
        errors of the body pass through unchanged.

    Examples
    --------
    >>> import tempfile
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     with write_atomically(Path(folder) / "a.txt") as temporary:
    ...         _ = temporary.write_text("hello")
    ...     (Path(folder) / "a.txt").read_text()
    'hello'
    """
    target = Path(os.path.realpath(path))
    _check_target(target)
    # A long name is cut, so that the temporary name stays below the usual limit of 255 bytes.
    temporary = target.with_name(f".{target.stem[:40]}.{secrets.token_hex(6)}.part{target.suffix[:40]}")
    try:
        _create(temporary, target)
        try:
            yield temporary
            _flush_to_disk(temporary)
            os.replace(temporary, target)  # noqa: PTH105
        except OSError as error:
            # The space is what the question is about: look at it before the finally clause frees it again.
            if isinstance(error, StoreError):
                raise
            message = _disk_message(error, temporary, target)
            if message is None:
                raise
            raise StoreError(message) from error
    finally:
        with suppress(OSError):
            temporary.unlink(missing_ok=True)
    with suppress(OSError):
        _flush_to_disk(target.parent)


@contextmanager
def write_set_atomically(folder: str | os.PathLike[str]) -> Iterator[Path]:
    """Yield a temporary folder; on success what it holds moves to `folder`, on any failure nothing of it stays.

    Files and folders of other names that `folder` holds stay; a folder of the same name is replaced as a whole. After
    a failure (full disk, Ctrl-C, an error of the body) older ones of the same names are as they were, and folders that
    were made for the set are gone.

    Parameters
    ----------
    folder : str or path
        Where the files shall lie; made with its parents, at the end, where it does not exist.

    Yields
    ------
    pathlib.Path
        Existing, empty folder on the same disk.

    Raises
    ------
    StoreError
        If `folder` cannot be made, permission is missing, the disk is full, or one of its names is taken by something
        that it must not replace: a folder by a file, a file by a folder, a device.
        Messages of the body's StoreErrors name the final place. Other errors pass through unchanged.

    Examples
    --------
    >>> import tempfile
    >>> with tempfile.TemporaryDirectory() as parent:
    ...     with write_set_atomically(Path(parent) / "new" / "set") as temporary:
    ...         _ = (temporary / "a.txt").write_text("hello")
    ...     (Path(parent) / "new" / "set" / "a.txt").read_text()
    'hello'
    """
    target = Path(os.path.realpath(folder))
    missing = [path for path in (target, *target.parents) if not os.path.lexists(path)]
    base = missing[-1].parent if missing else target
    temporary = base / f".facewright.{secrets.token_hex(6)}.part"
    try:
        try:
            temporary.mkdir()
        except OSError as error:
            raise StoreError(f"{folder} must be a folder that can be made, got: {error.strerror or error}.") from error
        try:
            yield temporary
            _move_files(temporary, target, missing[::-1])
        except StoreError as error:
            raise StoreError(str(error).replace(str(temporary), str(folder))) from error
        except OSError as error:
            message = _disk_message(error, temporary, target)
            if message is None:
                raise
            raise StoreError(message) from error
    finally:
        shutil.rmtree(temporary, ignore_errors=True)


def _move_files(temporary: Path, target: Path, missing: list[Path]) -> None:
    """Make the missing folders (outermost first) and move all files; undo both where one step fails."""
    names = sorted(path.name for path in temporary.iterdir())
    old = temporary / ".old"
    done = False
    try:
        old.mkdir()
        for path in missing:
            path.mkdir()
        for name in names:
            _check_replaceable(temporary / name, target / name)
        for name in names:
            if os.path.lexists(target / name):
                os.replace(target / name, old / name)  # noqa: PTH105
            os.replace(temporary / name, target / name)  # noqa: PTH105
        with suppress(OSError):
            _flush_to_disk(target)
        done = True
    except OSError as error:
        if isinstance(error, StoreError):
            raise
        raise StoreError(f"{target} cannot be written: {error.strerror or error}.") from error
    finally:
        if not done:
            _move_back(temporary, target, names)
            for path in missing[::-1]:
                with suppress(OSError):
                    path.rmdir()


def _move_back(temporary: Path, target: Path, names: list[str]) -> None:
    for name in names:
        with suppress(OSError):
            if not os.path.lexists(temporary / name) and os.path.lexists(target / name):  # it had been moved
                os.replace(target / name, temporary / name)  # noqa: PTH105
            if os.path.lexists(temporary / ".old" / name):
                os.replace(temporary / ".old" / name, target / name)  # noqa: PTH105


def _check_replaceable(new: Path, target: Path) -> None:
    """Refuse what must not be replaced: a folder gives way to a folder only."""
    if not new.is_dir():
        _check_target(target)
    elif os.path.lexists(target) and (target.is_symlink() or not target.is_dir()):
        raise StoreError(f"{target} must be a folder to write, got a file.")


def _check_target(target: Path) -> None:
    """Refuse what a rename would destroy or cannot reach."""
    try:
        if target.is_dir():
            raise StoreError(f"{target} must be a file to write, got a folder.")
        if target.exists() and not target.is_file():
            raise StoreError(f"{target} must be an ordinary file to write, got a device or pipe.")
        if not target.parent.is_dir():
            raise StoreError(f"{target} cannot be written: the folder {target.parent} does not exist.")
    except OSError as error:
        if isinstance(error, StoreError):
            raise
        raise StoreError(f"{target} cannot be written: {error.strerror or error}.") from error


def _create(temporary: Path, target: Path) -> None:
    """Create the empty temporary file with the permissions that `target` has or would get."""
    try:
        os.close(os.open(temporary, os.O_CREAT | os.O_EXCL | os.O_WRONLY, 0o666))
        if target.exists():
            shutil.copymode(target, temporary)
    except OSError as error:
        raise StoreError(f"{target} cannot be written: {error.strerror or error}.") from error


def _flush_to_disk(path: Path) -> None:
    descriptor = os.open(path, os.O_RDONLY)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)


def _disk_message(error: OSError, temporary: Path, target: Path) -> str | None:
    """Return one sentence if `error` is about storing this file, None if it is about something else."""
    if error.errno in _NO_SPACE or (error.errno is None and _is_full(temporary.parent)):
        return f"{target} cannot be written: no space left on the disk; nothing was changed."
    if error.errno is not None and (error.filename is None or Path(str(error.filename)) in (temporary, target)):
        return f"{target} cannot be written: {error.strerror or error}."
    return None


def _is_full(folder: Path) -> bool:
    """Tell whether `folder` has hardly any room: some writers (ndarray.tofile) raise without an error number."""
    with suppress(OSError):
        return shutil.disk_usage(folder).free < _MIN_FREE_BYTES
    return False
