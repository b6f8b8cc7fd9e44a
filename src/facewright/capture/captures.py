"""The layout of captures on disk: one folder a subject, one recording an expression, landmarks refined by hand."""

from __future__ import annotations

import json
import re
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path

from facewright.capture.recording import FILE_KINDS, recording_kind
from facewright.errors import FileFormatError, StoreError
from facewright.faces.expressions import EXPRESSION_NAMES

_SIDECAR = re.compile(r"landmarks-(\d+)\.(json|pts|ljson)", re.IGNORECASE)
_ATTRIBUTES = "subject.json"
_MAX_NAMED = 6


@dataclass(frozen=True)
class SubjectCapture:
    """What was recorded of one person.

    Parameters
    ----------
    name : str
        The folder's name.
    path : Path
        The folder.
    attributes : mapping of str to str, int, float or bool
        From ``subject.json``; empty where there is none.
    recordings : mapping of str to Path
        Expression name -> recording, in the order of `EXPRESSION_NAMES`.
    problems : tuple of str
        Why this subject cannot be used, one sentence each; empty where it can.
    warnings : tuple of str
        What the user should know although the subject can be used: missing expressions, folders that are ignored.
    """

    name: str
    path: Path
    attributes: Mapping[str, str | int | float | bool] = field(default_factory=dict)
    recordings: Mapping[str, Path] = field(default_factory=dict)
    problems: tuple[str, ...] = ()
    warnings: tuple[str, ...] = ()


def list_captures(root: str | Path) -> list[SubjectCapture]:
    """List the subjects of a folder of captures, sorted by name; no recording is opened.

    ``CAPTURES/<subject>/<expression>/`` holds a recording as a folder, ``CAPTURES/<subject>/<expression>.r3d`` (or
    ``.bag``, ``.mkv``) as a file; ``CAPTURES/<subject>/subject.json`` attributes. Names that begin with a dot and files
    of other kinds are ignored.

    Parameters
    ----------
    root : str or Path
        The folder.

    Returns
    -------
    list of SubjectCapture
        Mistakes of one subject are among its `problems`: they stop nobody else.

    Raises
    ------
    StoreError
        If `root` does not exist or cannot be read.
    FileFormatError
        If it holds no subject with recordings.
    """
    root = Path(root)
    folders = [p for p in _entries(root, "captures") if p.is_dir()]
    subjects = [_read_subject(path) for path in folders]
    if not any(subject.recordings for subject in subjects):
        if _read_subject(root).recordings:
            found = f"one subject's recordings: give {root.parent}"
        else:
            found = f"none ({subjects[0].problems[0].rstrip('.')})" if subjects and subjects[0].problems else "none"
        raise FileFormatError(
            f"{root} must hold one folder for each subject with recordings of expressions in it, got {found}."
        )
    return _with_name_problems(subjects)


def find_sidecar(recording: str | Path) -> tuple[int, Path] | None:
    """Find the landmarks that somebody refined by hand for a recording.

    Parameters
    ----------
    recording : str or Path
        In a folder: ``landmarks-<frame number>.json`` (or ``.pts``, ``.ljson``); beside a file ``smile.r3d``:
        ``smile.landmarks-<frame number>.json``.

    Returns
    -------
    (int, Path) or None
        Number of the reference frame, counted from 0, and the file. Its points are pixels of the frames as
        `open_recording` gives them, turned as ``camera.json`` says.

    Raises
    ------
    FileFormatError
        If there are several.
    """
    recording = Path(recording)
    inside = recording.is_dir()
    folder = recording if inside else recording.parent
    prefix = "" if inside else f"{recording.stem}."
    found = []
    for path in _entries(folder, "recording"):
        name = path.name[len(prefix) :] if path.name.startswith(prefix) else ""
        match = _SIDECAR.fullmatch(name)
        if match and path.is_file():
            found.append((int(match.group(1)), path))
    if len(found) > 1:
        names = ", ".join(path.name for _, path in found)
        raise FileFormatError(f"{recording} must have one file of landmarks, got {names}.")
    return found[0] if found else None


def sidecar_path(recording: str | Path, frame: int) -> Path:
    """Return where the landmarks of frame `frame` of a recording belong."""
    recording = Path(recording)
    if recording.is_dir():
        return recording / f"landmarks-{frame}.json"
    return recording.with_name(f"{recording.stem}.landmarks-{frame}.json")


def _entries(folder: Path, what: str) -> list[Path]:
    try:
        if not folder.is_dir():
            raise StoreError(f"{folder} must be a folder of {what}, got {'a file' if folder.exists() else 'nothing'}.")
        return sorted((p for p in folder.iterdir() if not p.name.startswith(".")), key=lambda p: p.name)
    except OSError as error:
        if isinstance(error, StoreError):
            raise
        raise StoreError(f"{folder} cannot be read: {error.strerror or error}.") from error


def _read_subject(path: Path) -> SubjectCapture:
    problems: list[str] = []
    warnings: list[str] = []
    found: dict[str, list[Path]] = {}
    try:
        attributes = _read_attributes(path / _ATTRIBUTES)
        for entry in _entries(path, "recordings"):
            folder = entry.is_dir()
            if not folder and entry.suffix.lower() not in FILE_KINDS:
                continue
            name = _expression(entry.name if folder else entry.stem)
            kind = recording_kind(entry)
            if kind is not None and name is None:
                problems.append(f"{entry} must be named after an expression ({', '.join(EXPRESSION_NAMES)}).")
            elif kind is not None and name is not None:
                found.setdefault(name, []).append(entry)
            elif name is not None:
                problems.append(f"{entry} must be a recording, got a folder without pictures or .ply frames.")
            else:
                warnings.append(f"{entry} is no recording and is ignored.")
    except (FileFormatError, StoreError) as error:
        return SubjectCapture(path.name, path, problems=(str(error),))
    recordings = {name: found[name][0] for name in EXPRESSION_NAMES if name in found}
    for name, paths in found.items():
        if len(paths) > 1:
            files = ", ".join(p.name for p in paths)
            problems.append(f"{path} must have one recording of {name}, got {files}.")
    if not found and not problems:
        problems.append(f"{path} must hold recordings of expressions, got none.")
    elif "neutral" not in found:
        problems.append(f"{path} must have a recording of the neutral expression, got {', '.join(recordings)}.")
    missing = [name for name in EXPRESSION_NAMES if name not in found]
    if found and missing and missing != ["neutral"]:
        names = f": {', '.join(missing)}" if len(missing) <= _MAX_NAMED else ""
        warnings.append(f"{path} lacks {len(missing)} of {len(EXPRESSION_NAMES)} expressions{names}.")
    return SubjectCapture(path.name, path, attributes, recordings, tuple(problems), tuple(warnings))


def _expression(name: str) -> str | None:
    plain = name.lower().replace("-", "_").replace(" ", "_")
    return plain if plain in EXPRESSION_NAMES else None


def _read_attributes(file: Path) -> dict[str, str | int | float | bool]:
    if not file.is_file():
        return {}
    try:
        values = json.loads(file.read_text(encoding="utf-8"))
    except OSError as error:
        raise StoreError(f"{file} cannot be read: {error.strerror or error}.") from error
    except (ValueError, RecursionError) as error:
        raise FileFormatError(f"{file} must be JSON with attributes of the subject, got {error}.") from error
    if not isinstance(values, dict) or not all(isinstance(v, str | int | float | bool) for v in values.values()):
        raise FileFormatError(f"{file} must be one JSON object of numbers, texts and truth values.")
    return values


def _with_name_problems(subjects: list[SubjectCapture]) -> list[SubjectCapture]:
    """Add the problem of names that differ only in letter case: they would be one subject on some disks."""
    from dataclasses import replace

    same: dict[str, list[str]] = {}
    for subject in subjects:
        same.setdefault(subject.name.casefold(), []).append(subject.name)
    checked = []
    for subject in subjects:
        others = [name for name in same[subject.name.casefold()] if name != subject.name]
        if others:
            sentence = f"{subject.path} must have a name of its own, got one like {', '.join(others)}."
            subject = replace(subject, problems=(*subject.problems, sentence))
        checked.append(subject)
    return checked
