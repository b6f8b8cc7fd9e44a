"""A warehouse's objects as files below a local folder."""

from __future__ import annotations

import errno
import os
import secrets
import shutil
from collections.abc import Mapping, Sequence
from contextlib import suppress
from pathlib import Path

from facewright.errors import StoreError
from facewright.io.atomic import write_atomically
from facewright.warehouse.objects import Buffer, ObjectFacts

_NO_SPACE = (errno.ENOSPC, errno.EDQUOT, errno.EFBIG)


class LocalObjects:
    """Objects as files below a folder.

    Parameters
    ----------
    root : Path
        The folder; it need not exist yet.
    """

    def __init__(self, root: Path) -> None:
        self.root = root

    @property
    def url(self) -> str:
        """Path of the folder."""
        return str(self.root)

    def get(self, keys: Sequence[str]) -> list[bytes | None]:
        """See `Objects`."""
        return [self._get(key) for key in keys]

    def _get(self, key: str) -> bytes | None:
        try:
            return (self.root / key).read_bytes()
        except (FileNotFoundError, NotADirectoryError, IsADirectoryError):
            return None
        except OSError as error:
            raise StoreError(f"{self.root / key} cannot be read: {error.strerror or error}.") from error

    def get_ranges(self, ranges: Sequence[tuple[str, int, int]]) -> list[bytes | None]:
        """See `Objects`."""
        found: list[bytes | None] = []
        for key, start, stop in ranges:
            try:
                with (self.root / key).open("rb", buffering=0) as file:
                    size = os.fstat(file.fileno()).st_size
                    first, last = (max(size + start, 0), size) if start < 0 else (start, stop)
                    file.seek(first)
                    found.append(file.read(last - first))
            except (FileNotFoundError, NotADirectoryError):
                found.append(None)
            except OSError as error:
                raise StoreError(f"{self.root / key} cannot be read: {error.strerror or error}.") from error
        return found

    def put(self, key: str, value: bytes) -> None:
        """See `Objects`."""
        path = self.root / key
        self._make(path.parent)
        with write_atomically(path) as temporary:
            temporary.write_bytes(value)

    def create(self, key: str, value: bytes) -> bool:
        """See `Objects`."""
        path = self.root / key
        if path.exists():
            return False
        self._make(path.parent)
        aside = path.with_name(f".{path.stem}.{secrets.token_hex(6)}.new{path.suffix}")
        try:
            with write_atomically(aside) as temporary:
                temporary.write_bytes(value)
            try:
                os.link(aside, path)  # unlike a rename, fails where the file exists
            except FileExistsError:
                return False
            except OSError:  # a file system without hard links
                if path.exists():
                    return False
                aside.replace(path)
        except StoreError as error:
            raise StoreError(str(error).replace(str(aside), str(path))) from error
        finally:
            aside.unlink(missing_ok=True)
        _flush(path.parent)
        return True

    def put_all(self, values: Mapping[str, Buffer]) -> None:
        """See `Objects`."""
        folders = set()
        for key, value in values.items():
            path = self.root / key
            self._make(path.parent)
            folders.add(path.parent)
            try:
                with path.open("xb", buffering=0) as file:
                    view = memoryview(value)
                    while len(view):
                        view = view[file.write(view) :]
                    os.fsync(file.fileno())
            except OSError as error:
                raise StoreError(f"{path} cannot be written: {_reason(error)}.") from error
        for folder in folders:
            _flush(folder)

    def names_in(self, folder: str) -> list[str]:
        """See `Objects`."""
        try:
            return sorted(name for name in os.listdir(self.root / folder) if not name.startswith("."))  # noqa: PTH208
        except (FileNotFoundError, NotADirectoryError):
            return []
        except OSError as error:
            raise StoreError(f"{self.root / folder} cannot be read: {error.strerror or error}.") from error

    def facts(self, folder: str) -> dict[str, ObjectFacts]:
        """See `Objects`."""
        found = {}
        for path, _, names in os.walk(self.root / folder):
            for name in names:
                with suppress(FileNotFoundError):
                    file = Path(path) / name
                    status = file.stat()
                    found[file.relative_to(self.root).as_posix()] = ObjectFacts(status.st_size, status.st_mtime)
        return found

    def delete(self, key: str) -> None:
        """See `Objects`."""
        path = self.root / key
        try:
            if path.is_dir() and not path.is_symlink():
                shutil.rmtree(path)
            else:
                path.unlink(missing_ok=True)
        except FileNotFoundError:
            pass  # another writer removed it, too
        except OSError as error:
            raise StoreError(f"{path} cannot be removed: {error.strerror or error}.") from error

    def delete_empty(self, folder: str) -> None:
        """See `Objects`."""
        with suppress(OSError):
            (self.root / folder).rmdir()

    def _make(self, folder: Path) -> None:
        try:
            folder.mkdir(parents=True, exist_ok=True)
        except OSError as error:
            raise StoreError(f"{folder} must be a folder that can be made, got: {_reason(error)}.") from error


def _reason(error: OSError) -> str:
    if error.errno in _NO_SPACE:
        return "no space left on the disk; nothing was changed"
    return error.strerror or str(error)


def _flush(folder: Path) -> None:
    with suppress(OSError):
        descriptor = os.open(folder, os.O_RDONLY)
        try:
            os.fsync(descriptor)
        finally:
            os.close(descriptor)
