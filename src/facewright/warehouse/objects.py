"""The place a warehouse lies in, as named objects of bytes: a local folder, or anything that fsspec reaches."""

from __future__ import annotations

import os
import secrets
import shutil
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from functools import cached_property
from pathlib import Path
from typing import Any, Protocol

from facewright.errors import FacewrightError, FileFormatError, MissingExtraError, StoreError
from facewright.io.atomic import write_atomically

Buffer = bytes | bytearray | memoryview


class Objects(Protocol):
    """Named objects of bytes; names are paths with ``/``, below the root of the store."""

    @property
    def url(self) -> str:
        """Where they lie, for messages."""

    def get(self, keys: Sequence[str]) -> list[bytes | None]:
        """Read objects; None for those that do not exist."""

    def get_ranges(self, ranges: Sequence[tuple[str, int, int]]) -> list[bytes | None]:
        """Read (key, start, stop) of objects; a negative start with stop 0 counts from the end."""

    def put(self, key: str, value: bytes) -> None:
        """Write one small object at once: readers see the old one or the new one, never a part."""

    def create(self, key: str, value: bytes) -> bool:
        """Write as `put` does unless the object exists; tells whether it was written."""

    def put_all(self, values: Mapping[str, Buffer]) -> None:
        """Write objects that nobody looks for yet; when it returns they will outlast a crash."""

    def names_in(self, folder: str) -> list[str]:
        """Names directly below `folder`, sorted; hidden ones, such as half-written files, are left out."""

    def sizes(self, folder: str) -> dict[str, int]:
        """Bytes of every object below `folder`, hidden ones too."""

    def delete(self, key: str) -> None:
        """Remove an object or a folder with all that is in it; nothing happens where there is none."""


def open_objects(url: str | os.PathLike[str]) -> Objects:
    """Return the objects at a path or URL (``folder``, ``file:///folder``, ``s3://bucket/folder``, ``memory://x``).

    Raises
    ------
    MissingExtraError
        If fsspec, or the package that it needs for this kind of URL, is not installed.
    StoreError
        If the URL is of an unknown kind.
    """
    text = os.fspath(url)
    for scheme in ("file://", "local://"):
        if text.startswith(scheme):
            text = text[len(scheme) :]
            break
    else:
        if "://" in text or "::" in text:
            return RemoteObjects(text.rstrip("/") if not text.endswith("://") else text)
    return LocalObjects(Path(text).expanduser().absolute())


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

    def sizes(self, folder: str) -> dict[str, int]:
        """See `Objects`."""
        found = {}
        for path, _, names in os.walk(self.root / folder):
            for name in names:
                with suppress(FileNotFoundError):
                    file = Path(path) / name
                    found[file.relative_to(self.root).as_posix()] = file.stat().st_size
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

    def _make(self, folder: Path) -> None:
        try:
            folder.mkdir(parents=True, exist_ok=True)
        except OSError as error:
            raise StoreError(f"{folder} must be a folder that can be made, got: {_reason(error)}.") from error


class RemoteObjects:
    """Objects behind an fsspec URL: one PUT makes an object, whole.

    Parameters
    ----------
    url : str
        Such as ``s3://bucket/faces.zarr``.
    """

    def __init__(self, url: str) -> None:
        self.url = url
        self._opened  # noqa: B018  an unknown kind of URL is told now

    def __getstate__(self) -> dict[str, Any]:
        return {"url": self.url}

    @cached_property
    def _opened(self) -> tuple[Any, str]:
        try:
            from fsspec.core import url_to_fs
        except ImportError as error:
            raise MissingExtraError(
                f'{self.url} needs fsspec: install it by pip install "facewright[warehouse]".'
            ) from error
        try:
            system, path = url_to_fs(self.url)
        except ImportError as error:
            raise MissingExtraError(f"{self.url} needs a package that is not installed: {error}.") from error
        except ValueError as error:
            raise StoreError(f"{self.url} must be a folder or a URL that fsspec knows, got: {error}.") from error
        return system, path.rstrip("/")

    def _path(self, key: str) -> str:
        return f"{self._opened[1]}/{key}"

    def get(self, keys: Sequence[str]) -> list[bytes | None]:
        """See `Objects`."""
        if not keys:
            return []
        with self._told():
            found = self._opened[0].cat([self._path(key) for key in keys], on_error="return", recursive=False)
            if not isinstance(found, dict):
                found = {self._path(keys[0]): found}
            by_path = {_bare(path): value for path, value in found.items()}
            return [self._content(by_path.get(_bare(self._path(key)))) for key in keys]

    def get_ranges(self, ranges: Sequence[tuple[str, int, int]]) -> list[bytes | None]:
        """See `Objects`."""
        if not ranges:
            return []
        with self._told():
            found = self._opened[0].cat_ranges(
                [self._path(key) for key, _, _ in ranges],
                [start for _, start, _ in ranges],
                [None if start < 0 else stop for _, start, stop in ranges],
                on_error="return",
            )
            return [self._content(value) for value in found]

    @staticmethod
    def _content(value: Any) -> bytes | None:
        if value is None or isinstance(value, FileNotFoundError | IsADirectoryError | NotADirectoryError):
            return None
        if isinstance(value, Exception):
            raise value
        return bytes(value)

    def put(self, key: str, value: bytes) -> None:
        """See `Objects`."""
        with self._told():
            self._with_folders([key], lambda: self._opened[0].pipe_file(self._path(key), value))

    def create(self, key: str, value: bytes) -> bool:
        """See `Objects`."""
        with self._told():
            system, path = self._opened[0], self._path(key)
            if system.exists(path):
                return False
            try:
                self._with_folders([key], lambda: system.pipe_file(path, value, mode="create"))
            except FileExistsError:
                return False
            except (TypeError, NotImplementedError, ValueError):  # this file system cannot write exclusively
                system.pipe_file(path, value)
            return True

    def put_all(self, values: Mapping[str, Buffer]) -> None:
        """See `Objects`."""
        with self._told():
            contents = {self._path(key): bytes(value) for key, value in values.items()}
            self._with_folders(values, lambda: self._opened[0].pipe(contents))

    def _with_folders(self, keys: Iterable[str], write: Callable[[], Any]) -> None:
        """Write; where the system has real folders and they are not there, make them and write again."""
        try:
            write()
        except FileNotFoundError:
            for folder in {self._path(key).rpartition("/")[0] for key in keys}:
                self._opened[0].makedirs(folder, exist_ok=True)
            write()

    def names_in(self, folder: str) -> list[str]:
        """See `Objects`."""
        with self._told():
            system = self._opened[0]
            system.invalidate_cache()
            try:
                paths = system.ls(self._path(folder).rstrip("/"), detail=False)
            except (FileNotFoundError, NotADirectoryError):
                return []
            names = {path.rstrip("/").rpartition("/")[2] for path in paths}
            return sorted(name for name in names if name and not name.startswith("."))

    def sizes(self, folder: str) -> dict[str, int]:
        """See `Objects`."""
        with self._told():
            system, root = self._opened
            system.invalidate_cache()
            try:
                found = system.find(self._path(folder), detail=True)
            except FileNotFoundError:
                return {}
            start = len(_bare(root)) + 1
            return {_bare(path)[start:]: int(info.get("size") or 0) for path, info in found.items()}

    def delete(self, key: str) -> None:
        """See `Objects`."""
        with self._told(), suppress(FileNotFoundError):
            self._opened[0].rm(self._path(key), recursive=True)

    @contextmanager
    def _told(self) -> Iterator[None]:
        """Turn whatever a service's library raises into one sentence."""
        try:
            yield
        except FacewrightError:
            raise
        except Exception as error:  # each service has errors of its own
            what = " ".join(str(error).split()) or type(error).__name__
            raise StoreError(f"{self.url} cannot be reached: {what.rstrip('.')}.") from error


def require(value: bytes | None, what: str) -> bytes:
    """Return `value`, or raise FileFormatError that says what is missing."""
    if value is None:
        raise FileFormatError(f"{what} is missing; run facewright warehouse check.")
    return value


def _bare(path: str) -> str:
    return path.partition("://")[2].lstrip("/") if "://" in path else path.lstrip("/")


def _reason(error: OSError) -> str:
    import errno

    if error.errno in (errno.ENOSPC, errno.EDQUOT, errno.EFBIG):
        return "no space left on the disk; nothing was changed"
    return error.strerror or str(error)


def _flush(folder: Path) -> None:
    with suppress(OSError):
        descriptor = os.open(folder, os.O_RDONLY)
        try:
            os.fsync(descriptor)
        finally:
            os.close(descriptor)
