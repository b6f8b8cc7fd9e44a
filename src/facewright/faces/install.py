"""Install ICT-FaceKit into the face store: from the network, an archive, a folder or the compact file."""

from __future__ import annotations

import tempfile
import zipfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from facewright.errors import FacewrightError, StoreError
from facewright.faces.ict import read_compact_arrays
from facewright.faces.ict_archive import FolderMembers, ZipMembers, check_contents, convert_upstream
from facewright.faces.store import face_store, stored_face_path
from facewright.io.atomic import write_atomically

Progress = Callable[[str, int, int], None]

ICT_COMMIT = "da5f95a607f5e6b37755b38d3385d7f2853732e5"
ICT_URL = f"https://github.com/ICT-VGL/ICT-FaceKit/archive/{ICT_COMMIT}.zip"


def install_ict(source: Path | None = None, progress: Progress | None = None) -> Path:
    """Install ICT-FaceKit (MIT) and return the compact file that `load_face("ict")` will read.

    Parameters
    ----------
    source : Path, optional
        The upstream repository as a zip archive or as a folder, or the compact ``.npz``. Default: the archive of one
        pinned commit is fetched over HTTPS (some 150 MB) and deleted after conversion.
    progress : callable, optional
        Called as progress(stage, done, total).

    Returns
    -------
    Path
        The installed file; written whole or not at all.

    Raises
    ------
    StoreError
        If the source does not exist, the download fails, or the store cannot be written.
    FileFormatError
        If the source is truncated, corrupt or not ICT-FaceKit; then nothing is installed.

    Notes
    -----
    Whatever the source, the *contents* are checked after conversion (`check_contents`): SHA-256 of the polygons, of
    the neutral mesh and of the texture coordinates, signed sums of every shape. The archive file itself has no pinned
    hash. Nothing in it is executed, unpacked by its own path, or unpickled.
    """
    if source is None:
        arrays = _download_and_convert(progress)
    else:
        arrays = _read_source(Path(source), progress)
    target = stored_face_path("ict")
    try:
        target.parent.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise StoreError(f"{target.parent} must be a folder that can be made, got {error.strerror}.") from error
    with write_atomically(target) as temporary:
        np.savez_compressed(temporary, **{name: arrays[name] for name in arrays})
    return target


def _read_source(source: Path, progress: Progress | None) -> dict[str, NDArray]:
    """Return the checked arrays of a folder, a compact file or an archive."""
    if source.is_dir():
        arrays = convert_upstream(FolderMembers(source), progress)
    elif not source.is_file():
        raise StoreError(f"{source} must be an existing archive, folder or compact .npz file.")
    elif _is_compact(source):
        arrays = read_compact_arrays(source)
    else:
        arrays = convert_upstream(ZipMembers(source), progress)
    check_contents(arrays, source)
    return arrays


def _is_compact(path: Path) -> bool:
    """Tell whether a file is a NumPy archive (by content where it is a zip, else by its name)."""
    if zipfile.is_zipfile(path):
        with zipfile.ZipFile(path) as archive:
            return any(name.endswith(".npy") for name in archive.namelist())
    return path.suffix == ".npz"


def _download_and_convert(progress: Progress | None) -> dict[str, NDArray]:
    """Fetch the pinned archive into a folder that is deleted in any case, and convert it."""
    store = face_store()
    try:
        store.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryDirectory(dir=store, prefix=".download-") as folder:
            return _read_source(_download(ICT_URL, Path(folder), progress), progress)
    except FacewrightError:
        raise
    except OSError as error:
        raise StoreError(f"{store} must be a folder with room for 200 MB, got {error}.") from error


def _download(url: str, folder: Path, progress: Progress | None) -> Path:
    import logging

    import pooch

    pooch.get_logger().setLevel(logging.ERROR)  # it warns of the missing hash; contents are checked instead
    downloader = pooch.HTTPDownloader(progressbar=_Meter(progress) if progress else False, timeout=60)
    try:
        return Path(pooch.retrieve(url, known_hash=None, fname="ict.zip", path=folder, downloader=downloader))
    except Exception as error:  # requests, urllib3 and pooch each have their own errors
        reason = str(error).splitlines()[0] if str(error) else type(error).__name__
        raise StoreError(
            f"{url} must be reachable, got {reason}; download it elsewhere and give it with --from PATH."
        ) from error


class _Meter:
    """What pooch asks of a progress bar, passed on to a progress callback."""

    def __init__(self, progress: Progress) -> None:
        self._progress = progress
        self.total = 0
        self.done = 0

    def update(self, n: int) -> None:
        self.done += int(n)
        self._progress("downloading ICT-FaceKit", self.done, max(int(self.total), self.done))

    def reset(self, *_: Any) -> None:
        self.done = 0

    def close(self) -> None:
        pass
