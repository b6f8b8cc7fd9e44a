"""What a long job has done so far, kept beside its output, so that a killed run is taken up where it ended."""

from __future__ import annotations

import hashlib
import json
import os
import shutil
from collections.abc import Mapping
from contextlib import suppress
from pathlib import Path
from types import TracebackType
from typing import Any

from facewright.errors import NoFaceError, StoreError

_ENDS = 1 << 20


class WorkFolder:
    """A hidden folder beside an output, ``.NAME.work``, for one run at a time.

    It stays when the run fails or is killed, and goes with `remove` when the output is there, and
    where no face was found.

    Parameters
    ----------
    output : str or Path
        The file that the job shall write; its folder must exist.

    Raises
    ------
    StoreError
        If the folder cannot be made, or another run writes the same output.
    """

    def __init__(self, output: str | Path) -> None:
        self.output = Path(output)
        self.path = self.output.parent / f".{self.output.name}.work"
        self._lock: Any = None

    def __enter__(self) -> WorkFolder:
        if not self.output.parent.is_dir():
            raise StoreError(f"{self.output} cannot be written: the folder {self.output.parent} does not exist.")
        if self.output.is_dir():
            raise StoreError(f"{self.output} must be a file to write, got a folder.")
        try:
            self.path.mkdir(exist_ok=True)
            self._lock = (self.path / "lock").open("a")
        except OSError as error:
            raise StoreError(f"{self.output} cannot be written: {error.strerror or error}.") from error
        if not _locked(self._lock):
            self._lock.close()
            raise StoreError(f"{self.output} is being written by another run: wait for it, or choose another name.")
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._lock.close()
        if kind is not None and issubclass(kind, NoFaceError):  # asking again would find as little
            self.remove()
        with suppress(OSError):  # nothing done that is worth keeping
            if {entry.name for entry in self.path.iterdir()} <= {"lock"}:
                shutil.rmtree(self.path)

    def stage(self, name: str, belongs_to: Mapping[str, Any]) -> Path:
        """Return the folder of a stage of the work; what another input or other options left there is thrown away.

        Parameters
        ----------
        name : str
            Of the stage.
        belongs_to : mapping
            All that its contents depend on, as JSON has it.
        """
        text = json.dumps(belongs_to, sort_keys=True, default=str)
        folder = self.path / f"{name}-{hashlib.sha256(text.encode()).hexdigest()[:16]}"
        for other in self.path.glob(f"{name}-*"):
            if other != folder:
                shutil.rmtree(other, ignore_errors=True)
        folder.mkdir(exist_ok=True)
        for part in folder.glob(".*.part*"):  # of a write that was killed
            part.unlink(missing_ok=True)
        return folder

    def remove(self) -> None:
        """Throw the folder away: the output is there."""
        shutil.rmtree(self.path, ignore_errors=True)


def file_identity(path: str | Path) -> dict[str, Any]:
    """Return what tells a file from another: size, time of change and a hash of both ends; cheap for large files.

    Raises
    ------
    StoreError
        If the file cannot be read.
    """
    path = Path(path)
    try:
        with path.open("rb") as stream:
            status = os.fstat(stream.fileno())
            digest = hashlib.sha256(stream.read(_ENDS))
            stream.seek(max(0, status.st_size - _ENDS))
            digest.update(stream.read(_ENDS))
    except FileNotFoundError as error:
        raise StoreError(f"{path} does not exist.") from error
    except OSError as error:
        raise StoreError(f"{path} must be a readable file, got: {error.strerror or error}.") from error
    return {"size": status.st_size, "changed": status.st_mtime_ns, "ends": digest.hexdigest()}


def _locked(stream: Any) -> bool:
    """Take the lock; it goes with the process, however that ends."""
    try:
        import fcntl
    except ImportError:  # Windows: two runs at once are not kept apart
        return True
    try:
        fcntl.flock(stream, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except OSError:
        return False
    return True
