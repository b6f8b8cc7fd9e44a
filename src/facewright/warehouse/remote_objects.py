"""A warehouse's objects behind an fsspec URL, such as ``s3://bucket/faces.zarr``."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from datetime import datetime
from functools import cached_property
from typing import Any

from facewright.errors import FacewrightError, MissingExtraError, StoreError
from facewright.warehouse.objects import Buffer, ObjectFacts


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

    def facts(self, folder: str) -> dict[str, ObjectFacts]:
        """See `Objects`."""
        with self._told():
            system, root = self._opened
            system.invalidate_cache()
            try:
                found = system.find(self._path(folder), detail=True)
            except FileNotFoundError:
                return {}
            start = len(_bare(root)) + 1
            return {
                _bare(path)[start:]: ObjectFacts(int(info.get("size") or 0), _modified(info))
                for path, info in found.items()
            }

    def delete(self, key: str) -> None:
        """See `Objects`."""
        with self._told(), suppress(FileNotFoundError):
            self._opened[0].rm(self._path(key), recursive=True)

    def delete_empty(self, folder: str) -> None:
        """See `Objects`; object stores have no folders that could be empty, other systems may keep one."""

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


def _bare(path: str) -> str:
    return path.partition("://")[2].lstrip("/") if "://" in path else path.lstrip("/")


def _modified(info: Mapping[str, Any]) -> float | None:
    """Return when an object was written, by whichever name its file system says it."""
    for key in ("LastModified", "last_modified", "updated", "mtime", "created"):
        value = info.get(key)
        if isinstance(value, datetime):
            return value.timestamp()
        if isinstance(value, int | float):
            return float(value)
    return None
