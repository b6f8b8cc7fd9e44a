"""The place a warehouse lies in, as named objects of bytes: a local folder, or anything that fsspec reaches."""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import NamedTuple, Protocol

Buffer = bytes | bytearray | memoryview


class ObjectFacts(NamedTuple):
    """Size of an object in bytes, and when it was written, in seconds since 1970, where that is known."""

    n_bytes: int
    modified: float | None


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

    def facts(self, folder: str) -> dict[str, ObjectFacts]:
        """Sizes and times of every object below `folder`, hidden ones too."""

    def delete(self, key: str) -> None:
        """Remove an object or a folder with all that is in it; nothing happens where there is none."""

    def delete_empty(self, folder: str) -> None:
        """Remove a folder if nothing is in it; a writer that has begun in it is not disturbed."""


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
            from facewright.warehouse.remote_objects import RemoteObjects

            return RemoteObjects(text.rstrip("/") if not text.endswith("://") else text)
    from facewright.warehouse.local_objects import LocalObjects

    return LocalObjects(Path(text).expanduser().absolute())
