"""Folders like those of the TUM RGB-D benchmark (Sturm et al. 2012): pictures, lists of times, the camera."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from facewright.camera.pinhole import Intrinsics
from facewright.capture.camera_file import read_camera_file
from facewright.capture.depth_units import guess_counts_per_metre
from facewright.errors import FileFormatError, StoreError, ValueRangeError
from facewright.io.frame_image import decode_color, decode_depth, read_bytes

#: Colour and depth belong together if they were taken within this time, seconds (as TUM's associate.py).
MAX_APART = 0.02
_COLOR_FOLDERS = ("rgb", "color", "image")
_PAIR_LISTS = ("associations.txt", "associate.txt", "associated.txt")
_PICTURES = {".png", ".jpg", ".jpeg", ".tif", ".tiff", ".bmp", ".webp"}
_FRAMES_PER_SECOND = 30.0
_SATURATED = 65535


class TumSource:
    """Frames of a TUM-style folder.

    Parameters
    ----------
    folder : Path
        With ``rgb.txt`` and ``depth.txt`` (lines of time and file), or a list of pairs (``associations.txt``), or only
        the folders ``rgb`` (``color``) and ``depth`` with equally many pictures; ``camera.json`` holds width, height,
        fx, fy, cx, cy and depth_per_metre.
    depth_per_metre : float, optional
        Numbers of the depth pictures per metre; by default what ``camera.json`` says, else a guess that is said.

    Raises
    ------
    FileFormatError, StoreError
        If lists, pictures or camera are missing or damaged, or no depth picture has a colour picture.
    """

    kind = "tum"

    def __init__(self, folder: Path, depth_per_metre: float | None = None) -> None:
        if depth_per_metre is not None and not 0 < depth_per_metre < np.inf:
            raise ValueRangeError(f"depth_per_metre must be positive, got {depth_per_metre}.")
        self._folder = folder
        self._times, self._colors, self._depths, left_out = _frame_files(folder)
        self.n_frames = len(self._times)
        camera = read_camera_file(folder)
        self._intrinsics, self._size = camera.intrinsics, camera.size
        notes = [left_out] if left_out else []
        self._per_metre = depth_per_metre or camera.depth_per_metre or 0.0
        if not self._per_metre:
            self._per_metre = guess_counts_per_metre(self._counts(self.n_frames // 2))
            notes.append(f"{folder} does not say its depth_per_metre: {self._per_metre:g} was taken.")
        self.warnings = tuple(notes)

    def depth(self, i: int) -> NDArray[np.floating]:
        """Return depth in millimetres; 0 and 65535 are none."""
        counts = self._counts(i)
        depth = counts * np.float32(1000.0 / self._per_metre)
        if counts.dtype == np.uint16:
            depth[counts == _SATURATED] = 0.0
        return depth

    def color(self, i: int) -> NDArray[np.uint8]:
        """Return colour as stored."""
        return decode_color(read_bytes(self._colors[i]), self._colors[i])

    def intrinsics(self, i: int) -> Intrinsics | None:
        """Return the camera that the folder states, the same for all frames."""
        return self._intrinsics

    def time(self, i: int) -> float:
        """Return the depth picture's time."""
        return self._times[i]

    def _counts(self, i: int) -> NDArray[Any]:
        file = self._depths[i]
        counts = decode_depth(read_bytes(file), file)
        if self._size is not None and counts.shape != self._size:
            raise FileFormatError(
                f"{file} must be {self._size[1]} x {self._size[0]} as the folder's camera file says, got "
                f"{counts.shape[1]} x {counts.shape[0]}."
            )
        return counts


def _frame_files(folder: Path) -> tuple[list[float], list[Path], list[Path], str]:
    """Return times, colour files and depth files of the frames, and what was left out."""
    pairs = next((folder / name for name in _PAIR_LISTS if (folder / name).is_file()), None)
    if pairs is not None:
        rows = _read_rows(pairs, 4)
        depth_first = bool(rows) and rows[0][1].split("/")[0].startswith("depth")
        c, d = (2, 0) if depth_first else (0, 2)
        times = [_time(row[d], pairs) for row in rows]
        found = times, [_inside(folder, row[c + 1]) for row in rows], [_inside(folder, row[d + 1]) for row in rows], ""
    elif (folder / "rgb.txt").is_file() and (folder / "depth.txt").is_file():
        found = _associated(folder)
    else:
        found = _by_order(folder)
    if not found[0]:
        raise FileFormatError(f"{folder} must hold depth pictures with colour pictures, got no pair.")
    for file in (*found[1], *found[2]):
        if not file.is_file():
            raise StoreError(f"{file} does not exist, but the recording's list names it.")
    return found


def _associated(folder: Path) -> tuple[list[float], list[Path], list[Path], str]:
    """Pair pictures that are each other's nearest in time and at most `MAX_APART` apart."""
    lists = {name: _read_rows(folder / f"{name}.txt", 2) for name in ("rgb", "depth")}
    if not lists["rgb"] or not lists["depth"]:
        empty = "rgb" if not lists["rgb"] else "depth"
        raise FileFormatError(f"{folder / empty}.txt must name at least one picture, got none.")
    rgb, depth = (np.array([_time(row[0], folder / f"{n}.txt") for row in rows]) for n, rows in lists.items())
    color_of, apart = _nearest(depth, rgb)
    mutual = _nearest(rgb, depth)[0][color_of] == np.arange(len(depth))
    kept = np.flatnonzero(mutual & (apart <= MAX_APART))
    kept = kept[np.argsort(depth[kept], kind="stable")]
    if not kept.size:
        raise FileFormatError(
            f"{folder} must have colour within {1000 * MAX_APART:.0f} ms of each depth picture, got none so near "
            f"(the nearest is {apart.min():.3g} s away)."
        )
    alone = len(depth) - len(kept)
    note = f"{alone} of {len(depth)} depth pictures of {folder} have no colour and are left out." if alone else ""
    return (
        [float(depth[i]) for i in kept],
        [_inside(folder, lists["rgb"][color_of[i]][1]) for i in kept],
        [_inside(folder, lists["depth"][i][1]) for i in kept],
        note,
    )


def _nearest(times: NDArray[np.float64], others: NDArray[np.float64]) -> tuple[NDArray[np.intp], NDArray[np.float64]]:
    """Return for each time the index of the nearest of `others`, and how far apart they are."""
    order = np.argsort(others, kind="stable")
    ahead = np.clip(np.searchsorted(others[order], times), 1, max(len(others) - 1, 1))
    pair = order[np.minimum(np.stack([ahead - 1, ahead]), len(others) - 1)]
    apart = np.abs(others[pair] - times)
    second = apart[1] < apart[0]
    return np.where(second, pair[1], pair[0]), np.where(second, apart[1], apart[0])


def _by_order(folder: Path) -> tuple[list[float], list[Path], list[Path], str]:
    """Pair the pictures of two folders without lists, in the order of their names."""
    color_folder = next((folder / name for name in _COLOR_FOLDERS if (folder / name).is_dir()), None)
    if color_folder is None:
        raise FileFormatError(f"{folder} must have colour pictures in a folder rgb beside depth, got none.")
    if not (folder / "depth").is_dir():
        raise FileFormatError(f"{folder} must have depth pictures in a folder depth beside rgb, got none.")
    colors, depths = _pictures(color_folder), _pictures(folder / "depth")
    if len(colors) != len(depths):
        raise FileFormatError(
            f"{folder} must have as many colour as depth pictures, or lists rgb.txt and depth.txt that say which "
            f"belong together, got {len(colors)} and {len(depths)}."
        )
    return [i / _FRAMES_PER_SECOND for i in range(len(colors))], colors, depths, ""


def _pictures(folder: Path) -> list[Path]:
    files = [f for f in folder.iterdir() if f.suffix.lower() in _PICTURES and not f.name.startswith(".")]
    return sorted(files, key=lambda f: natural_key(f.name))


def natural_key(name: str) -> tuple[Any, ...]:
    """Return a sort key by which frame-10 comes after frame-9."""
    return tuple((1, int(part), "") if part.isdigit() else (0, 0, part) for part in re.split(r"(\d+)", name))


def _read_rows(path: Path, n_columns: int) -> list[list[str]]:
    try:
        text = read_bytes(path).decode("utf-8")
    except UnicodeDecodeError as error:
        raise FileFormatError(f"{path} must be a text of times and file names, got other bytes.") from error
    rows = [line.split() for line in text.splitlines() if line.strip() and not line.lstrip().startswith("#")]
    short = next((k for k, row in enumerate(rows) if len(row) < n_columns), None)
    if short is not None:
        raise FileFormatError(f"{path} must have {n_columns} words a line, got {len(rows[short])} in row {short + 1}.")
    return rows


def _time(word: str, path: Path) -> float:
    try:
        value = float(word)
    except ValueError:
        value = np.nan
    if not np.isfinite(value):
        raise FileFormatError(f"{path} must have times in seconds, got {word!r}.")
    return value


def _inside(folder: Path, name: str) -> Path:
    relative = Path(name)
    if relative.is_absolute() or ".." in relative.parts:
        raise FileFormatError(f"{folder} must list files inside it, got {name!r}.")
    return folder / relative
